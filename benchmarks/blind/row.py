"""Rows of the benchmark's table: a measure with its interval and what it must reach."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from benchmarks.blind import intervals


@dataclasses.dataclass(frozen=True, kw_only=True)
class Row:
    """A measure with a 95 % interval.

    key          short name
    measure      the measure in words
    value        over `count` cases
    low, high    ends of the interval
    count        number of cases
    hits         how many of them, where it is a share
    sense        `>=`, `<=`, or `in` for a band (must, aim); "" without a target
    must         what it must reach
    aim          what it aims at
    """

    key: str
    measure: str
    value: float
    low: float
    high: float
    count: int
    hits: int | None = None
    sense: str = ""
    must: float | None = None
    aim: float | None = None

    @property
    def status(self) -> str:
        """`aim`, `must` or `no` as the value reaches; `above` a band.

        `-` without cases or target.
        """
        if not self.sense or self.must is None or self.aim is None:
            return "-"
        if not self.count or math.isnan(self.value):
            return "-"
        if self.sense == "in":
            if self.value < self.must:
                return "no"
            return "above" if self.value > self.aim else "must"
        sign = 1.0 if self.sense == ">=" else -1.0
        if sign * (self.value - self.aim) >= 0:
            return "aim"
        return "must" if sign * (self.value - self.must) >= 0 else "no"

    @property
    def proved(self) -> bool:
        """Whether the interval's worse end reaches what must be reached, too."""
        if self.status not in ("aim", "must") or self.must is None:
            return False
        if self.sense == "<=":
            return self.high <= self.must
        return self.low >= self.must

    def as_record(self) -> dict[str, Any]:
        """Fields as JSON and CSV take them."""
        record = dataclasses.asdict(self)
        record |= {"status": self.status, "proved": self.proved}
        return {key: _finite(value) for key, value in record.items()}


def _finite(value: Any) -> Any:
    """A value, or None for a number that is not finite."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def share(key: str, measure: str, tests: Sequence[bool], **target: Any) -> Row:
    """A share of cases with Wilson's interval."""
    hits, count = sum(tests), len(tests)
    low, high = intervals.wilson(hits, count)
    return Row(
        key=key,
        measure=measure,
        value=hits / count if count else math.nan,
        low=low,
        high=high,
        count=count,
        hits=hits,
        **target,
    )


def average(key: str, measure: str, values: Sequence[float], **target: Any) -> Row:
    """A mean with the interval of Student's t."""
    value, low, high = intervals.mean(values)
    return Row(
        key=key,
        measure=measure,
        value=value,
        low=low,
        high=high,
        count=len(values),
        **target,
    )


def middle(key: str, measure: str, values: Sequence[float], **target: Any) -> Row:
    """A median with its distribution-free interval."""
    value, low, high = intervals.median(values)
    return Row(
        key=key,
        measure=measure,
        value=value,
        low=low,
        high=high,
        count=len(values),
        **target,
    )


def at_least(must: float, aim: float) -> dict[str, Any]:
    """Target of a measure that must reach a value from below."""
    return {"sense": ">=", "must": must, "aim": aim}


def at_most(must: float, aim: float) -> dict[str, Any]:
    """Target of a measure that must stay below a value."""
    return {"sense": "<=", "must": must, "aim": aim}
