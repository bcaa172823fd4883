"""The base of every record of result.json, and its numbers that may be missing."""

from __future__ import annotations

import math

import msgspec

#: a number that is null in the file where it is not finite: JSON has no NaN
Number = float | None


def finite_or_none(value: float) -> Number:
    """A number, or None where it is not finite."""
    return float(value) if math.isfinite(value) else None


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A part of result.json: frozen, unknown fields refused."""
