"""Candidates of a plan: readings as blocks, with their noise, time, set-up and command.

A candidate is one reading with all its channels, or a whole run (a circle) with the
covariance of its readings. The readings of a run may share an error e, that of the
reference they are relative to, or of a cup that each run seats anew
(`oed.measurement`):

    y_i = h_i theta + sigma e_i + shared_i e        with e ~ N(0, 1).

Such readings are not independent when chosen one by one. But e is one more unknown with
prior variance 1, so it gets a column of its own, which every criterion profiles out:
the whitened row is [h_i, shared_i] / sigma, the prior information 1. An error that is
carried along a run depends on the order, and counts where whole runs are candidates.

Effects that the model lacks are further unknowns of prior variance 1, which all readings
share: nuisances, whose columns come last.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from oed.base import Array, Index, Mask
from oed.design.blocks import information
from oed.design.catalogue import CRITERIA
from oed.design.forms import Criterion
from oed.design.quotas import QuotaSet
from oed.design.rules import Rules
from oed.identifiability import Scaling, column_scale
from oed.measurement import Measurement, Series


@dataclasses.dataclass(frozen=True, eq=False)
class Nuisances:
    """Changes of the N numbers that all candidate readings give, by unknown effects."""

    columns: Array  #: (N, u) per unit of each of u unknowns of prior variance 1, SI
    #: (N,) standard deviation of what else they change, reading by reading, SI
    scatter: Array

    @property
    def count(self) -> int:
        """Number u of unknowns."""
        return int(self.columns.shape[1])

    def take(self, rows: slice) -> "Nuisances":
        """Those of some numbers."""
        return Nuisances(self.columns[rows], self.scatter[rows])

    def after(self, first: int) -> "Nuisances":
        """Those from a number on."""
        return self.take(slice(first, None))

    def weight(self, sigma: Array) -> Array:
        """Share (N,) that scatter leaves of each number's weight, by its noise (N,)."""
        return np.asarray(sigma / np.hypot(sigma, self.scatter))


