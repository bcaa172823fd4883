"""Problem C of the design benchmark: choose 10 of 2000 poses of a hexapod.

The machine is `hexapod`. A tracker in the base frame reads all six coordinates of a
pose; its registration is known. Poses are uniform in the ranges of the commands. The
six readings of a pose have standard deviations of 10 um and 5 arcsec and a full 6 x 6
covariance, whose correlations are those of 40 draws of six independent normal
variables. Columns are the 42 parameters in units of their tolerances. There is no
prior, and at least seven poses are needed to determine all parameters. The instance's
number seeds the draws of poses and correlations.
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
    tracker = mount(pose_tracker.instrument, "pose", tolerances=known)
    measurement = Measurement(machine, [tracker])
    lower = np.array([c.lower for c in machine.command])
    upper = np.array([c.upper for c in machine.command])
    series = measurement.series("pose", rng.uniform(lower, upper, (count, 6)))
    slopes = measurement.jacobian([series], measurement.nominal)
    scaled = (slopes * measurement.tolerance)[:, measurement.free]
    root = np.linalg.cholesky(covariance(rng))
    return np.linalg.solve(root, scaled.reshape(count, 6, COLUMNS))


def covariance(rng: np.random.Generator) -> np.ndarray:
    """Covariance (6, 6) of the six readings of a pose, SI."""
    sigma = np.array([channel.sigma for channel in pose_tracker.instrument.channels])
    draws = rng.standard_normal((6, 40))
    moment = draws @ draws.T
    scale = sigma / np.sqrt(np.diag(moment))
    return moment * np.outer(scale, scale)
