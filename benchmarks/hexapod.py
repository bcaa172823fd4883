"""Problem C: 10 of 2000 poses of a hexapod whose 42 parameters are all seen, blocks of
six readings that share noise.

The machine is `hexapod`; a tracker in the base frame (its registration known) reads all
six coordinates of a pose. Poses are uniform in the ranges of the commands. The six
readings of a pose have standard deviations 10 um and 5 arcsec, and a full 6 x 6
covariance: the correlations are those of 40 draws from six independent normal
variables. There is no prior; seven poses are the fewest that see everything. Columns
are parameters in units of their tolerances. Pose draws and correlations follow from one
seed, the instance's number.
"""

from __future__ import annotations

import numpy as np

from oed.instrument import mount
from oed.measurement import Measurement
from pkm_models.instruments import pose_tracker
from pkm_models.machines.hexapod import machine

SIZE, COLUMNS, CANDIDATES = 10, 42, 2000


def blocks(instance: int, count: int = CANDIDATES) -> np.ndarray:
    """Whitened blocks (count, 6, 42)."""
    rng = np.random.default_rng(instance)
    known = {f"{kind}_{axis}": 0.0 for kind in ("shift", "turn") for axis in "xyz"}
    measurement = Measurement(
        machine, [mount(pose_tracker.instrument, "pose", tolerances=known)]
    )
    ends = np.array([[c.lower, c.upper] for c in machine.command])
    series = measurement.series("pose", rng.uniform(ends[:, 0], ends[:, 1], (count, 6)))
    slopes = (
        measurement.jacobian([series], measurement.nominal) * measurement.tolerance
    )[:, measurement.free]
    root = np.linalg.cholesky(covariance(rng))
    return np.linalg.solve(root, slopes.reshape(count, 6, COLUMNS))


def covariance(rng: np.random.Generator) -> np.ndarray:
    """Of the six readings of a pose (6, 6), SI."""
    sigma = np.array([channel.sigma for channel in pose_tracker.instrument.channels])
    draws = rng.standard_normal((6, 40))
    moment = draws @ draws.T
    scale = sigma / np.sqrt(np.diag(moment))
    return moment * np.outer(scale, scale)


def log_det(candidates: np.ndarray, chosen: np.ndarray) -> float:
    """Value of a plan, from the singular values of its rows."""
    return 2.0 * float(
        np.log(
            np.linalg.svd(candidates[chosen].reshape(-1, COLUMNS), compute_uv=False)
        ).sum()
    )
