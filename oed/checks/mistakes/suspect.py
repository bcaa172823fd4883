"""Readings as given, with what the nominal machine predicts of them."""

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from oed.base import Array, Index, Mask
from oed.checks.fit import Fit
from oed.checks.session import SessionReadings
from oed.dataset import ReadingsColumn
from oed.measurement import Series

# Which part of a session a mistake concerns: the file, a set-up, a run, or rows of one.

MIN_PART = 3  #: readings that a part of a run, and what remains of it, have at least
MAX_PARTS = 200  #: parts of a session that are looked at first


@dataclasses.dataclass(frozen=True)
class Scope:
    """Readings of a session."""

    #: `file`, `instrument` (of several set-ups), `set-up`, `runs` (some of several),
    #: `run` or `rows`
    level: str
    name: str  #: `run cup 1`; empty for the file
    readings: Index  #: their numbers, ascending

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
    """First and last rows of set-ups and runs, cut at all, some, or `near`."""
    whole = whole_scopes(session)
    wholes = [scope for scope in whole if scope.level != "file"] or whole
    step = _step(wholes)
    listed = {tuple(scope.readings) for scope in whole}
    scopes = []
    for scope in wholes:
        for readings in _cut(scope.readings, 1 if near is not None else step):
            is_near = near is None or any(
                _ends_near(readings, part.readings, step) for part in near
            )
            if is_near and tuple(readings) not in listed:
                listed.add(tuple(readings))
                scopes.append(rows_scope(session, readings))
    return scopes


def cuts_are_coarse(session: SessionReadings) -> bool:
    """Whether sets-ups and runs are not cut at every row."""
    whole = whole_scopes(session)
    return _step([scope for scope in whole if scope.level != "file"] or whole) > 1


