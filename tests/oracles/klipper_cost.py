"""The cost that Klipper's DELTA_CALIBRATE minimises, over the oracle's delta.

Lengths in mm, angles in rad. It must never import the toolkit.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from oracles.delta_trilateration import nozzle

Carriages = Sequence[float]


class Delta(NamedTuple):
    """Radius, arms (3,), tower angles (3,) and endstops (3,)."""

    radius: float
    arm: Sequence[float]
    angle: Sequence[float]
    endstop: Sequence[float]


def cost(
    delta: Delta,
    heights: Sequence[tuple[float, Carriages]],
    distances: Sequence[tuple[float, Carriages, Carriages]],
) -> float:
    """Sum of squares, mm^2: heights weighted so that n distances count as n / 2."""
    weight = len(distances) / (0.5 * len(heights)) if distances else 1.0
    total = 0.0
    for height, travels in heights:
        total += weight * float(nozzle(travels, *delta)[2] - height) ** 2
    for distance, first, second in distances:
        span = np.linalg.norm(nozzle(first, *delta) - nozzle(second, *delta))
        total += float(span - distance) ** 2
    return total
