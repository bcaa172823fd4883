"""Noise of the readings of one set-up, as instrument and study state it."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from oed.arrays import Array
from oed.instrument import Setup
from oed.noise.covariance import Noise, block_noise
from oed.observation import ObservationModel
from oed.series import Series


def stated_noise(
    setup: Setup, model: ObservationModel, series: Series, run_errors: Array
) -> Noise:
    """Noise of a series' readings at their nominal poses, SI.

    run_errors  (n, channels, k) as `Measurement.run_errors` gives them

    It is independent, unless the instrument's channels have common sources, the
    readings of a run share errors, or an error is carried along a run; then it is
    correlated within each run.
    """
    channels, statement = len(setup.sigma), setup.statement
    alone = not run_errors.size and statement.carried_share == 0.0
    if setup.instrument.sources is None and alone:
        return Noise(np.tile(setup.sigma, len(series)))
    separate = reading_covariances(setup, model, series)
    places, covariances = [], []
    for run in dict.fromkeys(series.run):
        members = np.flatnonzero(series.run == run)
        place = members[:, None] * channels + np.arange(channels)
        errors = run_errors[members].reshape(place.size, -1)
        covariances.append(_single(setup, separate[members]) + errors @ errors.T)
        places.append(place.ravel())
    return block_noise(covariances, places)


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


def reading_covariances(setup: Setup, model: ObservationModel, series: Series) -> Array:
    """Covariance (n, channels, channels), SI, of each reading without its run's error."""
    instrument = setup.instrument
    if instrument.sources is None:
        return np.tile(np.diag(np.square(setup.sigma)), (len(series), 1, 1))
    poses = [series.start[k] for k in series.pose_indices()]
    nuisances = np.array([n.nominal for n in setup.nuisances])
    default = np.array([c.sigma for c in instrument.channels])
    factor = np.array(setup.sigma) / default
    root = model.sources(poses, nuisances) * factor[:, None]
    return np.asarray(root @ np.swapaxes(root, 1, 2))


def level_errors(setup: Setup, count: int) -> Array:
    """Stated errors of a run's level (count, channels, k), SI, one a channel with one."""
    shared = [
        c.shared * s
        for c, s in zip(setup.instrument.channels, setup.sigma, strict=True)
    ]
    errors = np.diag(shared)[:, np.flatnonzero(shared)]
    return np.tile(errors, (count, 1, 1))
