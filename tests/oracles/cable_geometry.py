"""Oracle for the Hangprinter HP4, mm and degrees as its files have them; it must never
import the toolkit.

Motor to line by the inverse of the firmware's k0 (sqrt(r^2 + k2 l) - r), as published;
position by Gauss-Newton on the four line residuals, where the toolkit takes Newton on
their stationarity.
"""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

FOLD = np.array([2.0, 2.0, 2.0, 4.0])
GEAR, BUILDUP = 255.0 / 20.0, 0.06875


def data(folder: Path) -> tuple[NDArray, NDArray]:
    """Known positions (9, 3) in mm and motor angles (44, 4) in degrees, of which the
    first nine belong to them.
    """
    names = ("known_xyz_mm.csv", "motor_deg.csv")
    known, motor = (np.loadtxt(folder / n, delimiter=",", skiprows=1) for n in names)
    return known, motor


def line_change(motor: ArrayLike, radius: ArrayLike) -> NDArray:
    """Change of the lines (..., 4) since the origin."""
    k2 = -FOLD * BUILDUP
    k0 = 2.0 * (GEAR * FOLD * 360.0 / (2.0 * np.pi)) / k2
    radius = np.asarray(radius)
    return ((np.asarray(motor) / k0 + radius) ** 2 - radius**2) / k2


def residual(
    position: ArrayLike,
    motor: ArrayLike,
    anchor: ArrayLike,
    radius: ArrayLike,
    line: ArrayLike,
) -> NDArray:
    """Line residuals (..., 4): distance to the anchors (4, 3) less the line that is out."""
    away = np.asarray(position)[..., None, :] - np.asarray(anchor)
    return (
        np.sqrt((away * away).sum(-1)) - np.asarray(line) - line_change(motor, radius)
    )


def settle(
    motor: ArrayLike,
    anchor: ArrayLike,
    radius: ArrayLike,
    line: ArrayLike,
    start: ArrayLike,
) -> NDArray:
    """Positions (n, 3) of least squared line residuals."""
    x = np.array(start, dtype=float)
    for _ in range(500):
        away = x[:, None] - np.asarray(anchor)
        slope = away / np.linalg.norm(away, axis=-1, keepdims=True)
        step = (
            np.linalg.pinv(slope) @ residual(x, motor, anchor, radius, line)[..., None]
        )[..., 0]
        x -= step
        if np.abs(step).max() < 1e-11:
            break
    return x
