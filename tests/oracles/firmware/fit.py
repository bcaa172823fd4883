"""Least squares over a delta: what a calibration can do at best with its contacts."""

import numpy as np
from scipy.optimize import least_squares

from oracles.firmware.geometry import Delta, delta

NAMES = ("radius", "angle1", "angle2", "endstop1", "endstop2", "endstop3")


def fit(travels, start: Delta, heights=0.0, *, leaning=False) -> Delta:
    """Radius, two angles and endstops for which the nozzle is at heights over the bed.

    travels  (n, 3) at the contacts; the tilt of the bed, unless it is fitted as well, and
             the differences of the radii are those of `start`
    """
    trim = start.radius - start.radius[0]

    def printer(p: np.ndarray) -> Delta:
        angles = [p[1], p[2], start.angles[2]]
        tilt = p[6:] if leaning else start.tilt
        return delta(p[0] + trim, start.arms, angles, p[3:6], tilt)

    first = [start.radius[0], *start.angles[:2], *start.endstops]
    first += list(start.tilt) if leaning else []
    best = least_squares(
        lambda p: printer(p).over_bed(travels) - heights, first, x_scale=1e-3
    )
    return printer(best.x)


def numbers(printer: Delta) -> dict[str, float]:
    """The numbers that are fitted, by name."""
    values = (printer.radius[0], *printer.angles[:2], *printer.endstops)
    return dict(zip(NAMES, map(float, values), strict=True))
