"""How far each reading is from what the other readings predict of it.

With the parameters' prior covariance L, the readings r about nominal parameters have the
covariance C + H L H^T, whose inverse is

    P = W - W H (H^T W H + L^-1)^-1 H^T W,        W = C^-1.

A reading with the numbers b is P_bb^-1 (P r)_b away from its prediction by all others
(Rasmussen and Williams 2006, Gaussian Processes for Machine Learning, Eq. 5.12).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array
from oed.estimation.estimate import Estimate
from oed.measurement.measurement import Measurement, Series


def left_out_errors(
    measurement: Measurement, series: Sequence[Series], estimate: Estimate
) -> Array:
    """Errors (N,), SI, of each reading's prediction by all others, to first order.

    With the estimate's noise, and the effects beside the geometry at their sizes.
    """
    free = estimate.prior_sd > 0.0
    slopes = measurement.jacobian(series, estimate.theta)
    off_nominal = slopes @ (estimate.theta - measurement.nominal)
    about_nominal = estimate.residuals + off_nominal
    root = estimate.noise.whiten(np.eye(len(about_nominal)))
    white = estimate.noise.whiten(slopes * estimate.prior_sd)[:, free]
    leverage = np.linalg.solve(np.eye(white.shape[1]) + white.T @ white, white.T)
    inverse = root.T @ (root - white @ (leverage @ root))
    weighed = inverse @ about_nominal
    errors, start = np.zeros(len(weighed)), 0
    for s in series:
        channels = len(measurement.setups[s.setup].sigma)
        for _ in range(len(s)):
            numbers = slice(start, start + channels)
            block = inverse[numbers, numbers]
            errors[numbers] = np.linalg.solve(block, weighed[numbers])
            start += channels
    return errors
