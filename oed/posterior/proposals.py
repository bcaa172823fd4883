"""Where independent draws of a posterior are proposed: Student t about the estimate.

With known noise the posterior is close to one normal, and one Student t is as wide in
every direction. With an estimated noise law it is wide where the noise is large: the
law is drawn first, from kernels at laws that are probable (`oed.noise.proposal`), and
the parameters from the Student t that the linear model has under this law.
"""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from oed.base.arrays import Array
from oed.noise.marginal import FARTHEST, NoisePosterior, ResidualModel
from oed.noise.proposal import KernelMixture, kernels_at
from oed.posterior.log_density import PROPOSAL_DOF, LogDensity

#: rounds in which kernels are placed anew, laws drawn in each, and what widens kernels:
#: tails that a proposal lacks give large weights
PLACINGS, PLACING_LAWS, WIDENING = 2, 640, 1.3


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
    return law_proposal(target.linear_model(), target.noise_posterior, rng)


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
        laws = draw_laws(self.kernels, rng, count)
        solutions = self.model.solve(self.fitted.prior.laws(laws))
        white = draw_student(rng, solutions.mean.shape)
        z = solutions.mean + np.einsum("mij,mj->mi", solutions.root, white)
        log_size = np.log(np.einsum("mii->mi", solutions.root)).sum(axis=1)
        log_density = self.kernels.log_density(laws) + log_student(white) - log_size
        return np.hstack([z, laws]), log_density


def law_proposal(
    model: ResidualModel, fitted: NoisePosterior, rng: np.random.Generator
) -> LawProposal:
    """The proposal whose kernels are at laws that are drawn anew.

    The few laws of the fit leave gaps between them in five dimensions.
    """
    with np.errstate(divide="ignore"):
        kernels = kernels_at(fitted.draws, np.log(fitted.weights))
    for _ in range(PLACINGS):
        laws = draw_laws(kernels, rng, PLACING_LAWS)
        log_marginal = model.solve(fitted.prior.laws(laws)).log_marginal
        log_target = log_marginal - 0.5 * (laws**2).sum(axis=1)
        log_weights = log_target - kernels.log_density(laws)
        kernels = kernels_at(laws, log_weights, WIDENING)
    return LawProposal(model, fitted, kernels)


def draw_laws(kernels: KernelMixture, rng: np.random.Generator, count: int) -> Array:
    """Coordinates (m, d) of laws that are not too far to be looked at."""
    laws = kernels.draw(rng, count)
    return np.asarray(laws[np.abs(laws).max(axis=1) < FARTHEST])


def draw_student(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Draws (m, d) of a Student t of unit scale."""
    normal = rng.standard_normal(shape)
    chi2 = rng.chisquare(PROPOSAL_DOF, (shape[0], 1))
    return np.asarray(normal / np.sqrt(chi2 / PROPOSAL_DOF))


def log_student(white: Array) -> Array:
    """Log density (m,) of a Student t of unit scale at (m, d), up to a constant."""
    power = -0.5 * (PROPOSAL_DOF + white.shape[1])
    return np.asarray(power * np.log1p(np.sum(white**2, axis=1) / PROPOSAL_DOF))
