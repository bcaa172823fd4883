"""Times of readings that contradict their order, or each other.

One run: backwards, jumps, another unit from a row on, one time for all rows. Several runs:
another unit, half a day too early, two poses at one time. A machine is at one pose at a
time: runs whose readings are closer in time than half of any step of either contradict;
runs that take turns do not, and are remarked.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from scipy import spatial

from oed.base import Array, Mask
from oed.checks.findings import CheckFinding, Severity
from oed.checks.session import SessionReadings
from oed.dataset import Row
from oed.text import capitalised

HOUR = 3600.0  #: s
HALF_DAY = 12.0 * HOUR  #: time after which a clock of 12 hours begins again, s
DAY = 24.0 * HOUR  #: time after which a clock of 24 hours begins again, s
#: times after which a display begins again, in words
CLOCK_TURNS = {
    HOUR: "the clock shows minutes and seconds alone",
    HALF_DAY: "a clock of 12 hours",
    DAY: "midnight passed",
}
#: seconds of the units that times may be in
TIME_UNITS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": HOUR}
PAUSE_STEPS = 3.0  #: longest steps after which the next reading still follows
ALIKE_RATIO = 1.5  #: ratio up to which steps are alike
MIN_CADENCE_READINGS = 3  #: readings that a run with a cadence has at least
APART_SHARE = 1e-3  #: share of the range of a joint from which on two poses differ


@dataclasses.dataclass(frozen=True)
class TimeColumn:
    """The column of the times: its name, its unit, and the seconds of that unit."""

    name: str
    unit: str
    factor: float

    def written(self, time: float) -> str:
        """A time, s, with the unit of the column."""
        return f"{time / self.factor:.7g} {self.unit}"

    @property
    def others(self) -> dict[str, float]:
        """Factors on times that are in another unit, by its name."""
        ratios = {unit: seconds / self.factor for unit, seconds in TIME_UNITS.items()}
        return {unit: ratio for unit, ratio in ratios.items() if unit != self.unit}


SECONDS = TimeColumn("time_s", "s", 1.0)  #: of times that came from no file


@dataclasses.dataclass(frozen=True, eq=False)
class TimedRun:
    """Readings of a run with a time, by their order."""

    #: names
    setup: str
    run: str
    rows: Array  #: (n,) in the files
    times: Array  #: (n,) s
    joints: Array  #: (n, nq) over their range in the session
    column: TimeColumn = SECONDS  #: of the times

    def __len__(self) -> int:
        return len(self.times)

    @property
    def name(self) -> str:
        """`run c1 of cup`."""
        return f"run {self.run} of {self.setup}"

    @property
    def start(self) -> float:
        """The first time, s."""
        return float(self.times.min())

    @property
    def end(self) -> float:
        """The last time, s."""
        return float(self.times.max())

    @property
    def cadence(self) -> float:
        """Usual time from reading to reading, s."""
        return typical(np.diff(self.times))

    @property
    def least_step(self) -> float:
        """Shortest time from one reading to the next, s."""
        steps = np.diff(np.unique(self.times))
        return float(steps.min()) if steps.size else 0.0

    def stamp(self, k: int) -> str:
        """`120 s in row 7`, of a reading."""
        return f"{self.column.written(self.times[k])} in row {self.rows[k]}"

    def rows_from(self, first: int = 0) -> tuple[Row, ...]:
        """Rows of the files from a reading on."""
        return tuple(self.rows[first:].tolist())

    def scaled(self, factor: float, later: float = 0.0) -> "TimedRun":
        """The run with times times a factor, and later by an amount, s."""
        return dataclasses.replace(self, times=factor * self.times + later)


def typical(steps: Array) -> float:
    """Median (s) of the steps forward; 0 for none."""
    forward = steps[steps > 0.0]
    return float(np.median(forward)) if forward.size else 0.0


def alike(one: float, other: float) -> bool:
    """Whether two steps, s, are alike."""
    least, most = sorted((one, other))
    return 0.0 < most <= ALIKE_RATIO * least


def are_apart(one: Array, other: Array) -> Mask:
    """Mask (n,) of the poses (n, nq) that differ from others."""
    return np.asarray(np.abs(one - other).max(axis=1) > APART_SHARE)


def timed_runs(session: SessionReadings) -> list[TimedRun]:
    """The runs of a session in the order of the file, with the readings that have a time."""
    if "time" not in session.values:
        return []
    column = SECONDS
    if "time" in session.columns:
        written = session.columns["time"]
        unit = written.name.rpartition("_")[2]
        column = TimeColumn(written.name, unit, written.factor)
    joints = session.joints / np.maximum(np.ptp(session.joints, axis=0), 1e-12)
    runs = []
    for setup, run, every in session.ordered_runs():
        ordered = every.dropna(subset="time")
        times = ordered["time"].to_numpy(dtype=float)
        places = joints[ordered["reading"].to_numpy()]
        if len(times):
            rows = ordered["row"].to_numpy()
            runs.append(TimedRun(setup, run, rows, times, places, column))
    return sorted(runs, key=lambda one: one.rows.min())


#: steps of a turn of the clock from which on a jump forward cannot be a step
FAR_STEPS = 10.0


def first_run_fault(runs: Sequence[TimedRun]) -> list[CheckFinding]:
    """The first run of each kind of fault, and how many others have one."""
    by_kind: dict[str, list[CheckFinding]] = {}
    for run in runs:
        finding = _finding(run) if len(run) >= MIN_CADENCE_READINGS else None
        if finding is not None:
            by_kind.setdefault(finding.kind, []).append(finding)
    findings = []
    for first, *others in by_kind.values():
        rows = tuple(row for one in (first, *others) for row in one.rows)
        runs_alike = "1 other run" if len(others) == 1 else f"{len(others)} other runs"
        also = f" The same in {runs_alike}." if others else ""
        sentence = first.sentence + also
        findings.append(CheckFinding(first.severity, first.kind, sentence, rows))
    return findings


def _finding(run: TimedRun) -> CheckFinding | None:
    steps, name = np.diff(run.times), run.column.name
    if not steps.any():
        if not are_apart(run.joints[1:], run.joints[:-1]).all():
            return None
        sentence = (
            f"{name} is {run.column.written(run.times[0])} in all {len(run)} rows of {run.name} (row"
            f" {run.rows[0]} on), though their poses differ: it is no time of a reading. State"
            " the time of each reading, or leave the cells empty."
        )
        return CheckFinding(Severity.REMARK, "time constant", sentence, run.rows_from())
    if (steps < 0.0).any():
        k = int(np.flatnonzero(steps < 0.0)[0])
        sentence = (
            f"{name} runs backward in {run.name}: {run.stamp(k)}, {run.stamp(k + 1)}, though order has"
            f" them one after the other. {_cause(run, steps)}."
        )
        return CheckFinding(Severity.ORDER, "time back", sentence, run.rows_from(k + 1))
    k = int(np.argmax(steps))
    remedy = _remedy_of_jump(run, steps, k)
    if remedy is None:
        return None
    sentence = (
        f"{name} jumps in {run.name}: {run.stamp(k)}, {run.stamp(k + 1)}. {remedy}."
    )
    return CheckFinding(Severity.REMARK, "time jump", sentence, run.rows_from(k + 1))


# -- times that go back ----------------------------------------------------------------
def _cause(run: TimedRun, steps: Array) -> str:
    """Why times go back, and the remedy."""
    first = int(np.flatnonzero(steps < 0.0)[0]) + 1
    row = run.rows[first]
    if (steps <= 0.0).all():
        return "The whole run is in reversed order: correct order, or its times"
    turn = _turn(steps)
    if turn is not None:
        hours = turn / HOUR
        return f"{capitalised(CLOCK_TURNS[turn])}: add {hours:.0f} h from row {row} on"
    unit = _other_unit(run, first)
    if unit is not None:
        return unit
    in_order = [
        run.rows[k]
        for k in (first - 1, first)
        if (np.diff(np.delete(run.times, k)) >= 0.0).all()
    ]
    if len(in_order) == 1:
        return f"The time of row {in_order[0]} is wrong: correct it, or leave it empty"
    if run.times[first] <= PAUSE_STEPS * typical(steps):
        return f"The clock was set to zero at row {row}: add the time that passed"
    return "Correct order or the times"


def _turn(steps: Array) -> float | None:
    """Time after which the clock began again; None where it did not."""
    longest = steps.max()
    for turn in CLOCK_TURNS:
        turned = np.where(steps < 0.0, steps + turn, steps)
        if turned.min() >= 0.0 and turned.max() <= PAUSE_STEPS * longest < turn:
            return turn
    return None


def _other_unit(run: TimedRun, first: int) -> str | None:
    """In which unit the times from a place on are, or those before it, with the remedy."""
    before, after = np.split(run.times, [first])
    for unit, factor in run.column.others.items():
        wrong = f"{unit}, not in {run.column.unit}"
        if _go_on(np.concatenate([before, factor * after]), first):
            return f"From row {run.rows[first]} on they are in {wrong}: convert them"
        if _go_on(np.concatenate([factor * before, after]), first):
            return f"Up to row {run.rows[first - 1]} they are in {wrong}: convert them"
    return None


def _go_on(times: Array, first: int) -> bool:
    """Whether times go on at a place with like steps on both sides."""
    steps = np.diff(times)
    sides = steps[: first - 1], steps[first:]
    if not all(len(side) for side in sides) or steps.min() < 0.0:
        return False
    longest = max(float(side.max()) for side in sides)
    is_near = steps[first - 1] <= PAUSE_STEPS * longest
    return bool(is_near) and alike(*(typical(side) for side in sides))


# -- times that jump -------------------------------------------------------------------
def _remedy_of_jump(run: TimedRun, steps: Array, k: int) -> str | None:
    """Half a day or a day too much, or another unit from row k + 1 on; None of others."""
    others = np.delete(steps, k)
    if steps[k] > PAUSE_STEPS * others[:k].max(initial=0.0):
        unit = _other_unit(run, k + 1)
        if unit is not None:
            return unit
    for turn in (HALF_DAY, DAY):
        if abs(steps[k] - turn) <= PAUSE_STEPS * others.max() < turn / FAR_STEPS:
            hours = turn / HOUR
            return f"If it was no pause, subtract {hours:.0f} h from there on"
    return None


#: turns that bring later runs after earlier ones, in words
LATER_WORDS = {HALF_DAY: "12 h (a clock of 12 hours)", DAY: "24 h (another day)"}

Clash = tuple[TimedRun, int, TimedRun, int]  #: rows of two runs at one time


def first_fault_of_runs(runs: Sequence[TimedRun]) -> list[CheckFinding]:
    """The first fault of the times of several runs."""
    paced = [
        run for run in runs if len(run) >= MIN_CADENCE_READINGS and run.cadence > 0.0
    ]
    if len(paced) < 2:
        return []
    clash = first_clash(paced)
    if clash is not None:
        return [_own_clocks(paced) or _clashing(paced, clash)]
    finding = _run_in_other_unit(paced) or _half_day_back(paced) or _overlapping(paced)
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
    within = 0.5 * min(one.least_step, other.least_step)
    at_once = np.abs(other.times[nearest] - one.times) < within
    at_once &= are_apart(one.joints, other.joints[nearest])
    places = np.flatnonzero(at_once)
    if len(np.unique(one.times[places])) < 2:
        return None
    first = int(places[0])
    pair = (one, first), (other, int(nearest[first]))
    (a, i), (b, j) = sorted(pair, key=lambda entry: entry[0].rows[0])
    return a, i, b, j


def _own_clocks(runs: Sequence[TimedRun]) -> CheckFinding | None:
    """Runs, or set-ups, whose clocks begin alike."""
    column = runs[0].column
    of_setups: dict[str, TimedRun] = {}
    for run in sorted(runs, key=lambda run: run.start):
        of_setups.setdefault(run.setup, run)
    for what, firsts in (("run", list(runs)), ("set-up", list(of_setups.values()))):
        starts = [run.start for run in firsts]
        step = max(run.cadence for run in firsts)
        if len(firsts) > 1 and max(starts) - min(starts) <= PAUSE_STEPS * step:
            sentence = (
                f"{column.name} begins anew in each {what}, near {column.written(min(starts))}: a drift"
                " through the session cannot be distinguished from it. Use one clock for all"
                " set-ups: add the time that passed before each, or leave the cells empty."
            )
            return CheckFinding(Severity.REMARK, "time clocks", sentence)
    return None


def _clashing(runs: Sequence[TimedRun], clash: Clash) -> CheckFinding:
    one, i, other, j = clash
    column = one.column
    sentence = (
        f"{column.name} overlaps: row {one.rows[i]} ({one.name}) is at {column.written(one.times[i])} and"
        f" row {other.rows[j]} ({other.name}) at {column.written(other.times[j])}, with the machine at"
        f" two poses at once. {_remedy(runs)}."
    )
    return CheckFinding(Severity.ORDER, "time clash", sentence, other.rows_from())


def _remedy(runs: Sequence[TimedRun]) -> str:
    """What brings the runs one after the other."""
    column = runs[0].column
    for k, unit in _other_units(runs):
        changed = _with(runs, k, k + 1, column.others[unit], 0.0)
        if first_clash(changed) is None:
            name = capitalised(runs[k].name)
            return f"{name} is in {unit}, not in {column.unit}: convert its times"
    for k in range(1, len(runs)):
        turns = [turn for turn in LATER_WORDS if _follows_later(runs, k, turn)]
        if turns:
            amounts = " or ".join(LATER_WORDS[turn] for turn in turns)
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
def _run_in_other_unit(runs: Sequence[TimedRun]) -> CheckFinding | None:
    """A run with the steps of the others, and in its place, in another unit."""
    for k, unit in _other_units(runs):
        run, column = runs[k], runs[k].column
        sentence = (
            f"{column.name} of {run.name} (row {run.rows[0]} on) looks as if it were in {unit}, not"
            f" in {column.unit}: its steps are {column.written(run.cadence)}, those of other"
            f" runs {column.written(_cadence_of_others(runs, k))}. Convert its times."
        )
        return CheckFinding(Severity.REMARK, "time unit", sentence, run.rows_from())
    return None


def _other_units(runs: Sequence[TimedRun]) -> list[tuple[int, str]]:
    """Runs, by number, with the unit in which they are paced and placed like the others."""
    units = []
    for k, run in enumerate(runs):
        usual = _cadence_of_others(runs, k)
        for unit, factor in run.column.others.items():
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


def _overlapping(runs: Sequence[TimedRun]) -> CheckFinding | None:
    """Runs that take turns, at other poses: no sign of a mistake alone."""
    column = runs[0].column
    by_start = sorted(runs, key=lambda run: run.start)
    for one, other in itertools.pairwise(by_start):
        if other.start < one.end and not _share_poses(one, other):
            begin = other.start
            end = min(one.end, other.end)
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
    return bool(np.mean(distance <= APART_SHARE) >= 0.5)


def _half_day_back(runs: Sequence[TimedRun]) -> CheckFinding | None:
    """Runs that stand after others in the file, and half a day or more before them."""
    for k in range(1, len(runs)):
        back = max(run.end for run in runs[:k]) - runs[k].start
        for turn, text in LATER_WORDS.items():
            if back >= 0.5 * turn and _follows_later(runs, k, turn):
                sentence = (
                    f"{runs[k].column.name} goes back from {runs[k - 1].name} to {runs[k].name} (row"
                    f" {runs[k].rows[0]}). If the runs were taken in the order of the file,"
                    f" add {text} from there on."
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


def wrong_times(session: SessionReadings) -> list[CheckFinding]:
    """What is wrong with the times of a session; nothing where no reading has one."""
    runs = timed_runs(session)
    return first_run_fault(runs) or first_fault_of_runs(runs)
