"""Noise of the readings of one set-up, as its instrument states it."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from oed.arrays import Array
from oed.instrument import Setup
from oed.noise.covariance import Noise, block_noise
from oed.observation import ObservationModel
from oed.series import Series


def stated_noise(setup: Setup, model: ObservationModel, series: Series) -> Noise:
    """Noise of a series' readings at their nominal poses, SI.

    It is independent, unless the instrument's channels have common sources or the
    readings of a run share an error; then it is correlated within each run.
    """
    channels = setup.instrument.channels
    shared = np.array([c.shared for c in channels]) * setup.sigma
    if setup.instrument.sources is None and not shared.any():
        return Noise(np.tile(setup.sigma, len(series)))
    separate = reading_covariances(setup, model, series)
    places, covariances = [], []
    for run in dict.fromkeys(series.run):
        members = np.flatnonzero(series.run == run)
        place = members[:, None] * len(channels) + np.arange(len(channels))
        pairs = np.ones((len(members), len(members)))
        common = np.kron(pairs, np.diag(shared**2))
        covariances.append(linalg.block_diag(*separate[members]) + common)
        places.append(place.ravel())
    return block_noise(covariances, places)


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