@dataclasses.dataclass(frozen=True, eq=False)
class Candidates:
    """Candidates of a plan."""

    measurement: Measurement  #: of the readings
    series: tuple[Series, ...]  #: all readings
    #: (C, k, n + r): n free parameters in the stated scaling, then r errors that runs
    #: share, the nuisances last
    blocks: Array
    columns: int  #: n
    #: (n + r, n + r): on the shared errors, and of prior and kept readings where given;
    #: zero where there is none
    prior_information: Array
    #: (C, 2) first reading of each candidate among all readings of all series, and its
    #: number of readings
    members: Index
    setups: tuple[str, ...]  #: names
    setup: Index  #: (C,) position in `setups`
    command: Array  #: (C, d) of the first reading of each candidate, SI
    cost: Array  #: (C,) time of a candidate, s
    setup_cost: Array  #: (S,) time to mount each set-up, s
    #: u unknowns beside the parameters; None without
    nuisances: Nuisances | None = None

    @classmethod
    def build(
        cls,
        measurement: Measurement,
        series: Sequence[Series],
        theta: Array,
        scaling: Scaling,
        *,
        whole_runs: bool = False,
        nuisances: Nuisances | None = None,
    ) -> "Candidates":
        """Candidates from all readings of the series at theta (n,).

        With `whole_runs` a run is one candidate. Raises ValueError where the readings of a
        run do not follow each other, and for nuisances where the scaling is not "tolerance".
        """
        if nuisances is not None and scaling != "tolerance":
            raise ValueError('effects beside the geometry need scaling = "tolerance"')
        numbers = [len(s) * len(measurement.setups[s.setup].sigma) for s in series]
        count = sum(numbers)
        nothing = Nuisances(np.zeros((count, 0)), np.zeros(count))
        every = nothing if nuisances is None else nuisances
        ends = np.cumsum(numbers)
        parts = [
            _series_blocks(
                measurement,
                s,
                theta,
                scaling,
                whole_runs,
                every.take(slice(end - n, end)),
            )
            for s, n, end in zip(series, numbers, ends, strict=True)
        ]
        n = int(measurement.free.sum())
        # the errors that runs share, and the nuisances: of prior variance 1
        columns = n + every.count + sum(part.shared.shape[2] for part in parts)
        is_shared = np.arange(columns) >= n
        setups = tuple(dict.fromkeys(s.setup for s in series))
        counts = np.concatenate([part.readings for part in parts])
        first = np.cumsum(counts) - counts
        commands = np.vstack([s.reading_commands() for s in series])
        seconds = [measurement.reading_seconds(s.setup) for s in series]
        reading_seconds = np.repeat(seconds, [len(s) for s in series])
        mounting = [measurement.setups[name].instrument.cost.setup for name in setups]
        positions = [setups.index(s.setup) for s in series]
        return cls(
            measurement=measurement,
            series=tuple(series),
            blocks=_join_blocks(parts, measurement.free, columns),
            columns=n,
            prior_information=np.diag(is_shared.astype(float)),
            members=np.column_stack([first, counts]),
            setups=setups,
            setup=np.repeat(positions, [len(part.readings) for part in parts]),
            command=commands[first],
            cost=np.add.reduceat(reading_seconds, first),
            setup_cost=np.array(mounting),
            nuisances=nuisances,
        )

    def __len__(self) -> int:
        return len(self.blocks)

    @property
    def prior(self) -> Array | None:
        """Prior information; None where there is none."""
        return self.prior_information if self.prior_information.any() else None

    def information(self, chosen: Index) -> Array:
        """Information (n + r, n + r) of the prior and of chosen candidates."""
        return self.prior_information + information(self.blocks[chosen])

    @property
    def shared_errors(self) -> int:
        """Number r of errors that runs share, nuisances included."""
        return int(self.blocks.shape[2]) - self.columns

    @property
    def nuisance_columns(self) -> int:
        """Number u of nuisances."""
        return 0 if self.nuisances is None else self.nuisances.count

    def add_prior(self, information: Array) -> "Candidates":
        """With information (n, n) on the parameters added to the prior information."""
        total = self.prior_information.copy()
        total[: self.columns, : self.columns] += information
        return dataclasses.replace(self, prior_information=total)

    def criterion(self, name: str, ingredient: Array | None = None) -> Criterion:
        """A criterion of the parameters, with the shared errors profiled out.

        ingredient  what it needs, in the scaled columns (`catalogue.NamedCriterion`). An
                    accuracy over n + u columns judges what the nuisances do as well

        Raises ValueError for criteria of eigenvalues where errors are shared: they have
        no profiling.
        """
        if not self.shared_errors:
            return CRITERIA.build(name, self.columns, ingredient)
        columns = np.arange(self.columns)
        if ingredient is not None and CRITERIA[name].needs == "accuracy":
            columns = self._columns_of(ingredient)
        criterion = CRITERIA.build(name, len(columns), ingredient)
        if criterion.spectral:
            raise ValueError(
                f"{name} does not profile out {self._shared_words}: choose D, A, c, I or G"
            )
        return criterion.profile_others(columns, self.columns + self.shared_errors)

    def _columns_of(self, gradients: Array) -> Index:
        """Columns of gradients (..., n), or (..., n + u) by the nuisances as well."""
        further = gradients.shape[-1] - self.columns
        total = self.columns + self.shared_errors
        last = np.arange(total - further, total)
        return np.concatenate([np.arange(self.columns), last])

    def spread(self, gradients: Array) -> Array:
        """Gradients (..., n) or (..., n + u) over all columns (..., n + r)."""
        total = self.columns + self.shared_errors
        spread = np.zeros((*gradients.shape[:-1], total))
        spread[..., self._columns_of(gradients)] = gradients
        return spread

    def reading(self, index: int) -> tuple[Series, int]:
        """The series of a candidate, and the row of its first reading there."""
        first = int(self.members[index, 0])
        for series in self.series:
            if first < len(series):
                return series, first
            first -= len(series)
        raise IndexError(f"candidate {index} of {len(self)}")

    def pose_error_slopes(self, raw: Array, tool: Array) -> Array:
        """Pose errors (n, k, columns) per unit of each column, effects among them.

        raw   (n, k, p) per unit of each parameter of the machine, SI
        tool  (n, k, u) per unit of each effect, SI
        """
        measurement = self.measurement
        poses, components, parameters = raw.shape
        by_parameter = np.zeros((poses, components, len(measurement.names)))
        by_parameter[:, :, :parameters] = raw
        scaled = (by_parameter * measurement.tolerance)[:, :, measurement.free]
        return self.spread(np.concatenate([scaled, tool], axis=2))

    @property
    def _shared_words(self) -> str:
        if self.nuisances is not None:
            return "effects beside the geometry"
        return (
            "the error that a run's readings share (whole runs as candidates have none)"
        )

    def rules(
        self,
        *,
        size: int | None = None,
        budget: float | None = None,
        most_setups: int | None = None,
        mounted: tuple[int, ...] = (),
        apart: Array | None = None,
        quotas: QuotaSet | None = None,
    ) -> Rules:
        """Rules over these candidates.

        mounted  set-ups that are mounted already
        apart    (d,) least distance along each command coordinate of two readings of a
        set-up, SI, in the norm
        """
        position = None
        if apart is not None:
            position = self.command / np.where(apart > 0, apart, np.inf)
        return Rules.build(
            size=size,
            seconds=None if budget is None else self.cost,
            budget=budget,
            setup=self.setup,
            mounting=None if budget is None else self.setup_cost,
            most_setups=most_setups,
            mounted=mounted,
            position=position,
            quotas=quotas,
        )

    def readings_of(self, chosen: Index) -> tuple[Series, ...]:
        """The chosen candidates' readings as series, in the order of the candidates."""
        selected = []
        start = 0
        for series in self.series:
            end = start + len(series)
            rows = [
                np.arange(first - start, first - start + count)
                for first, count in self.members[chosen]
                if start <= first < end
            ]
            start = end
            if rows:
                selected.append(series.take(np.concatenate(rows).astype(np.intp)))
        return tuple(selected)


