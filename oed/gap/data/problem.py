"""Residuals made ready for a diagnosis: what calibration leaves, with what it may still
absorb.

With theta_hat the fitted parameters, H their slopes and N(nominal, Lambda) their prior,
readings are, to first order,

    y = f(theta_hat) + H (theta - theta_hat) + G beta + e,      so that
    r = y - f(theta_hat) + H (theta_hat - nominal) ~ N(G beta, Sigma + H Lambda H^T):

whatever value of theta the fit ended at, what the parameters can explain is taken out
by Lambda, not by the fit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from oed import identify
from oed.arrays import Array
from oed.effect import Effect, State
from oed.gap.data import state as states_of
from oed.gap.data.signature import Signature, signature
from oed.measurement import Measurement, Response, Series
from oed.noise.runs import Runs


@dataclasses.dataclass(frozen=True, kw_only=True)
class GapProblem(Runs):
    """N readings in units of their stated noise, and the n parameters that absorb.

    measurement, series, theta   what was fitted, and the fit (n_all,), SI
    states, responses            one a series
    sigma (N,)                   stated noise, SI
    residual (N,)                r over sigma
    slopes (N, n)                H over sigma, per prior standard deviation of each free
                                 parameter
    names (n,)                   of those parameters
    rows                         one row a reading of a channel: setup, run, order,
                                 channel, covariates, phase
    """

    measurement: Measurement
    series: tuple[Series, ...]
    theta: Array
    states: tuple[State, ...]
    responses: tuple[Response, ...]
    sigma: Array
    residual: Array
    slopes: Array
    names: tuple[str, ...]
    rows: pd.DataFrame

    def signature(
        self, effect: Effect, constants: Mapping[str, float], *, textbook: bool = False
    ) -> Signature:
        """An effect's signature in these readings at its constants, SI; without columns
        that adapt, if `textbook`.
        """
        told = (self.states, self.responses, self.measurement, self.series)
        return signature(effect, constants, *told, self.sigma, textbook=textbook)

    def of(self, values: Array) -> Array:
        """Changes of the readings (N, ...), SI, in units of their stated noise."""
        return values / self.sigma.reshape(-1, *[1] * (values.ndim - 1))

    def with_residual(self, residual: Array) -> GapProblem:
        """The same readings with other residuals (N,), in units of their stated noise."""
        return dataclasses.replace(self, residual=residual)


def prepare(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    covariates: pd.DataFrame,
    *,
    gravity: tuple[float, float, float] = states_of.DOWN,
    stages: Sequence[Sequence[str]] = (("*",),),
) -> GapProblem:
    """Fit the calibration parameters to readings y (N,), SI, and lay out what is left.

    `covariates` has one row a reading of the series, as in a Dataset. Raises
    IdentificationError.
    """
    series = tuple(series)
    found = identify.identify(
        measurement, series, y, stages=stages, estimate_noise=False
    )
    return planned(measurement, series, covariates, found.theta, y, gravity=gravity)


def planned(
    measurement: Measurement,
    series: Sequence[Series],
    covariates: pd.DataFrame,
    theta: Array | None = None,
    y: Array | None = None,
    *,
    gravity: tuple[float, float, float] = states_of.DOWN,
) -> GapProblem:
    """The problem of readings y (N,) at parameters theta (n,); of readings only
    planned, with residuals of 0.
    """
    series = tuple(s.parted() for s in series)
    theta = measurement.nominal if theta is None else theta
    jacobian = measurement.jacobian(series, theta)
    y = measurement.readings(series, theta) if y is None else y
    noise = measurement.noise(series)
    free = np.flatnonzero(measurement.free)
    left = (
        y
        - measurement.readings(series, theta)
        + jacobian @ (theta - measurement.nominal)
    )
    made = tuple(states_of.states(measurement, series, covariates, theta, gravity))
    rows = _rows(measurement, series, covariates, made)
    blocks = tuple(rows.groupby(["setup", "run"], sort=False).indices.values())
    covariance = None if noise.root is None else (noise.root @ noise.root.T).tocsr()
    base = [None if covariance is None else covariance[b][:, b].toarray() / np.outer(noise.sigma[b], noise.sigma[b])
            for b in blocks]  # fmt: skip
    along = np.zeros(len(rows))
    for b in blocks:
        along[b] = rows["order"].to_numpy(dtype=float)[b]
    kinds = rows["instrument"] + "." + rows["channel"]
    return GapProblem(
        measurement=measurement,
        series=series,
        theta=theta,
        states=made,
        responses=tuple(measurement.response(s, theta) for s in series),
        sigma=noise.sigma,
        residual=left / noise.sigma,
        slopes=jacobian[:, free] * measurement.tolerance[free] / noise.sigma[:, None],
        names=tuple(measurement.names[k] for k in free),
        base=tuple(base),
        blocks=tuple(np.asarray(b, dtype=np.intp) for b in blocks),
        along=along,
        group=pd.factorize(kinds)[0].astype(np.intp),
        phase=rows["phase"].to_numpy(dtype=float),
        rows=rows,
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
        rows = covariates.iloc[start : start + len(s)].reset_index(drop=True)
        start += len(s)
        instrument = measurement.setups[s.setup].instrument
        rows = rows.assign(
            instrument=instrument.name,
            phase=state.phase[s.index[:, 0]],
            reading=np.arange(len(s)),
        )
        channels = [c.name for c in instrument.channels]
        wide = rows.loc[rows.index.repeat(len(channels))].reset_index(drop=True)
        parts.append(wide.assign(channel=np.tile(channels, len(s))))
    return pd.concat(parts, ignore_index=True)
