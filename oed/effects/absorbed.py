"""Parameters of a controller that take up a known error as far as parameters can.

Effects beside the geometry move the tool by a known part e (n poses, k components). A
controller that is sent parameters p + d, and not the machine's p, moves it by -C d more
(C: what compensation changes per unit of a parameter). The shift d minimises

    sum over poses and components of ((e - C d) / s)^2 / n + (RIDGE d / tolerance)^2,

with s the error of each component before calibration.
"""

from __future__ import annotations

import numpy as np

from oed.accuracy.maps import ErrorMaps
from oed.base import Array

#: a parameter moves by a tolerance where this takes such a share of the error before
#: calibration
RIDGE = 1e-3


def absorbing_shift(maps: ErrorMaps, error: Array, tolerance: Array) -> Array:
    """Shift (np,) of the parameters sent, SI, that takes up errors (n, k), SI.

    maps       over the machine's np parameters
    tolerance  (np,) prior standard deviations, SI; those of 0 do not move
    """
    free = tolerance > 0.0
    scaled = (maps.raw * tolerance)[:, :, free]
    size = np.sqrt((scaled**2).sum(axis=2).mean(axis=0))
    weight = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    weight /= np.sqrt(len(error))
    change = ((maps.raw - maps.remaining) * tolerance)[:, :, free]
    rows = (change * weight[:, None]).reshape(-1, int(free.sum()))
    target = (error * weight).ravel()
    ridge = RIDGE * np.eye(rows.shape[1])
    stacked = np.vstack([rows, ridge])
    solution = np.linalg.lstsq(stacked, np.append(target, np.zeros(len(ridge))))[0]
    shift = np.zeros(len(tolerance))
    shift[free] = solution * tolerance[free]
    return shift
