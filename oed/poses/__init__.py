"""Poses of readings: which can be read, in which order, off the grid, and the next one.

Belief           what is known, and what should become accurate
Capsule          a ball or rod that the machine may not touch
ChangeTimes      time to change parts of a set-up
DirectionCone    directions from which an instrument can read
ReadingLimits    what a reading must keep to
ReadingOrder     readings of one set-up in an order of short joint travel
Surroundings     what stands around the machine
check_readings   which readings keep to the limits, and why others do not
cup_position     where the bar of a set-up is held
order_mounting   set-ups in the order of least re-mounting
order_readings   readings of one set-up in an order of short joint travel
polish_readings  readings moved to the next local optimum of a criterion
travel_probability    probability that a reading stays within the travel of its instrument
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.poses.feasible import (
        Capsule,
        DirectionCone,
        ReadingLimits,
        Surroundings,
        check_readings,
        cup_position,
        travel_probability,
    )
    from oed.poses.next_reading import Belief
    from oed.poses.order import (
        ChangeTimes,
        ReadingOrder,
        order_mounting,
        order_readings,
    )
    from oed.poses.polish import polish_readings
else:
    # imported when first used: CasADi takes time to load
    __getattr__ = door(__name__)
