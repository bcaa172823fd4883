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

MIN_PART = 3  #: readings that a part of a run, and what remains of it, have at least
MAX_PARTS = 200  #: parts of a session that are looked at first


@dataclasses.dataclass(frozen=True, eq=False)
class Scope:
    """Values of a session that one mistake may concern."""

    data: "Suspect"  #: the session
    #: `file`, `instrument` (of several set-ups), `set-up`, `runs` (some of several),
    #: `run` or `rows`
    level: str
    name: str  #: `run cup 1`; empty for the file
    readings: Index  #: their numbers, ascending
    values: Mask  #: (N,) values of these: all, those of a unit, or those of a channel
    each: bool = False  #: whether it is each run of the file by itself

    @property
    def session(self) -> SessionReadings:
        """The session as given."""
        return self.data.session

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

    @property
    def runs(self) -> "list[Scope]":
        """Each run that it has whole."""
        runs = self.data.runs
        return [run for run in runs if np.isin(run.readings, self.readings).all()]

    @property
    def sequences(self) -> "list[Scope]":
        """Readings that follow each other: those of its runs, or all of them."""
        return self.runs if self.each or self.level == "runs" else [self]

    @property
    def shown(self) -> Mask:
        """Values (N,) that an instrument showed of its readings."""
        number = self.session.reading_of_value
        return np.isin(number, self.readings) & self.data.shown

    @functools.cached_property
    def channels(self) -> tuple[str, ...]:
        """Channels of the values."""
        return tuple(dict.fromkeys(map(str, self.data.channel[self.values])))

    def is_of(self, unit: str) -> bool:
        """Whether all values have an SI unit."""
        return set(self.data.unit[self.values]) == {unit}

    @property
    def columns(self) -> str:
        """Columns of the values."""
        return ", ".join(self.session.column(name).name for name in self.channels)

    @property
    def columns_within(self) -> str:
        """`length_mm in run cup 1`."""
        return f"{self.columns}{self.within}"

    @property
    def has_all(self) -> bool:
        """Whether the values are all that an instrument showed."""
        return self.level == "instrument" or np.array_equal(self.values, self.shown)

    @property
    def subject(self) -> str:
        """`the readings of run cup 1`, or of some columns in it."""
        of = self.of if self.has_all else f" of {self.columns_within}"
        return f"the readings{of}"


