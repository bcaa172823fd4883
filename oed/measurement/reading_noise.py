"""Noise of the readings of one set-up, as instrument and study state it."""

from __future__ import annotations

import numpy as np
from scipy import linalg, sparse

from oed.base.arrays import Array
from oed.measurement.setup_readings import SetupReadings
from oed.model.instrument import Setup
from oed.model.series import Series
from oed.noise.covariance import FactoredNoise, Noise, block_noise
from oed.noise.factor import Errors, LinearFactor

#: readings of a run, all channels counted, up to which its covariance is written out
DENSE_MOST = 500


def reading_sigma(setup: Setup, series: Series) -> Array:
    """Standard deviation (n, channels), SI, of each single reading: its own, or all's."""
    common = np.tile(setup.sigma, (len(series), 1))
    if series.sigma is None:
        return common
    return np.where(np.isfinite(series.sigma), series.sigma, common)


def stated_noise(readings: SetupReadings, series: Series) -> Noise:
    """Noise of a series' readings at their nominal poses, SI.

    It is independent, unless the instrument's channels have common sources, the
    readings of a run share errors, or an error is carried along a run; then it is
    correlated within each run.
    """
    setup, shared = readings.setup, run_errors(readings, series)
    channels, statement = len(setup.sigma), setup.statement
    alone = not shared.size and statement.carried_share == 0.0
    if setup.instrument.sources is None and alone:
        return Noise(reading_sigma(setup, series).ravel())
    separate = reading_covariances(readings, series)
    longest = np.unique(series.run, return_counts=True)[1].max()
    if longest * channels > DENSE_MOST:
        return _factored(setup, separate, series, shared)
    places, covariances = [], []
    for run in dict.fromkeys(series.run):
        members = np.flatnonzero(series.run == run)
        place = members[:, None] * channels + np.arange(channels)
        errors = shared[members].reshape(place.size, -1)
        covariances.append(_single(setup, separate[members]) + errors @ errors.T)
        places.append(place.ravel())
    return block_noise(covariances, places)


def _factored(
    setup: Setup, separate: Array, series: Series, errors_of_runs: Array
) -> FactoredNoise:
    """The same noise by a factor in linear time."""
    channels, share = len(setup.sigma), setup.statement.carried_share
    run = np.unique(series.run, return_inverse=True)[1]
    reading = np.argsort(run, kind="stable")
    order = (reading[:, None] * channels + np.arange(channels)).ravel()
    first = np.diff(run[reading], prepend=-1) > 0
    starts = np.flatnonzero(first) * channels
    place = np.arange(len(order))
    begins = np.repeat(first, channels)
    decay = np.where(begins, 0.0, np.exp(-1.0 / setup.statement.reach_median))
    roots = np.linalg.cholesky(separate)
    inverse = sparse.block_diag(list(np.linalg.inv(roots)[reading]), format="csr")
    shared = errors_of_runs.reshape(len(order), -1)
    errors = Errors(
        order=order,
        starts=starts,
        before=np.where(begins, place, place - channels),
        decay=decay if share else np.zeros(len(order)),
        single=np.full(len(order), 1.0 - share),
        carried=np.full(len(order), share),
        shared=shared[order],
        scale=np.ones(len(order)),
        unmix=sparse.csr_array(inverse),
    )
    variance = np.square(roots).sum(axis=2).ravel() + np.square(shared).sum(axis=1)
    return FactoredNoise(np.sqrt(variance), factor=LinearFactor(errors))


def _single(setup: Setup, separate: Array) -> Array:
    """Covariance (n c, n c) of a run's n readings of c channels without what all share.

    separate  (n, c, c) of each reading
    """
    share = setup.statement.carried_share
    if share == 0.0:
        return np.asarray(linalg.block_diag(*separate))
    place = np.arange(len(separate))
    distance = np.abs(place[:, None] - place)
    along = share * np.exp(-distance / setup.statement.reach_median)
    along += (1.0 - share) * np.eye(len(place))
    root = np.linalg.cholesky(separate)
    covariance = np.einsum("ij,iac,jbc->iajb", along, root, root, optimize=True)
    return np.asarray(covariance.reshape(len(place) * root.shape[1], -1))


def reading_covariances(readings: SetupReadings, series: Series) -> Array:
    """Covariance (n, channels, channels), SI, of each reading without its run's error."""
    setup, instrument = readings.setup, readings.setup.instrument
    sigma = reading_sigma(setup, series)
    if instrument.sources is None:
        return np.square(sigma)[:, :, None] * np.eye(sigma.shape[1])
    default = np.array([c.sigma for c in instrument.channels])
    root = source_slopes(readings, series) * (sigma / default)[:, :, None]
    return np.asarray(root @ np.swapaxes(root, 1, 2))


def source_slopes(readings: SetupReadings, series: Series) -> Array:
    """Slopes (n, channels, sources), SI, over the errors inside an instrument.

    Each error is in its standard deviation. Only for instruments that state them.
    """
    poses = [series.start[k] for k in series.pose_indices()]
    nuisances = np.array([n.nominal for n in readings.setup.nuisances])
    return readings.model.sources(poses, nuisances)


def run_errors(readings: SetupReadings, series: Series) -> Array:
    """Slopes (n, channels, k), SI, over the k stated errors that a run shares.

    Each error is standard normal: levels of channels, then unknowns that the run
    seats anew. Slopes are those at the nominal poses.
    """
    setup = readings.setup
    pairs = zip(setup.instrument.channels, setup.sigma, strict=True)
    shared = [channel.shared * sigma for channel, sigma in pairs]
    errors = np.diag(shared)[:, np.flatnonzero(shared)]
    levels = np.tile(errors, (len(series), 1, 1))
    if not setup.statement.seating:
        return levels
    renewed = [n.name in setup.instrument.renewed for n in setup.nuisances]
    slopes = readings.nominal_slopes(series)[:, :, renewed]
    return np.concatenate([levels, slopes * setup.statement.seating], axis=2)
