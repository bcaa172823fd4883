"""The noise law, integrated over: its posterior given readings and a linear model.

For standardised residuals r about an estimate c of z ~ N(0, I), r = H (z - c) + e, and
e of a law with coordinates u,

    log p(r | u) = -1/2 [ log |C| + log |A| + r^T C^-1 r + c^T c - b^T A^-1 b ],
    A = I + H^T C^-1 H,    b = H^T C^-1 r - c,

the marginal likelihood with the parameters z integrated out (restricted likelihood with
a proper prior; Patterson and Thompson 1971). Laws are drawn where they are probable and
weighted: estimates are means over laws, not those of the best one.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.base import Array
from oed.linear_algebra import triangle_of_sums
from oed.noise import Laws, ReadingStructure
from oed.noise_law.prior import NoisePrior
from oed.noise_law.proposal import (
    MAX_COORDINATE,
    KernelMixture,
    find_mode,
    kernels_at,
    root_about,
    split_student,
)

#: laws drawn in a round
DRAWS = 320
#: equally weighted laws that a first round is worth, below which there is a second
MIN_EFFECTIVE_DRAWS = 100.0
#: largest coordinate of the mode, prior sd: readings without noise have theirs at the
#: end, and draws must fit beyond it
MAX_MODE = MAX_COORDINATE - 1.0
#: numbers in the largest array of one batch of laws: 8 MB
BATCH_NUMBERS = 1_000_000
#: rounds in which kernels are placed anew at laws drawn from them
PLACEMENTS = 2
#: laws drawn in each of these rounds
PLACEMENT_LAWS = 640
#: factor on the width of kernels: tails that a proposal lacks give large weights
KERNEL_WIDENING = 1.3


@dataclasses.dataclass(frozen=True, eq=False)
class ResidualModel:
    """Standardised residuals of readings about an estimate of z ~ N(0, I).

    residual  (N,)
    slopes    (N, r) over z
    centre    (r,) the estimate. Near the solution: the likelihood is a difference of
              squares, which loses digits elsewhere
    """

    structure: ReadingStructure
    residual: Array
    slopes: Array
    centre: Array

    def solve(self, laws: Laws) -> Solutions:
        """Log marginal likelihood and posterior of z under each law."""
        structure = self.structure
        shared = structure.effects.shape[1] + structure.course.shape[1]
        columns = 1 + self.slopes.shape[1] + shared
        of_chains = len(structure.run) * len(structure.kinds)
        step = max(1, BATCH_NUMBERS // (columns * max(columns, of_chains)))
        parts = [
            self._solve(laws.take(slice(k, k + step)))
            for k in range(0, len(laws), step)
        ]
        return concatenate_solutions(parts)

    def cost(self, prior: NoisePrior, u: Array) -> Array:
        """Minus log posterior (L,) of laws at coordinates (L, d)."""
        log_marginal = self.solve(prior.laws(u)).log_marginal
        return np.asarray(0.5 * (u**2).sum(axis=1) - log_marginal)

    def most_probable(self, prior: NoisePrior, near: Array | None = None) -> Array:
        """The most probable coordinates (d,), from several starts, or from one near."""
        starts = prior.starts() if near is None else near[None]
        return find_mode(lambda u: self.cost(prior, u), starts, MAX_MODE)

    def integrate(self, prior: NoisePrior, mode: Array | None = None) -> NoisePosterior:
        """The posterior of the noise law, and of z with the law integrated out.

        mode  (d,) most probable coordinates; sought by default

        Where a first round of laws is worth too few, a second is drawn where the first has
        weight, and all are weighted by both rounds' density together (`oed.noise_law.proposal`).
        """
        if mode is None:
            mode = self.most_probable(prior)

        def cost(u: Array) -> Array:
            return self.cost(prior, u)

        root = root_about(cost, mode)
        first = split_student(cost, mode, root)
        draws, solutions, target = self._solve_at(prior, first.points(DRAWS))
        log_weights = target - first.log_density(draws)
        weights = special.softmax(log_weights)
        if 1.0 / (weights @ weights) < MIN_EFFECTIVE_DRAWS:
            second = kernels_at(draws, log_weights)
            further, more, more_target = self._solve_at(prior, second.points(DRAWS))
            draws = np.vstack([draws, further])
            solutions = concatenate_solutions([solutions, more])
            target = np.concatenate([target, more_target])
            densities = first.log_density(draws), second.log_density(draws)
            weights = special.softmax(target - np.logaddexp(*densities))
        mean = weights @ solutions.mean
        offsets = solutions.mean - mean
        of_law = solutions.root
        covariance = np.einsum("l,lik,ljk->ij", weights, of_law, of_law, optimize=True)
        covariance += np.einsum("l,li,lj->ij", weights, offsets, offsets)
        return NoisePosterior(
            prior=prior,
            structure=self.structure,
            draws=draws,
            weights=weights,
            mode=mode,
            root=root,
            mean=mean,
            covariance=covariance,
            solutions=solutions,
        )

    def _solve_at(
        self, prior: NoisePrior, points: Array
    ) -> tuple[Array, Solutions, Array]:
        """Points (L, d) that are not too far, their solutions, their log posteriors (L,)."""
        draws = points[np.abs(points).max(axis=1) < MAX_COORDINATE]
        solutions = self.solve(prior.laws(draws))
        log_prior = -0.5 * (draws**2).sum(axis=1)
        return draws, solutions, solutions.log_marginal + log_prior

    def _solve(self, laws: Laws) -> Solutions:
        whitening = laws.whitening(self.structure)
        gram = whitening.gram(np.column_stack([self.slopes, self.residual]))
        prior = np.column_stack([np.eye(len(self.centre)), -self.centre])
        products = gram + prior.T @ prior
        products[:, -1, -1] += np.finfo(float).eps  # readings may have no error at all
        triangle = triangle_of_sums(products)
        diagonals = np.einsum("lii->li", triangle)
        log_size = 2.0 * np.log(diagonals[:, :-1]).sum(axis=1)
        log_size = log_size + whitening.log_determinant
        centre = np.broadcast_to(self.centre, (len(laws), len(self.centre)))
        return Solutions(log_size, triangle, centre)


@dataclasses.dataclass(frozen=True, eq=False)
class Solutions:
    """Of L laws: log marginal likelihood, and posterior of z.

    log_size      (L,) log determinant of the readings' covariance, z integrated out
    triangle      (L, r + 1, r + 1) Cholesky factor of the products of slopes and residual,
                  with the prior
    centre        (L, r) the z about which they are
    """

    log_size: Array
    triangle: Array
    centre: Array

    @property
    def energy(self) -> Array:
        """Squares (L,) of readings in that covariance."""
        return np.asarray(self.triangle[:, -1, -1] ** 2)

    @property
    def log_marginal(self) -> Array:
        """Log marginal likelihoods (L,)."""
        return np.asarray(-0.5 * (self.log_size + self.energy))

    @functools.cached_property
    def root(self) -> Array:
        """Root (L, r, r) of the covariance of z, triangular."""
        inverse = np.linalg.inv(self.triangle[:, :-1, :-1])
        return np.asarray(np.triu(inverse.swapaxes(1, 2)))

    @functools.cached_property
    def mean(self) -> Array:
        """Mean (L, r) of z."""
        step = np.einsum("lij,lj->li", self.root, self.triangle[:, -1, :-1])
        return np.asarray(self.centre + step)

    @property
    def misfit(self) -> Array:
        """Sum (L,) of squared whitened residuals at the mean."""
        return np.asarray(self.energy - (self.mean**2).sum(axis=1))


def concatenate_solutions(parts: Sequence[Solutions]) -> Solutions:
    """Solutions of laws one after the other."""
    names = [field.name for field in dataclasses.fields(Solutions)]
    return Solutions(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))


@dataclasses.dataclass(frozen=True, eq=False)
class NoisePosterior:
    """Posterior of the noise law, as weighted draws.

    prior       of the coordinates
    structure   of the readings
    draws       (L, d) coordinates u
    weights     (L,) sum 1
    mode        (d,) most probable coordinates
    root        (d, d) root of the covariance about the mode
    mean        (r,) of z, over laws
    covariance  (r, r) of z, over laws
    solutions   of each drawn law
    """

    prior: NoisePrior
    structure: ReadingStructure
    draws: Array
    weights: Array
    mode: Array
    root: Array
    mean: Array
    covariance: Array
    solutions: Solutions

    def draw(self, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        """Draws (count, r) of z and (count, d) of the law's coordinates.

        A law is drawn by its weight, then z under that law.
        """
        number = rng.choice(len(self.weights), size=count, p=self.weights)
        normal = rng.standard_normal((count, len(self.mean)))
        spread = np.einsum("mij,mj->mi", self.solutions.root[number], normal)
        return self.solutions.mean[number] + spread, self.draws[number]

    def kernels(self, model: ResidualModel, rng: np.random.Generator) -> KernelMixture:
        """Kernels at laws that are drawn anew under a model.

        The few laws of a fit leave gaps between them in five dimensions.
        """
        with np.errstate(divide="ignore"):
            kernels = kernels_at(self.draws, np.log(self.weights))
        for _ in range(PLACEMENTS):
            laws = kernels.draw(rng, PLACEMENT_LAWS)
            log_target = -model.cost(self.prior, laws)
            log_weights = log_target - kernels.log_density(laws)
            kernels = kernels_at(laws, log_weights, KERNEL_WIDENING)
        return kernels
