"""Times of one run that contradict its order, jump, or are all the same."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.base import Array
from oed.checks.findings import CheckFinding, Severity
from oed.checks.times.clock import (
    DAY,
    HALF_DAY,
    LEAST,
    PAUSE,
    TURNS,
    TimeColumn,
    TimedRun,
    alike,
    are_apart,
    typical,
)
from oed.dataset.file_rows import Row
from oed.text import capitalised

#: steps of a turn of the clock from which on a jump forward cannot be a step
FAR = 10.0


def findings(runs: Sequence[TimedRun], column: TimeColumn) -> list[CheckFinding]:
    """The first run of each kind of fault, and how many others have one."""
    by_kind: dict[str, list[CheckFinding]] = {}
    for run in runs:
        finding = _finding(run, column) if len(run) >= LEAST else None
        if finding is not None:
            by_kind.setdefault(finding.kind, []).append(finding)
    return [_first(some) for some in by_kind.values()]


def _first(some: Sequence[CheckFinding]) -> CheckFinding:
    first, count = some[0], len(some) - 1
    if not count:
        return first
    runs = "1 other run" if count == 1 else f"{count} other runs"
    rows = tuple(row for one in some for row in one.rows)
    sentence = f"{first.sentence} The same in {runs}."
    return CheckFinding(first.severity, first.kind, sentence, rows)


def _finding(run: TimedRun, column: TimeColumn) -> CheckFinding | None:
    steps = np.diff(run.times)
    if not steps.any():
        return _constant(run, column)
    if (steps < 0.0).any():
        return _backward(run, steps, column)
    return _jump(run, steps, column)


def _constant(run: TimedRun, column: TimeColumn) -> CheckFinding | None:
    if not are_apart(run.joints[1:], run.joints[:-1]).all():
        return None
    sentence = (
        f"{column.name} is {column.written(run.times[0])} in all {len(run)} rows of {run.name} (row"
        f" {run.rows[0]} on), though their poses differ: it is no time of a reading. State"
        " the time of each reading, or leave the cells empty."
    )
    return CheckFinding(Severity.REMARK, "time constant", sentence, run.rows_from())


# -- times that go back ----------------------------------------------------------------


def _backward(run: TimedRun, steps: Array, column: TimeColumn) -> CheckFinding:
    back = np.flatnonzero(steps < 0.0)
    k = int(back[0])
    before, after = run.times[k : k + 2]
    sentence = (
        f"{column.name} runs backward in {run.name}: {column.written(before)} in row {run.rows[k]},"
        f" {column.written(after)} in row {run.rows[k + 1]}, though order has them one after the"
        f" other. {_cause(run, steps, column)}."
    )
    return CheckFinding(Severity.ORDER, "time back", sentence, run.rows_from(k + 1))


def _cause(run: TimedRun, steps: Array, column: TimeColumn) -> str:
    """Why times go back, and the remedy."""
    first = int(np.flatnonzero(steps < 0.0)[0]) + 1
    row = run.rows[first]
    if (steps <= 0.0).all():
        return "The whole run is in reversed order: correct order, or its times"
    turn = _turn(steps)
    if turn is not None:
        return f"{capitalised(TURNS[turn])}: add {_hours(turn)} from row {row} on"
    unit = _other_unit(run.times, first, column)
    if unit is not None:
        return unit.format(row=row, last=run.rows[first - 1])
    single = _single_row(run)
    if single is not None:
        return f"The time of row {single} is wrong: correct it, or leave it empty"
    if run.times[first] <= PAUSE * typical(steps):
        return f"The clock was set to zero at row {row}: add the time that passed"
    return "Correct order or the times"


def _turn(steps: Array) -> float | None:
    """Time after which the clock began again; None where it did not."""
    longest = steps.max()
    for turn in TURNS:
        turned = np.where(steps < 0.0, steps + turn, steps)
        if turned.min() >= 0.0 and turned.max() <= PAUSE * longest < turn:
            return turn
    return None


def _other_unit(times: Array, first: int, column: TimeColumn) -> str | None:
    """In which unit the times from a place on are, or those before it, with the remedy."""
    for unit, factor in column.others.items():
        wrong = f"{unit}, not in {column.unit}"
        after = np.concatenate([times[:first], factor * times[first:]])
        if _go_on(after, first):
            return f"From row {{row}} on they are in {wrong}: convert them"
        before = np.concatenate([factor * times[:first], times[first:]])
        if _go_on(before, first):
            return f"Up to row {{last}} they are in {wrong}: convert them"
    return None


def _go_on(times: Array, first: int) -> bool:
    """Whether times go on at a place with like steps on both sides."""
    steps = np.diff(times)
    sides = steps[: first - 1], steps[first:]
    if not all(len(side) for side in sides) or steps.min() < 0.0:
        return False
    longest = max(float(side.max()) for side in sides)
    is_near = steps[first - 1] <= PAUSE * longest
    return bool(is_near) and alike(*(typical(side) for side in sides))


def _single_row(run: TimedRun) -> Row | None:
    """The one row without which the times are in order; None where there is none."""
    k = int(np.flatnonzero(np.diff(run.times) < 0.0)[0])
    single = [
        one for one in (k, k + 1) if (np.diff(np.delete(run.times, one)) >= 0.0).all()
    ]
    return run.rows[single[0]] if len(single) == 1 else None


# -- times that jump -------------------------------------------------------------------


def _jump(run: TimedRun, steps: Array, column: TimeColumn) -> CheckFinding | None:
    """Half a day or a day too much, or another unit from a row on."""
    k = int(np.argmax(steps))
    others = np.delete(steps, k)
    row = run.rows[k + 1]
    remedy = None
    for turn in (HALF_DAY, DAY):
        is_turn = abs(steps[k] - turn) <= PAUSE * others.max() < turn / FAR
        if is_turn:
            remedy = f"If it was no pause, subtract {_hours(turn)} from there on"
    unit = _other_unit(run.times, k + 1, column)
    if unit is not None and steps[k] > PAUSE * others[:k].max(initial=0.0):
        remedy = unit.format(row=row, last=run.rows[k])
    if remedy is None:
        return None
    sentence = (
        f"{column.name} jumps in {run.name}: {column.written(run.times[k])} in row {run.rows[k]},"
        f" {column.written(run.times[k + 1])} in row {row}. {remedy}."
    )
    return CheckFinding(Severity.REMARK, "time jump", sentence, run.rows_from(k + 1))


def _hours(seconds: float) -> str:
    return f"{seconds / 3600.0:.0f} h"
