"""The readings of a session as checks use them: values, series, rows of the file, law.

The noise law by which readings are checked is estimated from them, as a fit does. One that
relates readings (an error of a run, one that is carried along) is no misfit. How far single
readings scatter is judged against the stated noise.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd
import scipy

from oed import units
from oed.base import Array, Index, Mask, consecutive_slices
from oed.dataset import ReadingsColumn, Row, named_rows, written
from oed.measurement import Measurement, Series, draw_parameters, reading_structure
from oed.noise import Laws, Noise, ReadingStructure


@dataclasses.dataclass(frozen=True, eq=False)
class CheckedLaw:
    """A noise law that is not tied to a set of readings."""

    #: of each group of readings, `set-up.channel`, over the stated noise
    scale: Mapping[str, float]
    law: Laws  #: its other numbers, as one of some laws
    theta: Array  #: (n,) parameters at which slopes over renewed unknowns are taken

    def noise(self, measurement: Measurement, series: Sequence[Series]) -> Noise:
        """The noise of readings under the law, SI."""
        theta = self.theta
        if len(theta) != len(measurement.nominal):
            theta = measurement.nominal
        structure = reading_structure(measurement, series, theta)
        return self.laws(structure).noise(structure)

    def laws(self, structure: ReadingStructure) -> Laws:
        """The law for readings of a structure; groups it does not know are as stated."""
        scale = np.array([[self.scale.get(name, 1.0) for name in structure.names]])
        return dataclasses.replace(self.law, scale=scale)

    def with_scale(self, least: float, most: float) -> "CheckedLaw":
        """The law with scales no smaller and no larger than these."""
        scale = {k: float(np.clip(v, least, most)) for k, v in self.scale.items()}
        return dataclasses.replace(self, scale=scale)

    def size(self, structure: ReadingStructure) -> float:
        """Standard deviation of a reading over the stated one, of the group that has
        most.
        """
        laws = self.laws(structure)
        shared = (structure.columns * laws.sizes[0, structure.kinds]) ** 2
        stated = (structure.columns**2)[:, structure.kinds == 1].sum(axis=1)
        scale = laws.scale[0, structure.group]
        ratio = scale * np.sqrt((1.0 + shared.sum(axis=1)) / (1.0 + stated))
        return float(ratio.max())


@dataclasses.dataclass(frozen=True)
class SessionReadings:
    """Readings to check."""

    measurement: Measurement  #: machine with the set-ups of the readings, or with more
    series: tuple[Series, ...]  #: readings, by set-up
    y: Array  #: (N,) values, SI: series after series, channels innermost
    #: one row a value: setup, run, order, row in the file, channel
    values: pd.DataFrame
    #: columns of the file by stem; written as a result is, where absent
    columns: Mapping[str, ReadingsColumn] = dataclasses.field(default_factory=dict)
    #: noise law of the readings; None for the stated noise
    law: CheckedLaw | None = None
    #: factors on the tolerances of parameters, by name
    wider: Mapping[str, float] = dataclasses.field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.y)

    @functools.cached_property
    def spans(self) -> tuple[slice, ...]:
        """Where the values of each series are in y."""
        return consecutive_slices(
            [len(s) * self.channel_count(s.setup) for s in self.series]
        )

    @functools.cached_property
    def reading_of_value(self) -> Index:
        """Number (N,), from 0, of the reading that each value belongs to."""
        counts = [
            np.full(len(s), self.channel_count(s.setup), dtype=np.intp)
            for s in self.series
        ]
        sizes = np.concatenate(counts)
        return np.repeat(np.arange(len(sizes), dtype=np.intp), sizes)

    @functools.cached_property
    def joints(self) -> Array:
        """Joints (n, nq) of each reading, SI."""
        return np.vstack([s.q[s.index[:, 0]] for s in self.series])

    def ordered_runs(self) -> Iterator[tuple[str, str, pd.DataFrame]]:
        """Set-up and run with a row for each of its readings, numbered, by their order."""
        frame = self.values.iloc[self.firsts]
        frame = frame.assign(reading=np.arange(len(frame)))
        for (setup, run), rows in frame.groupby(["setup", "run"], sort=False):
            yield str(setup), str(run), rows.sort_values("order", kind="stable")

    @property
    def firsts(self) -> Index:
        """First value (n,) of each reading."""
        return np.unique(self.reading_of_value, return_index=True)[1]

    def channel_count(self, setup: str) -> int:
        """Number of channels of a set-up."""
        return len(self.measurement.setups[setup].instrument.channels)

    @property
    def shown(self) -> Mask:
        """Mask (N,) of the values that a display showed: not those that a pose implies."""
        shown = np.ones(len(self), dtype=bool)
        for name, setup in self.measurement.setups.items():
            if setup.instrument.implied is not None:
                shown &= ~self.mask(name)
        return shown

    def take(self, readings: Index) -> "SessionReadings":
        """The session with these readings only, by number, in ascending order."""
        chosen = np.zeros(1 + int(self.reading_of_value[-1]), dtype=bool)
        chosen[readings] = True
        sizes = [len(s) for s in self.series]
        series = [
            s.take(np.flatnonzero(chosen[span]))
            for s, span in zip(self.series, consecutive_slices(sizes), strict=True)
            if chosen[span].any()
        ]
        used = chosen[self.reading_of_value]
        values = self.values[used].reset_index(drop=True)
        return dataclasses.replace(
            self, series=tuple(series), y=self.y[used], values=values
        )

    def without(self, readings: Sequence[int] | Index) -> "SessionReadings":
        """The session without these readings, by number."""
        every = np.arange(1 + int(self.reading_of_value[-1]))
        return self.take(np.setdiff1d(every, np.asarray(readings, dtype=np.intp)))

    def rows(self, readings: Sequence[int] | Index) -> tuple[Row, ...]:
        """Rows of the files of readings, by number."""
        row = self.values["row"].to_numpy()
        reading = self.reading_of_value
        first = np.searchsorted(reading, np.asarray(readings, dtype=np.intp))
        return tuple(row[first].tolist())

    def file_of(self, value: int) -> str:
        """The file of a value, by number; empty where there is one alone."""
        return getattr(self.values["row"].iloc[value], "file", "")

    def with_y(self, y: Array) -> "SessionReadings":
        """The session with other values (N,), SI."""
        return dataclasses.replace(self, y=y)

    def with_sigma(self, sigma: Array) -> "SessionReadings":
        """The session with another noise (N,) of single readings, SI."""
        series = tuple(
            dataclasses.replace(s, sigma=sigma[span].reshape(len(s), -1))
            for s, span in zip(self.series, self.spans, strict=True)
        )
        return dataclasses.replace(self, series=series)

    def mask(self, setup: str, channel: str | None = None) -> Mask:
        """Mask (N,) of the values of a set-up, or of one channel of it."""
        mask = (self.values["setup"] == setup).to_numpy()
        if channel is not None:
            mask = mask & (self.values["channel"] == channel).to_numpy()
        return np.asarray(mask)

    # -- what a fit needs --------------------------------------------------------------
    def noise(self) -> Noise:
        """Noise of the readings, SI: by the law, or as stated."""
        if self.law is None:
            return self.measurement.noise(self.series)
        return self.law.noise(self.measurement, self.series)

    def prior_root(self) -> Array:
        """Root (n, r), SI, of the prior covariance over the free parameters."""
        measurement = self.measurement
        free = np.flatnonzero(measurement.free)
        names = [measurement.names[k] for k in free]
        factor = np.array([self.wider.get(name, 1.0) for name in names])
        return np.asarray(measurement.prior_root()[:, free] * factor)

    # -- words -------------------------------------------------------------------------
    def column(self, channel: str) -> ReadingsColumn:
        """Column of a channel, as in the file."""
        if channel in self.columns:
            return self.columns[channel]
        return ReadingsColumn.of(channel, self.unit(channel))

    def unit(self, channel: str) -> str:
        """SI unit of a channel."""
        for setup in self.measurement.setups.values():
            for one in setup.instrument.channels:
                if one.name == channel:
                    return one.unit
        raise KeyError(channel)

    def written(self, channel: str, value: float) -> str:
        """An SI value in the unit of its column, without the unit."""
        column = self.column(channel)
        return f"{value / column.factor:.7g}"

    def fine(self, channel: str, value: float) -> str:
        """A difference of readings, SI, in the fine unit of its channel, if it is small."""
        si = self.unit(channel)
        number = units.number(value, units.FINE[si])
        if abs(number) < 1000.0:
            return f"{number:.3g} {units.FINE[si]}"
        number, unit = written(value, si)
        return f"{number:.4g} {unit}"

    def predict_ranges(self, rng: np.random.Generator) -> "Ranges":
        """Ranges of a session's readings. Raises AssemblyError at the nominal machine."""
        measurement, series = self.measurement, self.series
        nominal = measurement.nominal
        middle = measurement.readings(series, nominal)
        noise = measurement.sigma(series)
        slopes = measurement.jacobian(series, nominal)
        spread = np.linalg.norm(measurement.in_prior_units(slopes), axis=1)
        factor = float(-scipy.special.ndtri(0.5 * RANGE_FALSE_ALARM / len(middle)))
        machines = draw_parameters(measurement, rng, N_TRIAL_MACHINES)
        exact = measurement.try_readings(series, machines)
        linear = middle + (machines - nominal) @ slopes.T
        curved = np.sqrt(np.mean((exact - linear) ** 2, axis=0))
        if (curved <= MAX_CURVATURE * spread + noise).all():
            return Ranges(middle, middle, np.hypot(spread, noise), factor)
        machines = draw_parameters(measurement, rng, N_MACHINES)
        few = max(VALUES_AT_ONCE // len(middle), 1)
        parts = np.split(machines, range(few, N_MACHINES, few))
        exact = np.vstack([measurement.try_readings(series, part) for part in parts])
        drawn = np.nanstd(exact, axis=0)
        mean, sd = np.nanmean(exact, axis=0), np.hypot(drawn, noise)
        return Ranges(middle, mean, sd, factor)


def session_readings(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    covariates: pd.DataFrame | None = None,
    columns: Mapping[str, ReadingsColumn] | None = None,
) -> SessionReadings:
    """Make a session of readings y (N,), SI.

    `covariates` state order, direction, time and the file's row of each reading; without
    them, rows count from 2, as in a file with these readings alone.
    """
    parts = []
    for s in series:
        channels = [c.name for c in measurement.setups[s.setup].instrument.channels]
        readings = np.repeat(np.arange(len(s)), len(channels))
        part = {
            "setup": s.setup,
            "run": s.run[readings],
            "channel": np.tile(channels, len(s)),
        }
        parts.append(pd.DataFrame(part))
    values = pd.concat(parts, ignore_index=True)
    plain = SessionReadings(measurement, tuple(series), y, values, columns or {})
    number = plain.reading_of_value
    values["row"] = number + 2
    values["order"] = number + 1
    if covariates is not None:
        if "row" in covariates:
            values["row"] = named_rows(covariates)[number]
        for name in covariates.columns:
            if name == "order" or ReadingsColumn.from_covariate(name) is not None:
                values[name] = covariates[name].to_numpy()[number]
    return plain


# Predicted range of every reading under the tolerances and the stated noise.
#
# The range is linear about the nominal machine where the exact closure of a few drawn
# machines agrees with the slopes; else many machines are drawn through the closure.

N_TRIAL_MACHINES = 24  #: machines that test linearity
N_MACHINES = 400  #: machines drawn where it fails
#: values that are predicted at once, a reading of a machine each
VALUES_AT_ONCE = 1_000_000
MAX_CURVATURE = 0.05  #: share of the linear standard deviation that curvature may have
#: probability that one reading of a correct session lies outside its range
RANGE_FALSE_ALARM = 1e-4


@dataclasses.dataclass(frozen=True)
class Ranges:
    """Predicted ranges of N values, SI."""

    nominal: Array  #: (N,) readings of the nominal machine
    middle: Array  #: (N,) mean of the prediction
    sd: Array  #: (N,) its standard deviation, noise included
    factor: float  #: half width of a range in standard deviations

    def outside(self, y: Array) -> Index:
        """Values, by number, that lie outside."""
        return np.flatnonzero(np.abs(y - self.middle) > self.factor * self.sd)
