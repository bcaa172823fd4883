"""A joint that no drive moves, whose angle or length a sensor can read or a lock keep."""

from __future__ import annotations

import dataclasses
from typing import Any


@dataclasses.dataclass(frozen=True, slots=True)
class PassiveJoint:
    """A passive joint of a machine, as `Machine.passive` lists it.

    name   such as `swing1`; unique among the machine's coordinates
    unit   SI unit, rad or m
    value  its angle or length, a CasADi expression of pose, joints and parameters
    about  what it measures: axis and sense, for tables

    >>> from oed import PassiveJoint
    >>> PassiveJoint("swing1", "rad", 0.1, "swing of leg 1, outward").unit
    'rad'
    """

    name: str
    unit: str
    value: Any
    about: str
