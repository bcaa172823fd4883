"""Residuals of a calibration in units of their noise, with what it may still absorb.

With theta_hat the fitted parameters, H their slopes and N(nominal, Lambda) their prior,
readings are, to first order,

    y = f(theta_hat) + H (theta - theta_hat) + G beta + e,      so that
    r = y - f(theta_hat) + H (theta_hat - nominal) ~ N(G beta, Sigma + H Lambda H^T).

Whatever value of theta the fit ended at, Lambda takes out what the parameters can
explain, not the fit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from oed.base import Array, Index
from oed.effect_model import Effect, State
from oed.estimation import identify
from oed.gap.data import state as states_of
from oed.gap.data.signature import Signature, signature
from oed.measurement import Measurement, Response, Series, reading_structure
from oed.noise import Laws, NoiseLaw, NoiseStatement, ReadingStructure


@dataclasses.dataclass(frozen=True, kw_only=True)
class GapProblem:
    """N readings in units of their stated noise, and the n parameters that absorb.

    structure      how the readings hang together, in these units; each channel of an
                   instrument has a noise of its own, whatever set-up it is in
    measurement    what was fitted
    series         the readings' series
    covariates     one row a reading of the series, as in a Dataset
    y              (N,) the readings, SI
    gravity        its direction in the base frame
    theta          (n_all,) fitted parameters, SI
    states         the machine's state, one a series
    responses      slopes of the readings, one a series
    sigma          (N,) stated noise, SI
    residual       (N,) r over sigma
    slopes         (N, n) H over sigma, per prior standard deviation of each parameter
    names          (n,) of those parameters
    rows           one row a reading of a channel: setup, run, order, channel,
                   covariates, phase
    """

    structure: ReadingStructure
    measurement: Measurement
    series: tuple[Series, ...]
    covariates: pd.DataFrame
    y: Array
    gravity: tuple[float, float, float]
    theta: Array
    states: tuple[State, ...]
    responses: tuple[Response, ...]
    sigma: Array
    residual: Array
    slopes: Array
    names: tuple[str, ...]
    rows: pd.DataFrame

    def __len__(self) -> int:
        return len(self.residual)

    @property
    def members(self) -> tuple[Index, ...]:
        """Readings of each run."""
        return self.structure.members

    @property
    def channel(self) -> Index:
        """Instrument channel (N,) of each reading."""
        return self.structure.group

    @property
    def statement(self) -> NoiseStatement:
        """What is stated of the noise."""
        return self.structure.statement

    @property
    def stated_law(self) -> NoiseLaw:
        """The law that is stated."""
        return NoiseLaw(Laws.stated(self.structure))

    def signature(
        self,
        effect: Effect,
        constants: Mapping[str, float],
        *,
        textbook: bool = False,
    ) -> Signature:
        """An effect's signature in these readings at its constants, SI.

        `textbook` leaves out the columns that only let the form adapt.
        """
        return signature(
            effect,
            constants,
            self.states,
            self.responses,
            self.measurement,
            self.series,
            self.sigma,
            textbook=textbook,
        )

    def in_noise_units(self, values: Array) -> Array:
        """Changes of the readings (N, ...), SI, in units of their stated noise."""
        trailing = [1] * (values.ndim - 1)
        return values / self.sigma.reshape(-1, *trailing)

    def with_residual(self, residual: Array) -> GapProblem:
        """The same readings with other residuals (N,), in units of the stated noise."""
        return dataclasses.replace(self, residual=residual)


def prepare(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    covariates: pd.DataFrame,
    *,
    gravity: tuple[float, float, float] = states_of.DOWN,
) -> GapProblem:
    """Fit the calibration to readings y (N,), SI, and assemble its residuals.

    `covariates` has one row a reading of the series, as in a Dataset: set-up, run and
    order, and direction, time, feed, payload and temperatures where they are known.
    Raises IdentificationError.

    >>> import numpy as np
    >>> import pandas as pd
    >>> from oed import Measurement, mount
    >>> from oed.gap import prepare
    >>> from oed.measurement import draw_parameters, draw_readings
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> y, z = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    >>> series = measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    >>> rng = np.random.default_rng(1)
    >>> truth = draw_parameters(measurement, rng)
    >>> y = draw_readings(measurement, [series], truth, rng)
    >>> covariates = pd.DataFrame(
    ...     {"setup": "tracker", "run": "1", "order": np.arange(25), "direction": 1}
    ... )
    >>> problem = prepare(measurement, [series], y, covariates)
    >>> problem.residual.shape  # x, y and z of 25 readings, in units of the stated noise
    (75,)
    """
    series = tuple(series)
    theta = identify(measurement, series, y).theta
    return assemble(measurement, series, covariates, theta, y, gravity=gravity)


def assemble(
    measurement: Measurement,
    series: Sequence[Series],
    covariates: pd.DataFrame,
    theta: Array | None = None,
    y: Array | None = None,
    *,
    gravity: tuple[float, float, float] = states_of.DOWN,
) -> GapProblem:
    """The problem of readings y (N,) at parameters theta (n,).

    Parameters are nominal by default; without y the readings are only planned, and
    their residuals are 0.
    """
    series = tuple(s.separate_poses() for s in series)
    theta = measurement.nominal if theta is None else theta
    jacobian = measurement.jacobian(series, theta)
    y = measurement.readings(series, theta) if y is None else y
    sigma = measurement.sigma(series)
    free = np.flatnonzero(measurement.free)
    off_nominal = jacobian @ (theta - measurement.nominal)
    residual = y - measurement.readings(series, theta) + off_nominal
    states = tuple(states_of.states(measurement, series, covariates, theta, gravity))
    rows = _rows(measurement, series, covariates, states)
    return GapProblem(
        measurement=measurement,
        series=series,
        covariates=covariates,
        y=y,
        gravity=gravity,
        theta=theta,
        states=states,
        responses=tuple(measurement.of(s).response(s, theta) for s in series),
        sigma=sigma,
        residual=residual / sigma,
        slopes=measurement.in_prior_units(jacobian)[:, free] / sigma[:, None],
        names=tuple(measurement.names[k] for k in free),
        structure=_structure(measurement, series, theta, rows).rescaled(sigma),
        rows=rows,
    )


def _structure(
    measurement: Measurement,
    series: tuple[Series, ...],
    theta: Array,
    rows: pd.DataFrame,
) -> ReadingStructure:
    """Structure of the readings: by the order of their rows, without a course."""
    structure = reading_structure(measurement, series, theta)
    group, names = pd.factorize(rows["instrument"] + "." + rows["channel"])
    return dataclasses.replace(
        structure,
        names=tuple(names),
        group=group.astype(np.intp),
        position=rows["order"].to_numpy(dtype=float),
        course=np.zeros((len(group), 0)),
    )


def _rows(
    measurement: Measurement,
    series: tuple[Series, ...],
    covariates: pd.DataFrame,
    states: Sequence[State],
) -> pd.DataFrame:
    """One row a reading of a channel, in the order of y."""
    parts, start = [], 0
    for s, state in zip(series, states, strict=True):
        stop = start + len(s)
        rows = covariates.iloc[start:stop].reset_index(drop=True)
        start = stop
        instrument = measurement.setups[s.setup].instrument
        rows = rows.assign(
            instrument=instrument.name,
            phase=state.phase[s.index[:, 0]],
            reading=np.arange(len(s)),
        )
        channels = [c.name for c in instrument.channels]
        repeated = rows.index.repeat(len(channels))
        table = rows.loc[repeated].reset_index(drop=True)
        parts.append(table.assign(channel=np.tile(channels, len(s))))
    return pd.concat(parts, ignore_index=True)


def with_reversed_runs(covariates: pd.DataFrame) -> pd.DataFrame:
    """The rows with the order of each run counted from its end."""
    orders = covariates.groupby(["setup", "run"], sort=False)["order"]
    ends = orders.transform("min") + orders.transform("max")
    return covariates.assign(order=ends - covariates["order"])
