"""The base of every record of result.json, and its numbers that may be missing."""

import math
from typing import Annotated, Literal

import msgspec

#: a number that is null in the file where it is not finite: JSON has no NaN
Number = float | None
#: what is never below zero; a probability; a point
Size = Annotated[float, msgspec.Meta(ge=0.0)]
Probability = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Point = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
#: a logarithm of which a power can be taken
Logarithm = Annotated[float, msgspec.Meta(ge=-700.0, le=700.0)]
#: what is said of anything that was wanted
Judgement = Literal["pass", "fail", "cannot tell"]


def finite_or_none(value: float) -> Number:
    """A number, or None where it is not finite."""
    return float(value) if math.isfinite(value) else None


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A part of result.json: frozen, unknown fields refused."""
