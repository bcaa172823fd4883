"""Readings as given, with what the nominal machine predicts of them."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from oed.base.arrays import Array, Mask
from oed.checks.fit import Fit
from oed.checks.mistakes.scope import Scope, part_scopes, run_scopes, whole_scopes
from oed.checks.session import SessionReadings
from oed.dataset.columns import column_name, parse_column
from oed.measurement.measurement import Series

#: noise within which two readings are the same
SAME = 0.2
#: sets of set-ups and channels that are tried, at most: all of a number of set-ups, or none
MOST_SETS = 60
#: a set-up, and channels of it
Use = tuple[str, tuple[str, ...]]


@dataclasses.dataclass(frozen=True, eq=False)
class Given:
    """A session whose mistakes are looked for; its measurement has all set-ups.

    with_amounts  whether mistakes of an amount in the commands are looked for
    at            fit at which readings are linear; None for the nominal machine

    Raises AssemblyError where the nominal machine cannot be read.
    """

    session: SessionReadings
    with_amounts: bool = True
    at: Fit | None = None

    def read(self, series: Sequence[Series], theta: Array) -> tuple[Array, Array]:
        """Readings (N,), SI, and slopes (N, r) over the free parameters in their
        tolerances.
        """
        measurement = self.session.measurement
        y = measurement.readings(series, theta)
        scaled = measurement.in_prior_units(measurement.jacobian(series, theta))
        return y, scaled[:, measurement.free]

    @functools.cached_property
    def nominal(self) -> tuple[Array, Array]:
        """Readings (N,) and slopes (N, r) of the nominal machine."""
        return self.read(self.session.series, self.session.measurement.nominal)

    @functools.cached_property
    def _linear(self) -> tuple[Array, Array]:
        if self.at is None:
            return self.nominal
        y, slopes = self.read(self.session.series, self.at.theta)
        return y - slopes @ self.at.departure, slopes

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
        names = [column_name(c.name, c.unit) for c in command]
        factors = [parse_column(name).factor for name in names]
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
        """Readings (N,) that some values may be deviations from, in words; NaN for none.

        The nominal machine's where they are not those of the instrument's length.
        """
        bases = {}
        if np.isfinite(self.length[values]).any():
            bases["the nominal length"] = self.length
        nominal = self.nominal[0]
        apart = np.abs(nominal - self.length)[values]
        if not (apart < SAME * self.sigma[values]).all():
            bases["the nominal machine"] = nominal
        return bases

    @functools.cached_property
    def shown(self) -> Mask:
        """Values (N,) that a display showed: not those that a pose implies."""
        return self.session.shown

    @functools.cached_property
    def scopes(self) -> list[Scope]:
        """The file, set-ups and runs."""
        return whole_scopes(self.session)

    @property
    def file(self) -> Scope:
        """The whole file."""
        return self.scopes[0]

    @functools.cached_property
    def parts(self) -> list[Scope]:
        """The first and the last rows of set-ups and runs."""
        return part_scopes(self.session)

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
        return shared_instruments(self.session)

    @functools.cached_property
    def targets(self) -> list[Mask]:
        """Values (N,) that one mistake may concern: all, those of a unit, of a channel."""
        kinds = [self.unit == si for si in dict.fromkeys(self.unit)]
        channels = [self.channel == name for name in dict.fromkeys(self.channel)]
        return [self.shown, *[self.shown & one for one in (*kinds, *channels)]]

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
    """Each set of values (N,) that one instrument may have read, in two set-ups or more.

    Sets that are all readings of a unit or of a channel concern the file, and are left out.
    """
    known = {mask.tobytes() for mask in _of_file(session)}
    sets: list[tuple[Scope, Mask]] = []
    for uses_by_size in _uses(session):
        some = []
        for uses in uses_by_size:
            mask = _values(session, uses)
            if mask.tobytes() not in known:
                known.add(mask.tobytes())
                some.append((_scope(session, uses, mask), mask))
            if len(sets) + len(some) > MOST_SETS:
                return sets
        sets += some
    return sets


def _of_file(session: SessionReadings) -> Iterator[Mask]:
    channel = session.values["channel"].to_numpy()
    names = list(dict.fromkeys(channel))
    unit = np.asarray([session.unit(name) for name in channel])
    for name in names:
        yield np.asarray(channel == name) & session.shown
    for si in dict.fromkeys(unit):
        yield np.asarray(unit == si) & session.shown


def _uses(session: SessionReadings) -> Iterator[Iterator[tuple[Use, ...]]]:
    """Set-ups with channels of one unit, by the number of set-ups."""
    channels = _channels_by_unit(session)
    setups = list(dict.fromkeys(s.setup for s in session.series))
    for size in range(2, len(setups) + 1):
        yield _uses_of(channels, itertools.combinations(setups, size))


def _uses_of(
    channels: Sequence[dict[str, list[str]]], groups: Iterator[tuple[str, ...]]
) -> Iterator[tuple[Use, ...]]:
    for members in groups:
        for by_setup in channels:
            if all(name in by_setup for name in members):
                yield tuple((name, tuple(by_setup[name])) for name in members)
                choices = [[(name, (c,)) for c in by_setup[name]] for name in members]
                yield from itertools.product(*choices)


def _channels_by_unit(session: SessionReadings) -> list[dict[str, list[str]]]:
    """Channels with a display by set-up, for each unit in which columns are."""
    by_unit: dict[tuple[str, float], dict[str, list[str]]] = {}
    shown = session.values[session.shown]
    for setup, channel in dict.fromkeys(
        zip(shown["setup"], shown["channel"], strict=True)
    ):
        column = session.column(channel)
        of_unit = by_unit.setdefault((column.unit, column.factor), {})
        of_unit.setdefault(setup, []).append(channel)
    return list(by_unit.values())


def _values(session: SessionReadings, uses: Sequence[Use]) -> Mask:
    mask = np.zeros(len(session), dtype=bool)
    for setup, channels in uses:
        for channel in channels:
            mask |= session.mask(setup, channel)
    return mask


def _scope(session: SessionReadings, uses: Sequence[Use], mask: Mask) -> Scope:
    places = []
    for setup, channels in uses:
        columns = ", ".join(session.column(c).name for c in channels)
        places.append(f"{columns} of {setup}")
    readings = np.unique(session.reading_of_value[mask])
    return Scope("instrument", f"one instrument ({'; '.join(places)})", readings)
