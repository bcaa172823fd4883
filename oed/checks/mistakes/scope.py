"""Which part of a session a mistake concerns: the file, a set-up, a run, or rows of one."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from oed.base import Index, Mask
from oed.checks.session import SessionReadings

#: readings that a part of a run, and what remains of it, have at least
LEAST_PART = 3
#: parts of a session that are looked at first
MOST_PARTS = 200


@dataclasses.dataclass(frozen=True)
class Scope:
    """Readings of a session.

    level     `file`, `instrument` (of several set-ups), `set-up`, `runs` (some of
              several), `run` or `rows`
    name      `run cup 1`; empty for the file
    readings  their numbers, ascending
    """

    level: str
    name: str
    readings: Index

    @property
    def is_part(self) -> bool:
        """Whether readings of the same set-ups are outside."""
        return self.level in ("runs", "run", "rows")

    @property
    def of(self) -> str:
        """` of run cup 1`."""
        return f" of {self.name}" if self.name else ""

    @property
    def within(self) -> str:
        """` in run cup 1`."""
        return f" in {self.name}" if self.name else ""

    def values(self, session: SessionReadings) -> Mask:
        """Mask (N,) of the values of the readings."""
        number = session.reading_of_value
        inside = np.zeros(1 + int(number[-1]), dtype=bool)
        inside[self.readings] = True
        return np.asarray(inside[number])


def whole_scopes(session: SessionReadings) -> list[Scope]:
    """The file, each of several set-ups, and each of several runs."""
    number = session.reading_of_value
    scopes = [Scope("file", "", np.unique(number))]
    names = list(dict.fromkeys(s.setup for s in session.series))
    if len(names) > 1:
        for name in names:
            readings = np.unique(number[session.mask(name)])
            scopes.append(Scope("set-up", f"set-up {name}", readings))
    runs = run_scopes(session)
    return [*scopes, *runs] if len(runs) > max(len(names), 1) else scopes


def run_scopes(session: SessionReadings) -> list[Scope]:
    """Each run, by its name; with its set-up where two runs have one name."""
    frame, number = session.values, session.reading_of_value
    groups = frame.groupby(["setup", "run"], sort=False).indices
    labels = [run for _, run in groups]
    scopes = []
    for (setup, run), rows in groups.items():
        of_setup = f" of {setup}" if labels.count(run) > 1 else ""
        name = f"run {run}{of_setup}"
        scopes.append(Scope("run", name, np.unique(number[rows])))
    return scopes


def several_runs(runs: Sequence[Scope]) -> Scope:
    """Some runs together."""
    names = [run.name.removeprefix("run ") for run in runs]
    readings = np.sort(np.concatenate([run.readings for run in runs]))
    return Scope("runs", f"runs {', '.join(names[:-1])} and {names[-1]}", readings)


def part_scopes(
    session: SessionReadings, near: Sequence[Scope] | None = None
) -> list[Scope]:
    """The first rows of each set-up and run, and the last ones.

    near  parts near whose ends every cut is made; by default it is made at every row, or
          every few rows of a long session
    """
    whole = whole_scopes(session)
    wholes = [scope for scope in whole if scope.level != "file"] or whole
    step = _step(wholes)
    known = {tuple(scope.readings) for scope in whole}
    scopes = []
    for scope in wholes:
        for readings in _cut(scope.readings, 1 if near is not None else step):
            is_near = near is None or any(
                _ends_near(readings, part.readings, step) for part in near
            )
            if is_near and tuple(readings) not in known:
                known.add(tuple(readings))
                scopes.append(rows_scope(session, readings))
    return scopes


def cuts_are_coarse(session: SessionReadings) -> bool:
    """Whether sets-ups and runs are not cut at every row."""
    whole = whole_scopes(session)
    return _step([scope for scope in whole if scope.level != "file"] or whole) > 1


def _step(wholes: Sequence[Scope]) -> int:
    """Rows from cut to cut."""
    places = sum(2 * len(scope.readings) for scope in wholes)
    return max(1, -(-places // MOST_PARTS))


def _cut(readings: Index, step: int) -> Iterator[Index]:
    """The first and the last of some readings, at every so many."""
    for k in range(LEAST_PART, len(readings) - LEAST_PART + 1, step):
        yield readings[:k]
        yield readings[k:]


def _ends_near(one: Index, other: Index, step: int) -> bool:
    """Whether two parts begin and end less than a step apart."""
    ends = (abs(int(one[k]) - int(other[k])) for k in (0, -1))
    return max(ends) < step


def rows_scope(session: SessionReadings, readings: Index) -> Scope:
    """Some rows, by their first and last one."""
    rows = session.rows(readings)
    return Scope("rows", f"rows {min(rows)} to {max(rows)}", readings)
