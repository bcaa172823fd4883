"""Virtual planar robot with four cables, in metres: truth, and recorded cable lengths.

It must never import the toolkit.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

Array = NDArray[np.float64]
ANCHORS = np.array([[-1.0, -0.8], [1.0, -0.8], [1.0, 0.8], [-1.0, 0.8]])
#: standard deviations of anchors, zeros and drum scales before
PLACE, SCALE = 5e-3, 0.5e-3


@dataclasses.dataclass(frozen=True)
class Robot:
    """A true robot: anchors (4, 2), zeros (4,), m, and relative scales (4,)."""

    anchors: Array
    zeros: Array
    scales: Array

    def lengths(self, at: Array, strain: Array | float = 0.0) -> Array:
        """What the drums read (n, 4) with the mover at points (n, 2).

        strain  (n, 4) of the cables: tension over E A, of their free length
        """
        away = np.hypot(*np.moveaxis(at[:, None] - self.anchors, -1, 0))
        free = away / (1.0 + strain)
        return np.asarray((free - self.zeros) / (1.0 + self.scales))

    def by_name(self) -> dict[str, float]:
        """Parameters by the names that a calibration uses."""
        table = {f"l{i + 1}": v for i, v in enumerate(self.zeros)}
        table |= {f"scale{i + 1}": v for i, v in enumerate(self.scales)}
        for i, anchor in enumerate(self.anchors):
            table |= {f"anchor{i + 1}{k}": v for k, v in zip("xy", anchor, strict=True)}
        return {name: float(v) for name, v in table.items()}


def drawn(rng: np.random.Generator) -> Robot:
    """A robot as built: normal errors about the drawing."""
    anchors = ANCHORS + PLACE * rng.standard_normal((4, 2))
    zeros, scales = PLACE * rng.standard_normal(4), SCALE * rng.standard_normal(4)
    return Robot(anchors, zeros, scales)


def recorded(
    robot: Robot, wanted: Array, noise: Array, rng: np.random.Generator
) -> Array:
    """Drum readings (n, 4): cables 1 and 2 lead the mover, 3 and 4 are held tight.

    wanted  (n, 2) points that the controller aims at with the drawing
    noise   standard deviation of each drum (4,), m
    """
    aimed = np.hypot(*np.moveaxis(wanted[:, None] - ANCHORS, -1, 0))
    points = []
    for start, goal in zip(wanted, aimed, strict=True):

        def missed(at: Array, goal: Array = goal) -> Array:
            return robot.lengths(at[None])[0, :2] - goal[:2]

        points.append(optimize.root(missed, start, tol=1e-13).x)
    exact = robot.lengths(np.array(points))
    return np.asarray(exact + noise * rng.standard_normal(exact.shape))


def settled(robot: Robot, drums: Array) -> Array:
    """Point (2,) where a mover on equally stiff cables of these drum readings (4,) rests."""

    def stretched(at: Array) -> Array:
        return np.asarray((robot.lengths(at[None])[0] - drums) * (1.0 + robot.scales))

    solution = optimize.least_squares(stretched, np.zeros(2), xtol=1e-15, ftol=1e-15)
    return np.asarray(solution.x)
