"""What is read of a machine: instruments, as mounted, and series of readings.

Channel          a number of a reading: its unit and noise
Cost             time to mount a set-up, and to take a reading
Frame            what an instrument sees of a machine at a pose
InnerReading     a number that an instrument reads inside
Instrument       what is read at a pose, and by which set-up parameters
ParameterVector  the parameters of a machine and of its set-ups
Protocol         how often each planned reading is taken
Series           readings of one set-up: joints, poses, runs
Setting          a known number of a set-up
Setup            an instrument as mounted
TakenReadings    some readings of a series
mount            an instrument as a set-up
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.instrument.instrument import (
        Channel,
        Cost,
        Frame,
        InnerReading,
        Instrument,
        Protocol,
        Setting,
        Setup,
        mount,
    )
    from oed.instrument.parameter_vector import ParameterVector
    from oed.instrument.series import Series, TakenReadings
else:
    # imported when first used: a module of the room may need little of it
    __getattr__ = door(__name__)
