"""Measures of the benchmark, each with its count, its interval and its target.

What counts as what, where the wording leaves it open:

- detection counts cases of one known effect, whether these readings can test its name
  or not; severity is the oracle's sqrt(lambda) that the case was made for
- right class: one effect that the readings can test, at sqrt(lambda_k|j) >= 6 from
  every rival; the best answer names one effect, whose class holds the true one (an
  unknown remainder with it is no fault)
- right class where the library's form shows it: those of these cases in which that form
  explains more than any rival's by sqrt(lambda) >= 6. In the others it is what no form
  of the library explains, the effect's own departure from it, that no rival takes over
- probability on the true class: the sum over all answers of that kind; one testable
  effect at sqrt(lambda) >= 6
- pairs: both effects testable, each at sqrt(lambda) >= 6 with the other in the model
  and at sqrt(lambda_k|j) >= 6 from every rival; as few are, those of a set of pairs
  alone count with them where it is given (`score --pairs`)
- unknown flagged: `unknown` in the best answer, at sqrt(lambda) >= 6 beyond the best
  library effect
- called unknown alone: one testable known effect at sqrt(lambda) >= 6
- 95 % set: null cases, and cases whose effects are all testable (or unknown and out of
  the library's span) at sqrt(lambda) >= 6; it covers where one of its answers is right
  as a whole
- closure: the gain (S0 - S1) / S0 over the oracle's under the same noise law, readings
  and folds; 0 where the diagnosis adds nothing. Cases of known testable effects whose
  expected gain with the true law is at least 36
- place: for each kind of block that the label states (leg, run, time) the likeliest
  claimed one, at sqrt(lambda) >= 6
- right leg where the library's form shows it: those of these cases in which some form
  of the library in the right leg alone explains more than any form in another leg
  alone, by sqrt(lambda) >= 6

A failed diagnosis is wrong in every count.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.blind import checks, judge
from benchmarks.blind.checks import Check, check_all
from benchmarks.blind.entries import DIAGNOSIS, UNSEEN, Entry
from benchmarks.blind.row import (
    Row,
    at_least,
    average,
    loss_bound,
    share,
)
from benchmarks.blind.selection import (
    VISIBLE,
    outside_library,
    pairs,
    reaches,
    separated_singles,
    singles,
    visible,
    visible_singles,
)

LAWS = ("white", "correlated", "heavy", "run", "combined")
RIGHT_CLASS = "right class at sqrt(lambda_k|j) >= 6"
LEVELS = (2.0, 4.0, 6.0, 10.0, 20.0)
#: share by which a severity may differ from a level
NEAR = 0.01


def rows(
    entries: Sequence[Entry],
    method: str = DIAGNOSIS,
    more: Sequence[Entry] = (),
) -> list[Row]:
    """The rows that every method has: from its best answer alone.

    `more` are pairs that are separated from every rival, of which a set has few; they
    count in the rows of such pairs alone.
    """
    return [
        *_alarm_rows(entries, method),
        *_detection_rows(entries, method),
        *_class_rows(entries, method, more),
        *_unknown_rows(entries, method),
        *_rows_without_target(entries, method),
    ]


def _checked(
    key: str,
    measure: str,
    entries: Sequence[Entry],
    check: Check,
    method: str,
    **target: Any,
) -> Row:
    """Share of the cases in which a method's best answer passes a check."""
    return share(key, measure, check_all(entries, check, method), **target)


def _near(e: Entry, level: float) -> bool:
    """Whether a case was made for a severity."""
    return abs(e.severity - level) < NEAR * level


def _alarm_rows(entries: Sequence[Entry], method: str) -> list[Row]:
    """False alarms by noise law."""
    rows = []
    for law in LAWS:
        null = [e for e in entries if e.kind == "null" and e.law == law]
        key, measure = f"alarm {law}", f"false alarm, {law} noise"
        target = loss_bound(0.05, 0.02)
        rows.append(_checked(key, measure, null, checks.alarm, method, **target))
    return rows


