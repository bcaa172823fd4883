"""Noise of readings, as instrument and study state it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from oed.base import Array
from oed.instrument import Series, Setup
from oed.measurement.setup_readings import SetupReadings
from oed.noise import Errors, FactoredNoise, Noise


def reading_sigma(setup: Setup, series: Series) -> Array:
    """Standard deviation (n, channels), SI, of each single reading: its own, or all's."""
    common = np.tile(setup.sigma, (len(series), 1))
    if series.sigma is None:
        return common
    return np.where(np.isfinite(series.sigma), series.sigma, common)


def stated_noise(several: Sequence[tuple[SetupReadings, Series]]) -> Noise:
    """Noise of the readings of several series at their nominal poses, SI.

    It is independent, unless an instrument's channels have common sources, the readings
    of a run share errors, or an error is carried along a run; then it is related within
    each run.
    """
    if all(_is_independent(readings, series) for readings, series in several):
        sigmas = [reading_sigma(readings.setup, series) for readings, series in several]
        return Noise(np.concatenate([sigma.ravel() for sigma in sigmas]))
    errors = [_errors(readings, series) for readings, series in several]
    variances = [_variances(readings, series) for readings, series in several]
    sigma = np.sqrt(np.concatenate(variances))
    return FactoredNoise.of_errors(sigma, errors)


def _is_independent(readings: SetupReadings, series: Series) -> bool:
    """Whether no two readings of a series have an error in common."""
    setup = readings.setup
    alone = setup.instrument.sources is None and not setup.statement.correlated_share
    return alone and not run_errors(readings, series).size


def _variances(readings: SetupReadings, series: Series) -> Array:
    """Variances (N,) of the readings of a series."""
    alone = np.einsum("ncc->nc", reading_covariances(readings, series))
    shared = np.square(run_errors(readings, series)).sum(axis=2)
    return np.asarray((alone + shared).ravel())


def _errors(readings: SetupReadings, series: Series) -> Errors:
    """What the covariance of the readings of a series consists of, run by run."""
    setup = readings.setup
    channels, share = len(setup.sigma), setup.statement.correlated_share
    run = np.repeat(np.unique(series.run, return_inverse=True)[1], channels)
    channel = np.tile(np.arange(channels), len(series))
    order = np.lexsort((channel, run))
    first = np.diff(channels * run[order] + channel[order], prepend=-1) > 0
    decay = np.where(first, 0.0, np.exp(-1.0 / setup.statement.reach_median))
    unmix = decoupling(reading_covariances(readings, series))
    shared = unmix @ run_errors(readings, series).reshape(len(order), -1)
    return Errors(
        order=order,
        starts=np.flatnonzero(np.diff(run[order], prepend=-1)),
        decay=decay if share else np.zeros(len(order)),
        single=np.full(len(order), 1.0 - share),
        correlated=np.full(len(order), share),
        shared=shared[order],
        scale=np.ones(len(order)),
        unmix=scipy.sparse.csr_array(unmix[order][:, order]),
    )


def decoupling(covariances: Array) -> scipy.sparse.csr_array:
    """Block diagonal W with W C W^T = 1, for covariances (n, c, c) of n readings."""
    inverses = np.linalg.inv(np.linalg.cholesky(covariances))
    count = np.arange(len(inverses) + 1)
    blocks = scipy.sparse.bsr_array((inverses, count[:-1], count))
    matrix = scipy.sparse.csr_array(blocks)
    matrix.eliminate_zeros()
    return matrix


def reading_covariances(readings: SetupReadings, series: Series) -> Array:
    """Covariance (n, channels, channels), SI, of each reading without its run's error."""
    setup, instrument = readings.setup, readings.setup.instrument
    sigma = reading_sigma(setup, series)
    if instrument.sources is None:
        return np.square(sigma)[:, :, None] * np.eye(sigma.shape[1])
    default = np.array([c.sigma for c in instrument.channels])
    root = source_gradients(readings, series) * (sigma / default)[:, :, None]
    return np.asarray(root @ np.swapaxes(root, 1, 2))


def source_gradients(readings: SetupReadings, series: Series) -> Array:
    """Jacobian (n, channels, sources), SI, over the errors inside an instrument.

    Each error is in its standard deviation. Only for instruments that state them.
    """
    poses = [series.start[k] for k in series.pose_indices()]
    nuisances = np.array([n.nominal for n in readings.setup.nuisances])
    return readings.model.sources(poses, nuisances)


def run_errors(readings: SetupReadings, series: Series) -> Array:
    """Jacobian (n, channels, k), SI, over the k stated errors that a run shares.

    Each error is standard normal: levels of channels, then unknowns that the run
    seats anew. Jacobian are those at the nominal poses.
    """
    setup = readings.setup
    pairs = zip(setup.instrument.channels, setup.sigma, strict=True)
    shared = [channel.shared * sigma for channel, sigma in pairs]
    errors = np.diag(shared)[:, np.flatnonzero(shared)]
    levels = np.tile(errors, (len(series), 1, 1))
    if not setup.statement.seating:
        return levels
    renewed = [n.name in setup.instrument.renewed for n in setup.nuisances]
    jacobian = readings.nominal_jacobian(series)[:, :, renewed]
    return np.concatenate([levels, jacobian * setup.statement.seating], axis=2)
