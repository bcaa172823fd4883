"""Measures of the diagnosis alone: probabilities, the 95 % set, closure, reliability.

`measures` states what counts as what.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from benchmarks.blind import checks, judge
from benchmarks.blind.checks import check_all, is_right
from benchmarks.blind.entries import DIAGNOSIS, Entry
from benchmarks.blind.places import leg_rows, place_rows
from benchmarks.blind.row import Row, at_least, average, loss_bound, middle, share
from benchmarks.blind.selection import (
    clear,
    separated,
    separated_singles,
    visible_singles,
)

#: expected gain of the oracle from which on a case counts for the closure
GAIN = 36.0
#: edges of the probabilities for the reliability
EDGES = (0.0, 0.5, 0.7, 0.9, 0.99, 1.0 + 1e-9)
#: ways of holding readings out, in words
SPLITS = {"within": "parts of runs", "whole": "whole runs"}


def diagnosis_rows(entries: Sequence[Entry]) -> list[Row]:
    """The rows that a diagnosis alone has: probabilities, sets, closure, place."""
    return [
        *_probability_rows(entries),
        *_set_rows(entries),
        *(_closure_row(entries, split) for split in SPLITS),
        *place_rows(entries),
        *leg_rows(entries),
    ]


def _probability_rows(entries: Sequence[Entry]) -> list[Row]:
    """Probability on the true class, and the size of classes that are right."""
    likely = []
    for e in visible_singles(entries):
        right = [a for a in e.answers if judge.names_exactly(a, e.known)]
        likely.append(sum(a.probability for a in right))
    sizes = []
    for e in separated_singles(entries):
        answer = e.best[DIAGNOSIS]
        if answer is not None and judge.names_exactly(answer, e.known):
            sizes.append(float(len(answer.classes[0])))
    return [
        average(
            "probability",
            "mean probability on the true class",
            likely,
            **at_least(0.80, 0.90),
        ),
        average("class size", "mean size of a class that is right", sizes),
    ]


def _covers(e: Entry) -> bool:
    """Whether one of the answers of the 95 % set is right."""
    return any(is_right(e, answer) for answer in e.set95)


def _set_rows(entries: Sequence[Entry]) -> list[Row]:
    """Coverage and size of the 95 % set."""
    visible_truth = clear(entries)
    return [
        share(
            "set95",
            "95 % answer set: coverage",
            [_covers(e) for e in visible_truth],
            sense="in",
            must=0.93,
            aim=0.97,
        ),
        average(
            "set95 size",
            "95 % answer set: mean size",
            [float(len(e.set95)) for e in visible_truth],
            **loss_bound(2.0, 1.5),
        ),
        share(
            "set95 all",
            "95 % answer set: coverage, effects too small to be seen among them",
            [_covers(e) for e in entries],
        ),
    ]


def _closure_row(entries: Sequence[Entry], split: str) -> Row:
    measure = f"closure over the oracle's, {SPLITS[split]}, median"
    ratios = closure_ratios(entries, split)
    return middle(f"closure {split}", measure, ratios, **at_least(0.85, 0.95))


def closure_ratios(entries: Sequence[Entry], split: str) -> list[float]:
    """Gain on held-out readings over the oracle's, case by case."""
    ratios = []
    for e in entries:
        if e.unknown or not e.testable or e.kind == "null":
            continue
        oracle = _of_split(e.oracle["closure"], split)
        if oracle is None or oracle["expected_gain"] < GAIN:
            continue
        if oracle["same_law"] is None:
            continue
        largest = _gain(oracle["same_law"])
        closure = _of_split(e.result.get("closure", []), split)
        gain = None if closure is None else _gain(closure)
        if largest is not None and largest > 0.0:
            ratios.append((gain or 0.0) / largest)
    return ratios


def _of_split(closures: Sequence[Any], split: str) -> Any:
    """The closure of a split, if there is one."""
    return next((c for c in closures if c["split"] == split), None)


def _gain(c: Any) -> float | None:
    """(S0 - S1) / S0."""
    if c["s0"] is None or c["s1"] is None or not c["s0"]:
        return None
    return float(1.0 - c["s1"] / c["s0"])


def withheld_rows(entries: Sequence[Entry]) -> list[Row]:
    """Rows of cases whose effect was withheld from the library.

    At sqrt(lambda_k|j) >= 6 from all effects that stay in it.
    """
    distinct = [e for e in entries if separated(e)]
    imitated = [e for e in entries if not separated(e)]
    answers = [e.best[DIAGNOSIS] for e in distinct]
    alone = [a is not None and a.unknown and not a.classes for a in answers]
    return [
        share(
            "withheld flagged",
            "withheld effect: unknown among the answer's effects",
            check_all(distinct, checks.flagged, DIAGNOSIS),
            **at_least(0.80, 0.90),
        ),
        share("withheld alone", "withheld effect: unknown, and nothing else", alone),
        share(
            "withheld imitated",
            "withheld, below 6 from a rival: a known effect is named",
            check_all(imitated, checks.named, DIAGNOSIS),
        ),
        *place_rows(distinct, "withheld place", "withheld effect: "),
    ]


def reliability(entries: Sequence[Entry]) -> list[Row]:
    """How often the best answer is right, by the probability that it has.

    Of cases whose truth is visible, without the null cases, which are easy.
    """
    rights = []
    for e in clear(entries):
        answer = e.best[DIAGNOSIS]
        if e.kind != "null" and answer is not None:
            rights.append((answer.probability, is_right(e, answer)))
    rows = []
    for low, high in itertools.pairwise(EDGES):
        measure = f"best answer right, given {low:g} to {min(high, 1.0):g}"
        between = [right for p, right in rights if low <= p < high]
        rows.append(share(f"reliable {low:g}", measure, between))
    return rows
