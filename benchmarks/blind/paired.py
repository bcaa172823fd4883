"""Paired comparisons of the diagnosis with the baselines on the same cases."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from benchmarks.blind import intervals
from benchmarks.blind.checks import Check, alarm, detected, right_class, rightly
from benchmarks.blind.entries import DIAGNOSIS, Entry
from benchmarks.blind.judge import StatedAnswer
from benchmarks.blind.measures import RIGHT_CLASS
from benchmarks.blind.selection import (
    pairs,
    separated_singles,
    singles,
    visible,
    visible_singles,
)

#: p-value below which one of the two is better
SIGNIFICANT = 0.01


@dataclasses.dataclass(frozen=True, kw_only=True)
class Paired:
    """Diagnosis and baseline on the same cases.

    baseline          its name
    measure           what is right, in words
    count             number of cases
    diagnosis         in how many the diagnosis is right
    other             in how many the baseline is right
    only_diagnosis    in how many only the diagnosis is
    only_other        in how many only the baseline is
    p_value           exact, of McNemar's test
    """

    baseline: str
    measure: str
    count: int
    diagnosis: int
    other: int
    only_diagnosis: int
    only_other: int
    p_value: float

    @property
    def verdict(self) -> str:
        """Which is better at the 1 % level."""
        if self.p_value >= SIGNIFICANT:
            return "no difference"
        return "diagnosis" if self.only_diagnosis > self.only_other else self.baseline


def compare(entries: Sequence[Entry], baseline: str) -> list[Paired]:
    """Every paired comparison with a baseline; a passed check is the better answer."""
    null = [e for e in entries if e.kind == "null"]
    gaps = [e for e in singles(entries) if visible(e)]
    comparisons: list[tuple[str, list[Entry], Check]] = [
        ("no false alarm", null, _no_alarm),
        ("detection at sqrt(lambda) >= 6", gaps, detected),
        ("gap or none, rightly", [*null, *gaps], rightly),
        (RIGHT_CLASS, separated_singles(entries), right_class),
        ("right class at sqrt(lambda) >= 6", visible_singles(entries), right_class),
        (
            "both of two exactly, sqrt(lambda) >= 6",
            pairs(entries, apart=False),
            right_class,
        ),
    ]
    return [_pair(baseline, *comparison) for comparison in comparisons]


def _no_alarm(e: Entry, answer: StatedAnswer | None) -> bool:
    return not alarm(e, answer)


def _pair(
    baseline: str,
    measure: str,
    entries: Sequence[Entry],
    check: Check,
) -> Paired:
    both = [
        (check(e, e.best[DIAGNOSIS]), check(e, e.best[baseline]))
        for e in entries
        if baseline in e.best
    ]
    only_diagnosis = sum(first and not second for first, second in both)
    only_other = sum(second and not first for first, second in both)
    return Paired(
        baseline=baseline,
        measure=measure,
        count=len(both),
        diagnosis=sum(first for first, _ in both),
        other=sum(second for _, second in both),
        only_diagnosis=only_diagnosis,
        only_other=only_other,
        p_value=intervals.mcnemar(only_diagnosis, only_other),
    )
