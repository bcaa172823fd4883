"""Times of several runs: another unit, half a day too early, two poses at one time.

A machine is at one pose at a time. Runs whose readings are closer in time than half of any
step of either contradict; runs that take turns do not, and are remarked.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from scipy import spatial

from oed.checks.findings import CheckFinding, Severity
from oed.checks.times.clock import (
    APART,
    DAY,
    HALF_DAY,
    LEAST,
    PAUSE,
    TimeColumn,
    TimedRun,
    alike,
    are_apart,
)
from oed.text import capitalised

#: times that two runs share from which on they contradict: ends may meet in one
LEAST_SHARED = 2
#: share of the least step within which two readings are at one time
AT_ONCE = 0.5
#: share of common poses from which on two instruments read one run
MOST = 0.5
#: turns that bring later runs after earlier ones, in words
LATER = {HALF_DAY: "12 h (a clock of 12 hours)", DAY: "24 h (another day)"}

#: rows of two runs at one time
Clash = tuple[TimedRun, int, TimedRun, int]


def findings(runs: Sequence[TimedRun], column: TimeColumn) -> list[CheckFinding]:
    """The first fault of the times of several runs."""
    paced = [run for run in runs if len(run) >= LEAST and run.cadence > 0.0]
    if len(paced) < 2:
        return []
    clash = first_clash(paced)
    if clash is not None:
        return [_own_clocks(paced, column) or _clashing(paced, clash, column)]
    finding = (
        _in_other_unit(paced, column)
        or _half_a_day_back(paced, column)
        or _overlapping(paced, column)
    )
    return [finding] if finding else []


# -- two poses at one time -------------------------------------------------------------


def first_clash(runs: Sequence[TimedRun]) -> Clash | None:
    """Two runs with different poses at the same times; None where there are none."""
    by_start = sorted(runs, key=lambda run: run.start)
    for k, one in enumerate(by_start):
        for other in itertools.islice(by_start, k + 1, None):
            if other.start > one.end:
                break
            clash = _clash(one, other)
            if clash is not None:
                return clash
    return None


def _clash(one: TimedRun, other: TimedRun) -> Clash | None:
    sorted_by = np.argsort(other.times, kind="stable")
    times = other.times[sorted_by]
    right = np.clip(np.searchsorted(times, one.times), 1, len(times) - 1)
    is_left = one.times - times[right - 1] < times[right] - one.times
    nearest = sorted_by[np.where(is_left, right - 1, right)]
    within = AT_ONCE * min(one.least_step, other.least_step)
    at_once = np.abs(other.times[nearest] - one.times) < within
    at_once &= are_apart(one.joints, other.joints[nearest])
    places = np.flatnonzero(at_once)
    if len(np.unique(one.times[places])) < LEAST_SHARED:
        return None
    first = int(places[0])
    pair = (one, first), (other, int(nearest[first]))
    (a, i), (b, j) = sorted(pair, key=lambda at: at[0].rows[0])
    return a, i, b, j


def _own_clocks(runs: Sequence[TimedRun], column: TimeColumn) -> CheckFinding | None:
    """Runs, or set-ups, whose clocks begin alike."""
    of_setups: dict[str, TimedRun] = {}
    for run in sorted(runs, key=lambda run: run.start):
        of_setups.setdefault(run.setup, run)
    for what, firsts in (("run", list(runs)), ("set-up", list(of_setups.values()))):
        starts = [run.start for run in firsts]
        step = max(run.cadence for run in firsts)
        if len(firsts) > 1 and max(starts) - min(starts) <= PAUSE * step:
            sentence = (
                f"{column.name} begins anew in each {what}, near {column.written(min(starts))}: a drift"
                " through the session cannot be distinguished from it. Use one clock for all"
                " set-ups: add the time that passed before each, or leave the cells empty."
            )
            return CheckFinding(Severity.REMARK, "time clocks", sentence)
    return None


def _clashing(
    runs: Sequence[TimedRun], clash: Clash, column: TimeColumn
) -> CheckFinding:
    one, i, other, j = clash
    sentence = (
        f"{column.name} overlaps: row {one.rows[i]} ({one.name}) is at {column.written(one.times[i])} and"
        f" row {other.rows[j]} ({other.name}) at {column.written(other.times[j])}, with the machine at"
        f" two poses at once. {_remedy(runs, column)}."
    )
    return CheckFinding(Severity.ORDER, "time clash", sentence, other.rows_from())


def _remedy(runs: Sequence[TimedRun], column: TimeColumn) -> str:
    """What brings the runs one after the other."""
    for k, unit in _other_units(runs, column):
        changed = _with(runs, k, k + 1, column.others[unit], 0.0)
        if first_clash(changed) is None:
            name = capitalised(runs[k].name)
            return f"{name} is in {unit}, not in {column.unit}: convert its times"
    for k in range(1, len(runs)):
        turns = [turn for turn in LATER if _follows_later(runs, k, turn)]
        if turns:
            amounts = " or ".join(LATER[turn] for turn in turns)
            row = runs[k].rows.min()
            return (
                f"The runs follow one another with {amounts} added from row {row} on:"
                " correct the times, or leave the cells empty"
            )
    return "Correct the times, or leave the cells empty"


def _follows_later(runs: Sequence[TimedRun], k: int, turn: float) -> bool:
    """Whether runs follow one another where those from the k-th on are later by a turn."""
    changed = _with(runs, k, len(runs), 1.0, turn)
    return first_clash(changed) is None and all(
        later.start >= max(run.end for run in changed[:k]) for later in changed[k:]
    )


# -- times that are doubtful -----------------------------------------------------------


def _in_other_unit(runs: Sequence[TimedRun], column: TimeColumn) -> CheckFinding | None:
    """A run with the steps of the others, and in its place, in another unit."""
    for k, unit in _other_units(runs, column):
        run = runs[k]
        sentence = (
            f"{column.name} of {run.name} (row {run.rows[0]} on) looks as if it were in {unit}, not"
            f" in {column.unit}: its steps are {column.written(run.cadence)}, those of other"
            f" runs {column.written(_cadence_of_others(runs, k))}. Convert its times."
        )
        return CheckFinding(Severity.REMARK, "time unit", sentence, run.rows_from())
    return None


def _other_units(runs: Sequence[TimedRun], column: TimeColumn) -> list[tuple[int, str]]:
    """Runs, by number, with the unit in which they are paced and placed like the others."""
    units = []
    for k, run in enumerate(runs):
        usual = _cadence_of_others(runs, k)
        for unit, factor in column.others.items():
            changed = _with(runs, k, k + 1, factor, 0.0)
            is_paced = alike(factor * run.cadence, usual)
            if is_paced and _away(changed, k) < _away(runs, k):
                units.append((k, unit))
    return units


def _cadence_of_others(runs: Sequence[TimedRun], k: int) -> float:
    return float(np.median([run.cadence for i, run in enumerate(runs) if i != k]))


def _away(runs: Sequence[TimedRun], k: int) -> float:
    """Time from a run to those beside it in the file; infinite where they overlap."""
    gaps = [0.0]
    if k > 0:
        gaps.append(runs[k].start - runs[k - 1].end)
    if k + 1 < len(runs):
        gaps.append(runs[k + 1].start - runs[k].end)
    return float("inf") if min(gaps) < 0.0 else max(gaps)


def _overlapping(runs: Sequence[TimedRun], column: TimeColumn) -> CheckFinding | None:
    """Runs that take turns, at other poses: no sign of a mistake alone."""
    by_start = sorted(runs, key=lambda run: run.start)
    for one, other in itertools.pairwise(by_start):
        if other.start < one.end and not _share_poses(one, other):
            begin, end = other.start, min(one.end, other.end)
            sentence = (
                f"{capitalised(one.name)} and {other.name} overlap in time, by {column.name}"
                f" from {column.written(begin)} to {column.written(end)}: a run is read"
                " without a break. Correct the times, or name runs by when they were read."
            )
            rows = (one.rows[0], other.rows[0])
            return CheckFinding(Severity.REMARK, "time overlap", sentence, rows)
    return None


def _share_poses(one: TimedRun, other: TimedRun) -> bool:
    """Whether most poses of the shorter run are poses of the other: two instruments."""
    short, long = sorted((one, other), key=len)
    distance, _ = spatial.cKDTree(long.joints).query(short.joints, p=np.inf)
    return bool(np.mean(distance <= APART) >= MOST)


def _half_a_day_back(
    runs: Sequence[TimedRun], column: TimeColumn
) -> CheckFinding | None:
    """Runs that stand after others in the file, and half a day or more before them."""
    for k in range(1, len(runs)):
        back = max(run.end for run in runs[:k]) - runs[k].start
        for turn, words in LATER.items():
            if back >= 0.5 * turn and _follows_later(runs, k, turn):
                sentence = (
                    f"{column.name} goes back from {runs[k - 1].name} to {runs[k].name} (row"
                    f" {runs[k].rows[0]}). If the runs were taken in the order of the file,"
                    f" add {words} from there on."
                )
                rows = tuple(row for run in runs[k:] for row in run.rows_from())
                return CheckFinding(Severity.REMARK, "time later", sentence, rows)
    return None


def _with(
    runs: Sequence[TimedRun], first: int, last: int, factor: float, later: float
) -> list[TimedRun]:
    """The runs, those from `first` to before `last` by a factor and later by an amount, s."""
    changed = [run.scaled(factor, later) for run in runs[first:last]]
    return [*runs[:first], *changed, *runs[last:]]