def _step(wholes: Sequence[Scope]) -> int:
    """Rows from cut to cut."""
    places = sum(2 * len(scope.readings) for scope in wholes)
    return max(1, -(-places // MAX_PARTS))


def _cut(readings: Index, step: int) -> Iterator[Index]:
    """The first and the last of some readings, at every so many."""
    for k in range(MIN_PART, len(readings) - MIN_PART + 1, step):
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


#: sets of set-ups and channels that are tried, at most: all of a number of set-ups, or none
MAX_SETS = 60
Use = tuple[str, tuple[str, ...]]  #: a set-up, and channels of it


@dataclasses.dataclass(frozen=True, eq=False)
class Suspect:
    """A session whose mistakes are looked for; its measurement has all set-ups.

    whole  whether only mistakes of the file and of set-ups, without an amount, count
    at     fit at which readings are linear; None for the nominal machine

    Raises AssemblyError where the nominal machine cannot be read.
    """

    session: SessionReadings
    whole: bool = False
    at: Fit | None = None

    def read(self, series: Sequence[Series], theta: Array) -> tuple[Array, Array]:
        """Readings (N,), SI, and slopes (N, r) over the free parameters in their
        tolerances.
        """
        measurement = self.session.measurement
        y = measurement.readings(series, theta)
        scaled = measurement.in_prior_units(measurement.jacobian(series, theta))
        return y, scaled[:, measurement.free]

    def linear(self, series: Sequence[Series]) -> tuple[Array, Array]:
        """The same of the nominal machine in the linear model."""
        if self.at is None:
            return self.read(series, self.session.measurement.nominal)
        y, slopes = self.read(series, self.at.theta)
        return y - slopes @ self.at.departure, slopes

    @functools.cached_property
    def nominal(self) -> Array:
        """Readings (N,) of the nominal machine, SI."""
        measurement = self.session.measurement
        return measurement.readings(self.session.series, measurement.nominal)

    @functools.cached_property
    def _linear(self) -> tuple[Array, Array]:
        return self.linear(self.session.series)

    @property
    def predicted(self) -> Array:
        """Readings (N,) of the nominal machine, SI, in the linear model."""
        return self._linear[0]

    @property
    def slopes(self) -> Array:
        """Slopes (N, r) over the free parameters in their tolerances, SI."""
        return self._linear[1]

    @functools.cached_property
    def sigma(self) -> Array:
        """Stated noise (N,), SI."""
        return self.session.measurement.sigma(self.session.series)

    @functools.cached_property
    def spread(self) -> Array:
        """Standard deviation (N,) of the prediction by tolerances and noise, SI."""
        by_tolerance = np.linalg.norm(self.slopes, axis=1)
        return np.asarray(np.hypot(by_tolerance, self.sigma))

    @functools.cached_property
    def channel(self) -> Array:
        """Channel (N,) of each value, by name."""
        return np.asarray(self.session.values["channel"].to_numpy())

    @functools.cached_property
    def unit(self) -> Array:
        """SI unit (N,) of each value."""
        units = {c: self.session.unit(c) for c in dict.fromkeys(self.channel)}
        return np.asarray([units[c] for c in self.channel])

    @functools.cached_property
    def command(self) -> Array:
        """Commanded poses (n, n_dof) of the readings, SI; NaN where there are none."""
        return np.vstack([s.command[s.index[:, 0]] for s in self.session.series])

    @functools.cached_property
    def columns(self) -> dict[str, Array]:
        """The same (n,) by column of the file, in its unit."""
        command = self.session.measurement.machine.command
        names = [ReadingsColumn.of(c.name, c.unit).name for c in command]
        factors = [ReadingsColumn.parse(name).factor for name in names]
        return dict(zip(names, (self.command / factors).T, strict=True))

    @functools.cached_property
    def length(self) -> Array:
        """Reading (N,) that each instrument keeps by design; NaN where there is none."""
        session = self.session
        values = np.full(len(session), np.nan)
        for name, setup in session.measurement.setups.items():
            if setup.instrument.fixed_reading is not None:
                first = setup.instrument.channels[0].name
                fixed = setup.instrument.fixed_reading(setup.settings)
                values[session.mask(name, first)] = fixed
        return values

    def bases(self, values: Mask) -> dict[str, Array]:
        """Readings (N,) that some values may deviate from, in words; or NaN."""
        bases = {}
        if np.isfinite(self.length[values]).any():
            bases["the nominal length"] = self.length
        apart = np.abs(self.nominal - self.length)[values]
        if not (apart < 0.2 * self.sigma[values]).all():
            bases["the nominal machine"] = self.nominal
        return bases

    @functools.cached_property
    def shown(self) -> Mask:
        """Values (N,) that a display showed: not those that a pose implies."""
        return self.session.shown

    @functools.cached_property
    def scopes(self) -> list[Scope]:
        """The file, set-ups and runs."""
        scopes = whole_scopes(self.session)
        return [s for s in scopes if not (self.whole and s.is_part)]

    @property
    def file(self) -> Scope:
        """The whole file."""
        return self.scopes[0]

    @functools.cached_property
    def parts(self) -> list[Scope]:
        """The first and the last rows of set-ups and runs."""
        return [] if self.whole else part_scopes(self.session)

    @functools.cached_property
    def runs(self) -> list[Scope]:
        """Each run."""
        return run_scopes(self.session)

    def runs_in(self, scope: Scope) -> list[Scope]:
        """Each run that a scope has whole."""
        return [s for s in self.runs if np.isin(s.readings, scope.readings).all()]

    @functools.cached_property
    def instruments(self) -> list[tuple[Scope, Mask]]:
        """Values (N,) that one instrument may have read in several set-ups."""
        return [] if self.whole else shared_instruments(self.session)

    @functools.cached_property
    def targets(self) -> list[Mask]:
        """Values (N,) that one mistake may concern: all, those of a unit, of a channel."""
        kinds = [self.unit == si for si in dict.fromkeys(self.unit)]
        channels = [self.channel == name for name in dict.fromkeys(self.channel)]
        return [self.shown, *[self.shown & one for one in (*kinds, *channels)]]

    @functools.cached_property
    def places(self) -> list[list[tuple[Scope, Mask]]]:
        """Each target's scopes and its values (N,) there, where no other has the same."""
        scopes = [*self.scopes, *self.parts]
        return [
            [
                (s, values)
                for s in scopes
                if (values := self.values_in(s, k)) is not None
            ]
            for k in range(len(self.targets))
        ]

    def values_in(self, scope: Scope, target: int) -> Mask | None:
        """Values (N,) of a target, by number, in a scope; None where another has the same."""
        inside = scope.values(self.session)
        targets = self.targets
        values = targets[target] & inside
        is_known = any(np.array_equal(values, t & inside) for t in targets[:target])
        if scope.level == "set-up":  # all that the file has of it
            is_known |= any(np.array_equal(values, other) for other in targets)
        return values if values.any() and not is_known else None

    def names(self, values: Mask) -> str:
        """Columns of some values (N,)."""
        channels = dict.fromkeys(self.channel[values])
        return ", ".join(self.session.column(str(name)).name for name in channels)

    def is_all(self, scope: Scope, values: Mask) -> bool:
        """Whether some values (N,) are all that an instrument showed in a scope."""
        shown = scope.values(self.session) & self.shown
        return scope.level == "instrument" or np.array_equal(values, shown)


# -- one instrument in several set-ups -------------------------------------------------
def shared_instruments(session: SessionReadings) -> list[tuple[Scope, Mask]]:
    """Values (N,) that one instrument may have read in two set-ups or more."""
    channel = session.values["channel"].to_numpy()
    units = np.array([session.unit(name) for name in channel])
    keys = [(key, name) for key in (channel, units) for name in dict.fromkeys(key)]
    known = {((key == name) & session.shown).tobytes() for key, name in keys}
    sets: list[tuple[Scope, Mask]] = []
    setups = list(dict.fromkeys(s.setup for s in session.series))
    for size in range(2, len(setups) + 1):
        some = []
        for uses in _uses(session, list(itertools.combinations(setups, size))):
            masks = [session.mask(setup, c) for setup, few in uses for c in few]
            mask = np.logical_or.reduce(masks)
            if mask.tobytes() not in known:
                known.add(mask.tobytes())
                some.append((_scope(session, uses, mask), mask))
            if len(sets) + len(some) > MAX_SETS:
                return sets
        sets += some
    return sets


def _uses(
    session: SessionReadings, groups: Sequence[tuple[str, ...]]
) -> Iterator[Sequence[Use]]:
    """Set-ups of each group with their channels of one unit, or with one of these."""
    shown = session.values[session.shown]
    by_unit: dict[tuple[str, float], list[Use]] = {}
    for setup, name in dict.fromkeys(
        zip(shown["setup"], shown["channel"], strict=True)
    ):
        column = session.column(name)
        by_unit.setdefault((column.unit, column.factor), []).append((setup, (name,)))
    for members, uses in itertools.product(groups, by_unit.values()):
        choices = [[use for use in uses if use[0] == setup] for setup in members]
        if all(choices):
            yield [(few[0][0], tuple(c for _, (c,) in few)) for few in choices]
            yield from itertools.product(*choices)


def _scope(session: SessionReadings, uses: Sequence[Use], mask: Mask) -> Scope:
    places = []
    for setup, channels in uses:
        columns = ", ".join(session.column(c).name for c in channels)
        places.append(f"{columns} of {setup}")
    readings = np.unique(session.reading_of_value[mask])
    return Scope("instrument", f"one instrument ({'; '.join(places)})", readings)
