"""Poses of readings: which can be read, in which order, off the grid, and the next one.

Belief           what is known, and what should become accurate
Capsule          a fixed obstacle
ChangeTimes      time to change parts of a set-up
DirectionCone    directions that a limit allows
ReadingLimits    what a reading must keep to
ReadingOrder     readings of one set-up in an order of short joint travel
Surroundings     obstacles, and what moves between them
polish_readings  readings moved to the next local optimum of a criterion
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.poses.feasible import Capsule, DirectionCone, ReadingLimits, Surroundings
    from oed.poses.next_reading import Belief
    from oed.poses.order import ChangeTimes, ReadingOrder
    from oed.poses.polish import polish_readings
else:
    # imported when first used: CasADi takes time to load
    __getattr__ = door(__name__)