def several_runs(runs: Sequence[Scope]) -> Scope:
    """Some runs together."""
    names = [run.name.removeprefix("run ") for run in runs]
    readings = np.sort(np.concatenate([run.readings for run in runs]))
    name = f"runs {', '.join(names[:-1])} and {names[-1]}"
    return runs[0].data.scope("runs", name, readings)


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

    def log_density_of_any(self, values: Mask) -> float:
        """Log density, SI, of values (N,) that may be anything: heavy-tailed about nominal."""
        width = 3.0 * self.spread[values]
        away = (self.session.y[values] - self.predicted[values]) / width
        return float(-(np.log(np.pi * width) + np.log1p(away**2)).sum())

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
        columns = [ReadingsColumn.of(c.name, c.unit) for c in command]
        pairs = zip(columns, self.command.T, strict=True)
        return {column.name: values / column.factor for column, values in pairs}

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

    # -- parts of the session ----------------------------------------------------------
    def scope(self, level: str, name: str, readings: Index) -> Scope:
        """Some readings, by number, with all of their values."""
        values = np.isin(self.session.reading_of_value, readings)
        return Scope(self, level, name, readings, values)

    def rows_scope(self, readings: Index) -> Scope:
        """Some rows, by their first and last one."""
        rows = self.session.rows(readings)
        return self.scope("rows", f"rows {min(rows)} to {max(rows)}", readings)

    @functools.cached_property
    def scopes(self) -> list[Scope]:
        """The file, each of several set-ups, and each of several runs."""
        number = self.session.reading_of_value
        scopes = [self.scope("file", "", np.unique(number))]
        names = list(dict.fromkeys(s.setup for s in self.session.series))
        if len(names) > 1:
            for name in names:
                readings = np.unique(number[self.session.mask(name)])
                scopes.append(self.scope("set-up", f"set-up {name}", readings))
        has_runs = len(self.runs) > max(len(names), 1) and not self.whole
        return [*scopes, *self.runs] if has_runs else scopes

    @property
    def file(self) -> Scope:
        """The whole file."""
        return self.scopes[0]

    @property
    def sequential(self) -> list[Scope]:
        """Each of several runs by itself, all at once, then the file, set-ups and runs."""
        each = dataclasses.replace(self.file, name="each run", each=True)
        return [each, *self.scopes] if len(self.runs) > 1 else self.scopes

    @functools.cached_property
    def runs(self) -> list[Scope]:
        """Each run, by its name; with its set-up where two runs have one name."""
        groups = self.session.values.groupby(["setup", "run"], sort=False).indices
        labels = [run for _, run in groups]
        scopes = []
        for (setup, run), rows in groups.items():
            of_setup = f" of {setup}" if labels.count(run) > 1 else ""
            readings = np.unique(self.session.reading_of_value[rows])
            scopes.append(self.scope("run", f"run {run}{of_setup}", readings))
        return scopes

    @functools.cached_property
    def cut_step(self) -> int:
        """Rows from cut to cut of set-ups and runs in `parts`."""
        places = sum(2 * len(scope.readings) for scope in self._cut_scopes)
        return max(1, -(-places // MAX_PARTS))

    @property
    def _cut_scopes(self) -> list[Scope]:
        return self.scopes[1:] or self.scopes

    @functools.cached_property
    def parts(self) -> list[Scope]:
        """The first and the last rows of set-ups and runs, cut at all or some of them."""
        return [] if self.whole else self._cut(self.cut_step)

    def parts_near(self, others: Sequence[Scope]) -> list[Scope]:
        """Those cut at any row that begin and end less than a step from some others."""
        return self._cut(1, [part.readings[[0, -1]] for part in others])

    def _cut(self, step: int, near: Sequence[Index] | None = None) -> list[Scope]:
        listed = {tuple(scope.readings) for scope in self.scopes}
        scopes = []
        for whole in self._cut_scopes:
            ends = range(MIN_PART, len(whole.readings) - MIN_PART + 1, step)
            for readings in (
                part for k in ends for part in np.split(whole.readings, [k])
            ):
                is_near = near is None or any(
                    np.abs(readings[[0, -1]] - other).max() < self.cut_step
                    for other in near
                )
                if is_near and tuple(readings) not in listed:
                    listed.add(tuple(readings))
                    scopes.append(self.rows_scope(readings))
        return scopes

    @functools.cached_property
    def instruments(self) -> list[Scope]:
        """Values that one instrument may have read in several set-ups."""
        return [] if self.whole else shared_instruments(self)

    @functools.cached_property
    def targets(self) -> list[Mask]:
        """Values (N,) that one mistake may concern: all, those of a unit, of a channel."""
        kinds = [self.unit == si for si in dict.fromkeys(self.unit)]
        channels = [self.channel == name for name in dict.fromkeys(self.channel)]
        return [self.shown, *[self.shown & one for one in (*kinds, *channels)]]

    @functools.cached_property
    def targeted(self) -> list[list[Scope]]:
        """Each target in the scopes and parts where no other has the same values."""
        scopes = [*self.scopes, *self.parts]
        return [
            [part for scope in scopes if (part := self.target_in(scope, k)) is not None]
            for k in range(len(self.targets))
        ]

    def target_in(self, scope: Scope, target: int) -> Scope | None:
        """A target, by number, in a scope; None where another has the same values."""
        inside = np.isin(self.session.reading_of_value, scope.readings)
        targets = self.targets
        values = targets[target] & inside
        is_known = any(np.array_equal(values, t & inside) for t in targets[:target])
        if scope.level == "set-up":  # all that the file has of it
            is_known |= any(np.array_equal(values, other) for other in targets)
        if is_known or not values.any():
            return None
        return dataclasses.replace(scope, values=values)


# -- one instrument in several set-ups -------------------------------------------------
def shared_instruments(data: Suspect) -> list[Scope]:
    """Values that one instrument may have read in two set-ups or more."""
    session = data.session
    known = {target.tobytes() for target in data.targets}
    scopes: list[Scope] = []
    setups = list(dict.fromkeys(s.setup for s in session.series))
    for size in range(2, len(setups) + 1):
        some = []
        for uses in _uses(session, list(itertools.combinations(setups, size))):
            masks = [session.mask(setup, c) for setup, few in uses for c in few]
            mask = np.logical_or.reduce(masks)
            if mask.tobytes() not in known:
                known.add(mask.tobytes())
                some.append(_instrument_scope(data, uses, mask))
            if len(scopes) + len(some) > MAX_SETS:
                return scopes
        scopes += some
    return scopes


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


def _instrument_scope(data: Suspect, uses: Sequence[Use], mask: Mask) -> Scope:
    session = data.session
    places = []
    for setup, channels in uses:
        columns = ", ".join(session.column(c).name for c in channels)
        places.append(f"{columns} of {setup}")
    readings = np.unique(session.reading_of_value[mask])
    name = f"one instrument ({'; '.join(places)})"
    return Scope(data, "instrument", name, readings, mask)