class _SeriesBlocks(NamedTuple):
    """One series as candidates."""

    rows: Array  #: (C, k, p) over all p parameters
    shared: Array  #: (C, k, r) columns of the errors that its runs share
    readings: Index  #: (C,) number of readings of each candidate
    nuisances: Array  #: (C, k, u)


def _join_blocks(parts: Sequence[_SeriesBlocks], free: Mask, columns: int) -> Array:
    """Blocks (C, k, columns) of all series, with equally many rows each."""
    n = int(free.sum())
    most_rows = max(min(part.rows.shape[1], columns) for part in parts)
    blocks = []
    column = n
    for part in parts:
        shared_columns = part.shared.shape[2]
        wide = np.zeros((*part.rows.shape[:2], columns))
        wide[:, :, :n] = part.rows[:, :, free]
        wide[:, :, column : column + shared_columns] = part.shared
        wide[:, :, columns - part.nuisances.shape[2] :] = part.nuisances
        column += shared_columns
        blocks.append(_with_rows(wide, most_rows))
    return np.concatenate(blocks)


def _series_blocks(
    measurement: Measurement,
    series: Series,
    theta: Array,
    scaling: Scaling,
    whole_runs: bool,
    nuisances: Nuisances,
) -> _SeriesBlocks:
    """Candidates of one series, with the nuisances of its numbers."""
    channels = measurement.setups[series.setup].instrument.channels
    k, count = len(channels), len(series)
    jacobian = measurement.jacobian([series], theta) * column_scale(
        measurement, scaling
    )
    parameters = jacobian.shape[1]
    rows = np.hstack([jacobian, nuisances.columns]).reshape(count, k, -1)
    weight = _weight(measurement, series, nuisances).reshape(count, k, 1)
    whiten = scaling == "tolerance"
    if scaling == "length":
        lengths = measurement.reading_length_factors([series])
        rows = rows * lengths.reshape(count, k, 1)
    if whole_runs:
        if whiten:
            flat = rows.reshape(count * k, -1)
            rows = measurement.noise([series]).whiten(flat).reshape(count, k, -1)
            rows = rows * weight
        return _runs_as_candidates(series, rows, parameters)
    single = np.ones(count, dtype=np.intp)
    if not whiten:
        none = np.zeros((count, k, 0))
        return _SeriesBlocks(rows, none, single, none)
    factor = np.linalg.inv(
        np.linalg.cholesky(measurement.of(series).reading_covariances(series))
    )
    shared = _shared_columns(measurement, series)
    white, white_shared = weight * (factor @ rows), weight * (factor @ shared)
    of_parameters, of_nuisances = white[:, :, :parameters], white[:, :, parameters:]
    return _SeriesBlocks(of_parameters, white_shared, single, of_nuisances)


def _weight(measurement: Measurement, series: Series, nuisances: Nuisances) -> Array:
    """Share (N,) of their weight that scatter by nuisances leaves the readings."""
    if not nuisances.scatter.any():
        return np.ones(len(nuisances.scatter))
    return nuisances.weight(measurement.sigma([series]))


def _shared_columns(measurement: Measurement, series: Series) -> Array:
    """Gradient (n, k, r) of the readings by the errors that their runs share."""
    errors = measurement.of(series).run_errors(series)
    count, channels, k = errors.shape
    runs = list(dict.fromkeys(series.run))
    columns = np.zeros((count, channels, len(runs) * k))
    for j, run in enumerate(runs):
        in_run = series.run == run
        columns[in_run, :, j * k : (j + 1) * k] = errors[in_run]
    return columns


def _runs_as_candidates(series: Series, rows: Array, parameters: int) -> _SeriesBlocks:
    """Whole runs as candidates, padded with empty rows; `parameters` columns first."""
    runs = list(dict.fromkeys(series.run))
    counts = np.array([int(np.sum(series.run == run)) for run in runs], dtype=np.intp)
    if not (np.repeat(np.array(runs), counts) == series.run).all():
        raise ValueError(
            f"the readings of a run of set-up {series.setup} do not follow each other"
        )
    k, n = rows.shape[1:]
    blocks = np.zeros((len(runs), int(counts.max()) * k, n))
    start = 0
    for j, count in enumerate(counts):
        run_rows = rows[start : start + count].reshape(count * k, n)
        blocks[j, : count * k] = run_rows
        start += count
    none = np.zeros((*blocks.shape[:2], 0))
    return _SeriesBlocks(
        blocks[:, :, :parameters], none, counts, blocks[:, :, parameters:]
    )


def _with_rows(blocks: Array, count: int) -> Array:
    """Blocks of `count` rows with the same information: by QR, or with empty rows."""
    if blocks.shape[1] > count:
        return np.asarray(np.linalg.qr(blocks, mode="r"), dtype=float)[:, :count]
    return np.pad(blocks, ((0, 0), (0, count - blocks.shape[1]), (0, 0)))
