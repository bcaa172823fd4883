"""Oracle for a heavy planar manipulator that bends: gravity and over-constraint.

The machine of Chang, Li and Li (2011) with what their model leaves out. Each side hangs
the platform on two struts (a parallelogram) that are springs of slightly different
length, the platform may turn, the drives yield along their guides, and the columns lean
the more the higher a slider stands. The machine rests where its energy is least.
It must never import the toolkit. SI units (m, rad, N).
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from oracles import planar_geometry

WEIGHT = 90e3  # N, platform with its milling head
STRUT = 3.0e8  # N/m, each of four struts
DRIVE = 6.0e8  # N/m, each drive along its guide
LEAN = 4.0e-9  # m/N, a column's lean under a load at LEAN_HEIGHT
LEAN_HEIGHT = 4.6  # m
UPPER = 0.60  # m, the upper joints above the lower ones
TOOL = 0.70  # m, tool point below the lower joints


@dataclasses.dataclass(frozen=True)
class Gantry:
    """One machine: p (7,) of `planar_geometry`, and how it yields."""

    p: NDArray
    mismatch: NDArray  #: (2, 2) excess length of the struts, side by lower and upper, m
    #: (4,) on weight, struts' compliance, drives' compliance, columns' lean
    factors: NDArray

    def pose(self, q: NDArray) -> NDArray:
        """Tool points (n, 2) at scale readings q (n, 2), less the tool's offset."""
        return np.array([self._rest(row) for row in q])

    def _rest(self, q: NDArray) -> NDArray:
        slider = planar_geometry.sliders(q, self.p)
        point = planar_geometry.forward(q, self.p)
        start = np.r_[point, 0.0, np.zeros(4)]
        scale = np.r_[np.ones(2), 1.0, np.ones(4)]
        solution = optimize.root(
            lambda u: self._forces(u * scale, slider) / WEIGHT, start, tol=1e-13
        )
        forces = self._forces(solution.x, slider)
        assert np.abs(forces).max() < 1e-3 * WEIGHT * 1e-3, solution.message
        y, z, phi = solution.x[:3]
        return np.array([y + TOOL * np.sin(phi), z + TOOL * (1.0 - np.cos(phi))])

    def _forces(self, u: NDArray, slider: NDArray) -> NDArray:
        """Slope of the energy over platform (y, z, phi) and sliders (2, yz) shifts."""
        y, z, phi = u[:3]
        shift = u[3:].reshape(2, 2)
        weight, strut, drive, lean = self.factors
        slope = np.zeros(7)
        slope[1] = WEIGHT * weight
        for i in range(2):
            compliance = lean * LEAN * (slider[i, 1] / LEAN_HEIGHT) ** 3
            slope[3 + 2 * i] = shift[i, 0] / compliance
            slope[4 + 2 * i] = shift[i, 1] * DRIVE / drive
            for j, height in enumerate((0.0, UPPER)):
                arm = height * np.array([-np.sin(phi), np.cos(phi)])
                turn = height * np.array([-np.cos(phi), -np.sin(phi)])
                span = np.array([y, z]) + arm - slider[i] - shift[i] - [0.0, height]
                length = np.hypot(*span)
                excess = length - self.p[3 + i] - self.mismatch[i, j]
                force = STRUT / strut * excess * span / length
                slope[:2] += force
                slope[2] += force @ turn
                slope[3 + 2 * i : 5 + 2 * i] -= force
        return slope


def draw(rng: np.random.Generator) -> Gantry:
    """A machine of the size of the paper's, before any calibration."""
    spread = np.array([0.5e-3, 0.5e-3, 0.5e-3, 0.5e-3, 0.5e-3, 0.3e-3, 0.3e-3])
    return Gantry(
        p=planar_geometry.NOMINAL + spread * rng.standard_normal(7),
        mismatch=0.10e-3 * rng.standard_normal((2, 2)),
        factors=np.exp(0.15 * rng.standard_normal(4)),
    )
