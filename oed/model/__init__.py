"""What a model states: machine, instrument, effect, the series of readings, their sizes.

EFFECT_SIZES         how large effects are thought to be
Channel              a reading of an instrument: its unit and noise
Column               one coefficient of an effect
CommonTolerance      parameters whose errors are correlated
Coordinate           a commanded coordinate: its unit and range
Cost                 time to mount a set-up, and to take a reading
Effect               an effect outside the model
Instrument           what is read at a pose, and by which set-up parameters
Machine              a closure with its parameters, joints and workspace
Parameter            a nominal value and its tolerance
Protocol             how often each planned reading is taken
Setup                an instrument as mounted
State                the state of a machine at poses of a set-up
machine_expressions  the CasADi expressions of a machine
mount                an instrument as a set-up
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.model.effect import Column, Effect, State
    from oed.model.expressions import machine_expressions
    from oed.model.instrument import Channel, Cost, Instrument, Protocol, Setup, mount
    from oed.model.machine import CommonTolerance, Coordinate, Machine
    from oed.model.parameter import Parameter
    from oed.model.size_prior import EFFECT_SIZES
else:
    # imported when first used: a module of the room may need little of it
    __getattr__ = door(__name__)
