"""Where independent draws of a posterior are proposed: Student t about the estimate.

With known noise the posterior is close to one normal, and one Student t is as wide in
every direction. With an estimated noise law it is wide where the noise is large: the
law is drawn first, from kernels at laws that are probable (`oed.noise_law.proposal`), and
the parameters from the Student t that the linear model has under this law.
"""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from oed.base import Array
from oed.noise_law import KernelMixture, NoisePosterior, ResidualModel
from oed.posterior.log_density import PROPOSAL_DOF, LogDensity


class Proposal(Protocol):
    """Draws points and knows their density.

    points_of_ess  points that are usually enough, over the effective sample size
    """

    @property
    def points_of_ess(self) -> float:
        """See the class."""

    def draw(self, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        """`count` points or few less (m, dimensions), and log densities (m,)."""


def proposal_of(target: LogDensity, rng: np.random.Generator) -> Proposal:
    """The proposal for a density; an estimated law takes some draws to place it."""
    if target.noise_posterior is None:
        return StudentProposal(target.centre, target.root)
    model, fitted = target.linear_model(), target.noise_posterior
    return LawProposal(model, fitted, fitted.kernels(model, rng))


@dataclasses.dataclass(frozen=True, eq=False)
class StudentProposal:
    """Student t about a point.

    centre  (d,)
    root    (d, d) of the scale matrix
    """

    centre: Array
    root: Array
    points_of_ess: float = 1.6

    def draw(self, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        """Points (count, d) and log densities (count,), up to a constant."""
        white = draw_student(rng, (count, len(self.centre)))
        return self.centre + white @ self.root.T, log_student(white)


@dataclasses.dataclass(frozen=True, eq=False)
class LawProposal:
    """A law from kernels, then parameters as in the linear model under this law.

    model    of the readings about the estimate
    fitted   posterior of the law in the linear model
    kernels  in the law's coordinates
    """

    model: ResidualModel
    fitted: NoisePosterior
    kernels: KernelMixture
    points_of_ess: float = 2.5

    def draw(self, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        """Points (m, r + d) and log densities (m,), up to a constant."""
        laws = self.kernels.draw(rng, count)
        solutions = self.model.solve(self.fitted.prior.laws(laws))
        white = draw_student(rng, solutions.mean.shape)
        z = solutions.mean + np.einsum("mij,mj->mi", solutions.root, white)
        log_size = np.log(np.einsum("mii->mi", solutions.root)).sum(axis=1)
        log_density = self.kernels.log_density(laws) + log_student(white) - log_size
        return np.hstack([z, laws]), log_density


def draw_student(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Draws (m, d) of a Student t of unit scale."""
    normal = rng.standard_normal(shape)
    chi2 = rng.chisquare(PROPOSAL_DOF, (shape[0], 1))
    return np.asarray(normal / np.sqrt(chi2 / PROPOSAL_DOF))


def log_student(white: Array) -> Array:
    """Log density (m,) of a Student t of unit scale at (m, d), up to a constant."""
    power = -0.5 * (PROPOSAL_DOF + white.shape[1])
    return np.asarray(power * np.log1p(np.sum(white**2, axis=1) / PROPOSAL_DOF))
