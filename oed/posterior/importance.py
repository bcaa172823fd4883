"""Independent draws of the posterior by importance sampling, checked by their weights.

The shape k of the weights' tail says whether means converge: above min(1 - 1 /
log10(count), 0.7) they do not, and the weights are not used.

Proposals are Student t about the estimate. With an estimated noise law the posterior is
wide where the noise is large: the law is drawn first, from kernels at laws that are
probable, and the parameters from the Student t that the linear model has under this
law.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from oed.base import Array, Index
from oed.noise_law import KernelMixture, NoisePosterior, ResidualModel
from oed.posterior.draws import Posterior
from oed.posterior.log_density import (
    LogDensity,
    OutOfBoundsError,
    draw_student,
    log_student,
)
from oed.result import PosteriorSection

MAX_K = 1.0  #: k beyond which more proposals are not worth a try
#: draws, over the goal effective sample size: more where some are repeated
SPARES = (1.2, 2.0, 3.0)
MAX_PROPOSALS_PER_ESS = 30.0  #: proposals at most, over the goal effective sample size
MIN_PROPOSALS = 1000  #: proposals at first at least: the tail of fewer has no shape
#: share of proposals of density above 0 below which there is no sampling
MIN_SHARE = 0.01
#: effective sample size beyond which proposals need too much memory
MAX_ESS = 100_000.0
#: further proposals, over those that would do if their worth were their share
SPARE_PROPOSALS = 1.3
MIN_MORE = 0.25  #: further proposals at least, over those so far
PROPOSALS_AT_ONCE = 20_000  #: proposals whose densities are computed at once


@dataclasses.dataclass(frozen=True, eq=False)
class StudentProposal:
    """Student t about a point."""

    centre: Array  #: (d,)
    root: Array  #: (d, d) of the scale matrix
    #: points that are usually enough, over the effective sample size
    points_of_ess: float = 1.35

    def draw(self, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        """Points (count, d) and log densities (count,), up to a constant."""
        white = draw_student(rng, (count, len(self.centre)))
        return self.centre + white @ self.root.T, log_student(white)


@dataclasses.dataclass(frozen=True, eq=False)
class LawProposal:
    """A law from kernels, then parameters as in the linear model under this law."""

    model: ResidualModel  #: of the readings about the estimate
    fitted: NoisePosterior  #: posterior of the law in the linear model
    kernels: KernelMixture  #: in the law's coordinates
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


Proposal = StudentProposal | LawProposal  #: draws points and knows their density


@dataclasses.dataclass(frozen=True, eq=False)
class Proposals:
    """Weighted proposals."""

    points: Array  #: (m, dimensions) those of a density above 0
    theta: Array  #: (m, n) parameters there, along lost directions where there is b(w)
    log_weights: Array  #: (m,) before smoothing
    drawn: int  #: proposals, with those of density 0

    @classmethod
    def empty(cls, target: LogDensity) -> "Proposals":
        """No proposal yet."""
        points = np.zeros((0, target.dimensions))
        return cls(points, target.place(points, None)[1], np.zeros(0), 0)

    def extend(
        self,
        target: LogDensity,
        proposal: Proposal,
        rng: np.random.Generator,
        count: int,
    ) -> "Proposals":
        """These and `count` more. Raises KeyboardInterrupt."""
        points, log_density = proposal.draw(rng, count)
        w = target.draw_lost(rng, len(points))
        log_weights = target(points, w) - log_density
        if target.interrupted:
            raise KeyboardInterrupt
        good = np.isfinite(log_weights)
        return Proposals(
            np.concatenate([self.points, points[good]]),
            np.concatenate([self.theta, target.place(points, w)[1][good]]),
            np.concatenate([self.log_weights, log_weights[good]]),
            self.drawn + count,
        )

    def starts(self, rng: np.random.Generator, count: int) -> Array:
        """Different points (count, dimensions), the more probable the larger their weights."""
        gumbel = rng.gumbel(size=len(self.log_weights))
        best = np.argsort(-(self.log_weights + gumbel))[:count]
        return self.points[best]


def draw_weighted(
    target: LogDensity,
    proposal: Proposal,
    rng: np.random.Generator,
    ess: float,
    max_draws: float,
    progress: Callable[[float], None] | None = None,
) -> tuple[Proposals, float, Index | None]:
    """Proposals, k, and numbers of those drawn; None where weights cannot be used.

    Draws are as many as are worth `ess` independent ones for every parameter, and `max_draws`
    at most. Raises KeyboardInterrupt.
    """
    proposals = Proposals.empty(target)
    k = math.inf
    count = max(math.ceil(proposal.points_of_ess * ess), MIN_PROPOSALS)
    while proposals.drawn < max(MAX_PROPOSALS_PER_ESS * ess, MIN_PROPOSALS):
        for start in range(0, count, PROPOSALS_AT_ONCE):
            batch = min(PROPOSALS_AT_ONCE, count - start)
            proposals = proposals.extend(target, proposal, rng, batch)
        if len(proposals.points) < MIN_SHARE * proposals.drawn:
            break
        weights, k = smoothed_weights(proposals.log_weights)
        if k > MAX_K:
            break
        more = 1.0
        if k <= PosteriorSection.largest_pareto_k(proposals.drawn):
            for spare in SPARES:
                chosen = resample(weights, math.ceil(min(spare * ess, max_draws)), rng)
                each = worth(proposals.theta, chosen)
                reached = float(np.nanmin(each, initial=len(chosen)))
                if reached >= ess or len(chosen) >= max_draws:
                    return proposals, k, chosen
            if progress is not None:
                progress(min(1.0, reached / ess))
            more = np.clip(SPARE_PROPOSALS * ess / reached - 1.0, MIN_MORE, 1.0)
        count = math.ceil(more * proposals.drawn)
    return proposals, k, None


def resample(weights: Array, count: int, rng: np.random.Generator) -> Index:
    """Numbers (count,) by weights (m,), systematic: rounded up or down, shuffled."""
    levels = (np.arange(count) + rng.random()) / count
    ends = np.cumsum(weights)
    numbers = np.searchsorted(ends, levels * ends[-1])
    return rng.permutation(np.minimum(numbers, len(weights) - 1))


def worth(theta: Array, chosen: Index) -> Array:
    """Independent draws (n,) that draws of theta (m, n) are worth, by repetitions c
    about a mean: m sum c x^2 / sum c^2 x^2; NaN for what does not move.
    """
    counts = np.bincount(chosen, minlength=len(theta)).astype(float)[:, None]
    values = np.full(theta.shape[1], np.nan)
    moving = np.ptp(theta, axis=0) > 0
    theta = theta[:, moving]
    square = (theta - (counts * theta).sum(axis=0) / len(chosen)) ** 2
    once, twice = (counts * square).sum(axis=0), (counts**2 * square).sum(axis=0)
    values[moving] = len(chosen) * once / np.maximum(twice, np.finfo(float).tiny)
    return values


def collect(
    target: LogDensity,
    proposals: Proposals,
    k: float,
    chosen: Index,
    rng: np.random.Generator,
) -> Posterior:
    """The drawn proposals and lost directions within bounds, or OutOfBoundsError."""
    theta = proposals.theta[chosen]
    ess = worth(proposals.theta, chosen)
    z = target.coordinates.from_theta(theta)
    laws = proposals.points[chosen, target.r :]
    if target.bend is None:
        theta = target.draw_theta(rng, z)
        ess[np.isnan(ess) & (np.ptp(theta, axis=0) > 0)] = len(chosen)
    inside = target.measurement.in_bounds(theta)
    if not inside.any():
        raise OutOfBoundsError(target.measurement, theta)
    return Posterior(
        names=target.measurement.names,
        draws=theta[inside][None],
        z=z[inside][None],
        noise_law=laws[inside][None],
        noise_names=target.noise_names,
        ess=ess * inside.mean(),
        rhat=np.full(theta.shape[1], np.nan),
        sampler=PosteriorSection.IMPORTANCE,
        pareto_k=k,
        proposals=proposals.drawn,
    )


def sample_independent(
    target: LogDensity,
    rng: np.random.Generator,
    ess: float,
    max_draws: float = math.inf,
    progress: Callable[[float], None] | None = None,
) -> tuple[Posterior | None, Proposals, float]:
    """Independent draws worth `ess`, or None; the proposals and k of their weights.
    Raises KeyboardInterrupt, OutOfBoundsError.
    """
    proposal: Proposal = StudentProposal(target.centre, target.root)
    if target.law is not None:  # some draws place it
        model = target.linear_model()
        proposal = LawProposal(model, target.law, target.law.kernels(model, rng))
    goal = reachable = min(ess, max_draws / SPARES[0])
    while True:
        proposals, k, chosen = draw_weighted(
            target, proposal, rng, goal, max_draws, progress
        )
        if chosen is None:
            return None, proposals, k
        drawn = collect(target, proposals, k, chosen, rng)
        share = drawn.draws.shape[1] / len(chosen)
        least = float(np.nanmin(drawn.ess, initial=len(chosen)))
        if least >= reachable or goal > reachable or len(chosen) >= max_draws:
            return drawn, proposals, k
        # bounds left out some
        goal = SPARES[0] * goal / share


# Weights whose tail is smoothed by a generalised Pareto distribution (PSIS): Vehtari,
# Simpson, Gelman, Yao and Gabry 2024, Journal of Machine Learning Research 25(72), fitted as
# by Zhang and Stephens 2009, Technometrics 51(3), 316-325. ArviZ has both, but takes as long
# to import as a whole posterior takes to sample.


MIN_TAIL = 5  #: fewest weights of a tail that has a shape
#: weights up to which the tail is a fifth of them; of more it is 3 sqrt(m)
FEW_WEIGHTS = 225
#: prior of the shape (Vehtari et al.): its mean, and the excesses that it is worth
PRIOR_SHAPE = 0.5
PRIOR_WORTH = 10.0
#: points of the quadrature at least, and their spread over the lower quartile (Zhang and
#: Stephens)
MIN_POINTS = 30
POINT_SPREAD = 3.0


def smoothed_weights(log_weights: Array) -> tuple[Array, float]:
    """Weights (m,) of sum 1, k of their tail; too few stay, of k inf; equal have 0."""
    count = len(log_weights)
    tail = count // 5 if count <= FEW_WEIGHTS else math.floor(3.0 * math.sqrt(count))
    weights = np.exp(log_weights - log_weights.max())
    if tail < MIN_TAIL:
        return weights / weights.sum(), math.inf
    order = np.argsort(log_weights)
    largest, cutoff = order[-tail:], weights[order[-tail - 1]]
    if weights[largest[0]] == weights[largest[-1]]:
        return weights / weights.sum(), 0.0
    shape, scale = fit_pareto(weights[largest] - cutoff)
    levels = np.arange(0.5, tail) / tail
    quantiles = cutoff + scale * np.expm1(-shape * np.log1p(-levels)) / shape
    weights[largest] = np.minimum(quantiles, 1.0)
    return weights / weights.sum(), shape


def fit_pareto(excess: Array) -> tuple[float, float]:
    """Shape, scale of a generalised Pareto of sorted (n,), by mean -shape / scale."""
    count = len(excess)
    points = MIN_POINTS + math.isqrt(count)
    quartile = excess[int(count / 4 + 0.5) - 1]
    spread = 1.0 - np.sqrt(points / (np.arange(points) + 0.5))
    theta = spread / (POINT_SPREAD * quartile) + 1.0 / excess[-1]
    shapes = np.log1p(-theta[:, None] * excess).mean(axis=1)
    log_likelihood = count * (np.log(-theta / shapes) - shapes - 1.0)
    share = np.exp(log_likelihood - log_likelihood.max())
    mean = float(share @ theta / share.sum())
    shape = float(np.log1p(-mean * excess).mean())
    worth = count + PRIOR_WORTH
    return (count * shape + PRIOR_WORTH * PRIOR_SHAPE) / worth, -shape / mean