def _detection_rows(entries: Sequence[Entry], method: str) -> list[Row]:
    """Detection by severity."""
    one, rows = singles(entries), []
    for level in LEVELS:
        near = [e for e in one if _near(e, level)]
        key = f"found {level:g}"
        measure = f"detection at sqrt(lambda) = {level:g}"
        rows.append(_checked(key, measure, near, checks.detected, method))
    at6 = [e for e in one if _near(e, VISIBLE)]
    at10 = [e for e in one if reaches(e.severity, 10.0)]
    return [
        *rows,
        _checked(
            "detection 6",
            "detection at sqrt(lambda) 6",
            at6,
            checks.detected,
            method,
            **at_least(0.80, 0.90),
        ),
        _checked(
            "detection 10",
            "detection at 10 and more",
            at10,
            checks.detected,
            method,
            **at_least(0.97, 0.99),
        ),
    ]


def _class_rows(
    entries: Sequence[Entry],
    method: str,
    more: Sequence[Entry],
) -> list[Row]:
    """Right classes of single effects and of pairs."""
    developed = [e for e in entries if e.machine != UNSEEN]
    unseen = [e for e in entries if e.machine == UNSEEN]
    two = pairs([*entries, *more])
    return [
        _checked(
            "right class",
            RIGHT_CLASS,
            separated_singles(developed),
            checks.right_class,
            method,
            **at_least(0.90, 0.95),
        ),
        _checked(
            "right class unseen",
            f"the same on the unseen machine ({UNSEEN})",
            separated_singles(unseen),
            checks.right_class,
            method,
            **at_least(0.85, 0.92),
        ),
        _checked(
            "pairs",
            "both of two effects exactly",
            two,
            checks.right_class,
            method,
            **at_least(0.75, 0.85),
        ),
        _false_effects(
            two,
            method,
            "false effects pairs",
            "false effects a case of two",
            **loss_bound(0.15, 0.05),
        ),
    ]


def _unknown_rows(entries: Sequence[Entry], method: str) -> list[Row]:
    """Unknown effects, and effects that the readings cannot distinguish."""
    exact = [e for e in entries if e.kind == "exact"]
    return [
        _checked(
            "unknown",
            "unknown effect flagged",
            outside_library(entries),
            checks.flagged,
            method,
            **at_least(0.80, 0.90),
        ),
        _checked(
            "called unknown",
            "known called unknown alone",
            visible_singles(entries),
            checks.unknown_alone,
            method,
            **loss_bound(0.05, 0.02),
        ),
        _checked(
            "exact class",
            "exact-class case that names one member",
            exact,
            checks.one_member,
            method,
            **loss_bound(0.02, 0.0),
        ),
    ]


def _rows_without_target(entries: Sequence[Entry], method: str) -> list[Row]:
    """Further rows that every method has, without a target."""
    untestable = [e for e in singles(entries) if not e.testable and visible(e)]
    exact = [e for e in entries if e.kind == "exact" and visible(e)]
    unknown = [e for e in entries if e.unknown and visible(e)]
    single = separated_singles(entries)
    shown = [e for e in single if reaches(e.shown, VISIBLE)]
    two = pairs(entries, apart=False)
    several: list[tuple[str, str, Sequence[Entry], Check]] = [
        (
            "right class shown",
            "right class where the library's form shows it, rivals' less",
            shown,
            checks.right_class,
        ),
        (
            "right class 6",
            "right class at sqrt(lambda) >= 6, rivals or not",
            visible_singles(entries),
            checks.right_class,
        ),
        (
            "pairs 6",
            "both of two exactly, rivals or not",
            two,
            checks.right_class,
        ),
        (
            "exact found",
            "exact class named right, sqrt(lambda) >= 6",
            exact,
            checks.right_class,
        ),
        (
            "unknown 6",
            "unknown flagged, sqrt(lambda) >= 6, in the library's span or not",
            unknown,
            checks.flagged,
        ),
        (
            "unknown found",
            "gap found where an unknown acts, sqrt(lambda) >= 6",
            unknown,
            checks.detected,
        ),
    ]
    return [
        *(_checked(*row, method) for row in several),
        _false_effects(
            entries, method, "false effects", "false effects a case, all cases"
        ),
        _checked(
            "untestable named",
            "name given to an effect that cannot be tested",
            untestable,
            checks.named,
            method,
        ),
    ]


def _false_effects(
    entries: Sequence[Entry],
    method: str,
    key: str,
    measure: str,
    **target: Any,
) -> Row:
    """Mean number of effects named that do not act; 1 for a failure."""
    counts = []
    for e in entries:
        if method in e.best:
            answer = e.best[method]
            count = 1 if answer is None else judge.count_false(answer, e.known)
            counts.append(float(count))
    return average(key, measure, counts, **target)
