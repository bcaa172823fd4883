"""The noise law, integrated over: its posterior given readings and a linear model.

The marginal likelihood has the parameters z integrated out (restricted likelihood with
a proper prior; Patterson and Thompson 1971). Laws are drawn where they are probable and
weighted: estimates are means over laws, not those of the best one. The posterior may be
steep on one side of its mode and have a long, crooked tail: a split Student (Geweke
1989, Econometrica 57, 1317-1339) and kernels at the weighted draws (Cappe et al. 2004,
J. Comput. Graph. Stat. 13, 907-929) follow it, at Sobol points, so that laws are those
of the readings.
"""

from __future__ import annotations

import dataclasses
import functools
import warnings
from collections.abc import Callable, Sequence

import numpy as np
import scipy

from oed.base import Array, Index
from oed.linear_algebra import eigenvectors, triangle_of_sums
from oed.noise import Laws, ReadingStructure
from oed.noise_law.prior import NoisePrior

MAX_COORDINATE = 8.0  #: largest coordinate of a law that is looked at, prior sd
GRADIENT_STEP = 1e-4  #: step of numerical gradients in a search, prior sd
#: step of numerical curvatures, prior sd: wide, as the cost is not smooth to its last digit
CURVATURE_STEP = 0.15
#: least curvature, over that of the prior: draws are no wider than sqrt(2) prior sd
MIN_CURVATURE = 0.5
#: Newton steps after the search, which ends a few hundredths of a prior sd away
MAX_NEWTON_STEPS = 6
#: length of a Newton step below which the mode is reached, prior sd
STEP_TOLERANCE = 3e-4
#: step of the central differences of Newton's gradient, prior sd
NEWTON_GRADIENT_STEP = 0.01
COST_TOLERANCE = 1e-6  #: rise of the cost that rounding explains

#: minus log posterior density (L,), up to a constant, at coordinates (L, d)
Cost = Callable[[Array], Array]


def find_mode(cost: Cost, starts: Array, farthest: float) -> Array:
    """Coordinates (d,) of least cost from some starts (s, d), none beyond `farthest`."""
    dimensions = starts.shape[1]
    steps = np.vstack([np.zeros(dimensions), np.eye(dimensions)]) * GRADIENT_STEP

    def cost_and_gradient(u: Array) -> tuple[float, Array]:
        costs = cost(u + steps)
        return float(costs[0]), (costs[1:] - costs[0]) / GRADIENT_STEP

    limits = [(-farthest, farthest)] * dimensions
    minima = [
        scipy.optimize.minimize(
            cost_and_gradient,
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=limits,
            options={"maxiter": 60, "ftol": 1e-6},
        )
        for start in starts
    ]
    return np.asarray(min(minima, key=lambda minimum: minimum.fun).x)


def polish(cost: Cost, u: Array, farthest: float) -> Array:
    """Coordinates (d,) of least cost near u (d,), where `find_mode` ended.

    That search ends where the cost hardly falls any more, some hundredths away, and where
    that is depends on rounding. Newton steps go on to where the gradient vanishes.
    """
    root = root_about(cost, u)
    moves = NEWTON_GRADIENT_STEP * np.eye(len(u))
    moves = np.vstack([np.zeros(len(u)), moves, -moves])
    lowest, least = u, np.inf
    for _ in range(MAX_NEWTON_STEPS):
        costs = cost(u + moves)
        if costs[0] > least + COST_TOLERANCE:
            break
        lowest = u
        least = float(costs[0])
        ahead, behind = np.split(costs[1:], 2)
        gradient = (ahead - behind) / (2.0 * NEWTON_GRADIENT_STEP)
        step = -root @ (root.T @ gradient)
        if np.abs(step).max() < STEP_TOLERANCE:
            break
        u = np.clip(u + step, -farthest, farthest)
    return lowest


def root_about(cost: Cost, mode: Array) -> Array:
    """Root (d, d) of the inverse curvature at the mode, no wider than is sensible."""
    d = len(mode)
    unit = CURVATURE_STEP * np.eye(d)
    pairs = [(i, j) for i in range(d) for j in range(i)]
    both = [unit[i] + unit[j] for i, j in pairs]
    points = np.vstack([np.zeros(d), unit, -unit, *both])
    costs = cost(mode + points)
    middle, ahead, behind = costs[0], costs[1 : d + 1], costs[d + 1 : 2 * d + 1]
    curvature = np.diag(ahead + behind - 2.0 * middle)
    for (i, j), value in zip(pairs, costs[2 * d + 1 :], strict=True):
        mixed = value - ahead[i] - ahead[j] + middle
        curvature[i, j] = curvature[j, i] = mixed
    values, vectors = eigenvectors(curvature / CURVATURE_STEP**2)
    root: Array = vectors / np.sqrt(np.maximum(values, MIN_CURVATURE))
    return root


@dataclasses.dataclass(frozen=True, eq=False)
class DrawnLaws:
    """Laws of a posterior: draws (n, d), the mode (d,), the log of its integral."""

    draws: Array
    mode: Array
    log_integral: float


def draw_laws(
    cost: Cost, starts: Array, farthest: float, *, points: int, draws: int
) -> DrawnLaws:
    """Draw laws by their cost from starts (s, d), spread along the posterior's widest
    axis; one where there is no coordinate, or a mode in a corner, as by rows that are
    copies.
    """
    mode, sample = starts[0], starts[:0]
    if starts.shape[1]:
        mode = polish(cost, find_mode(cost, starts, farthest), farthest)
        proposal = split_student(cost, mode, _signed(root_about(cost, mode)))
        sample = proposal.points(points)
        sample = sample[np.abs(sample).max(axis=1) < farthest]
    if not len(sample):
        return DrawnLaws(np.tile(mode, (draws, 1)), mode, -float(cost(mode[None])[0]))
    log_weights = -cost(sample) - proposal.log_density(sample)
    total = float(scipy.special.logsumexp(log_weights))
    rows = _systematic(sample, np.exp(log_weights - total), draws)
    return DrawnLaws(sample[rows], mode, total - float(np.log(points)))


def _systematic(points: Array, weights: Array, count: int) -> Index:
    """Numbers (count,) of points by their weights, spread along the widest axis."""
    offsets = points - weights @ points
    _, vectors = np.linalg.eigh((offsets * weights[:, None]).T @ offsets)
    order = np.argsort(offsets @ _signed(vectors)[:, -1])
    levels = (np.arange(count) + 0.5) / count
    ranks = np.searchsorted(np.cumsum(weights[order]), levels)
    return order[np.minimum(ranks, len(order) - 1)]


def _signed(vectors: Array) -> Array:
    """Columns (d, k), largest component positive: rounding decides no sign."""
    largest = np.argmax(np.abs(vectors), axis=0)
    return vectors * np.sign(vectors[largest, range(vectors.shape[1])])


#: degrees of freedom of the Student t of proposals. Tails of 5 waste nearly all draws of ten
#: coordinates, as six channels have: 17 of 320 were left, and intervals a third too wide
STUDENT_DOF = 20.0
#: distances from the mode at which widths are read off, standard deviations by curvature
TAIL_DISTANCES = (1.0, 2.0, 3.5)
WIDTH_LIMITS = (0.7, 4.0)  #: least and largest width, over that by the curvature
MIN_RISE = 1e-3  #: least rise of the cost at these distances: the cost may be flat
#: power of the weights by which kernels are placed: a single draw must not take all
WEIGHT_POWER = 0.5
#: numbers of offsets from kernels that are computed at once: 4 MB
KERNEL_VALUES = 500_000


@dataclasses.dataclass(frozen=True, eq=False)
class SplitStudent:
    """Student t about a mode, with a width of its own on either side of each axis."""

    mode: Array  #: (d,)
    root: Array  #: (d, d) axes in columns
    #: (d,) widths on either side, over the axes' lengths
    behind: Array
    ahead: Array

    def points(self, count: int) -> Array:
        """Points (count, d)."""
        uniform = _sobol(count, len(self.mode) + 1)
        share = self.behind / (self.behind + self.ahead)
        level = uniform[:, :-1]
        chi2 = _chi2(uniform[:, -1:])
        below = 0.5 * level / share
        above = 1.0 - 0.5 * (1.0 - level) / (1.0 - share)
        normal = scipy.special.ndtri(np.where(level < share, below, above))
        student = normal / np.sqrt(chi2 / STUDENT_DOF)
        width = np.where(student < 0.0, self.behind, self.ahead)
        return np.asarray(self.mode + (width * student) @ self.root.T)

    def log_density(self, u: Array) -> Array:
        """Log density (L,) at points (L, d)."""
        along = np.linalg.solve(self.root, (u - self.mode).T).T
        student = along / np.where(along < 0.0, self.behind, self.ahead)
        size = np.log(0.5 * (self.behind + self.ahead)).sum()
        size += np.linalg.slogdet(self.root)[1]
        return np.asarray(_log_student(student) - size)


@dataclasses.dataclass(frozen=True, eq=False)
class KernelMixture:
    """Student t kernels at points."""

    centres: Array  #: (m, d)
    weights: Array  #: (m,) sum 1
    root: Array  #: (d, d) of the kernels' scale matrix

    def points(self, count: int) -> Array:
        """Points (count, d)."""
        uniform = _sobol(count, self.centres.shape[1] + 2)
        ends = np.cumsum(self.weights)
        number = np.searchsorted(ends, uniform[:, -2] * ends[-1])
        normal = scipy.special.ndtri(uniform[:, :-2])
        student = normal / np.sqrt(_chi2(uniform[:, -1:]) / STUDENT_DOF)
        return np.asarray(self.centres[number] + student @ self.root.T)

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """`count` random points or fewer (m, d): those that are not too far."""
        number = rng.choice(len(self.weights), size=count, p=self.weights)
        normal = rng.standard_normal((count, self.centres.shape[1]))
        student = normal / np.sqrt(rng.chisquare(STUDENT_DOF, (count, 1)) / STUDENT_DOF)
        points = self.centres[number] + student @ self.root.T
        return np.asarray(points[np.abs(points).max(axis=1) < MAX_COORDINATE])

    def log_density(self, u: Array) -> Array:
        """Log density (L,) at points (L, d)."""
        few = max(1, KERNEL_VALUES // self.centres.size)
        starts = range(0, len(u), few)
        return np.concatenate([self._log_density(u[k : k + few]) for k in starts])

    def _log_density(self, u: Array) -> Array:
        offsets = (u[:, None] - self.centres).reshape(-1, u.shape[1])
        student = np.asarray(np.linalg.solve(self.root, offsets.T).T, dtype=float)
        kernels = _log_student(student).reshape(len(u), -1)
        total = scipy.special.logsumexp(kernels, axis=1, b=self.weights)
        return np.asarray(total - np.linalg.slogdet(self.root)[1])


def split_student(cost: Cost, mode: Array, root: Array) -> SplitStudent:
    """The split Student of a cost, by a root (d, d) of inverse curvature."""
    steps = np.array(TAIL_DISTANCES)[:, None, None]
    moves = (steps * np.vstack([-root.T, root.T])).reshape(-1, len(root))
    costs = cost(mode + np.vstack([np.zeros(len(root)), moves]))
    rise = np.maximum(costs[1:] - costs[0], MIN_RISE)
    ratio = steps[..., 0] / np.sqrt(2.0 * rise).reshape(len(steps), -1)
    behind, ahead = np.split(np.clip(ratio.max(axis=0), *WIDTH_LIMITS), 2)
    return SplitStudent(mode, root, behind, ahead)


def kernels_at(
    draws: Array, log_weights: Array, widening: float = 1.0
) -> KernelMixture:
    """Kernels at draws (m, d), by weights, `widening` over the best for a normal."""
    weights = np.exp(WEIGHT_POWER * (log_weights - log_weights.max()))
    weights /= weights.sum()
    offsets = draws - weights @ draws
    covariance = (offsets * weights[:, None]).T @ offsets
    d = draws.shape[1]
    # Silverman's rule for as many normal draws as the weights are worth.
    effective = 1.0 / (weights**2).sum()
    width = (4.0 / ((d + 2.0) * effective)) ** (1.0 / (d + 4.0))
    values, vectors = eigenvectors(covariance)
    least = 1e-6 * values.max()
    root = widening * width * vectors * np.sqrt(np.maximum(values, least))
    return KernelMixture(draws, weights, root)


def _log_student(student: Array) -> Array:
    """Log density (L,) of a Student t of unit scale at points (L, d)."""
    d = student.shape[1]
    power = 0.5 * (STUDENT_DOF + d)
    size = scipy.special.gammaln(power) - scipy.special.gammaln(0.5 * STUDENT_DOF)
    size -= 0.5 * d * np.log(np.pi * STUDENT_DOF)
    return np.asarray(size - power * np.log1p((student**2).sum(axis=1) / STUDENT_DOF))


def _chi2(uniform: Array) -> Array:
    return np.asarray(scipy.special.chdtri(STUDENT_DOF, 1.0 - uniform))


@functools.cache
def _sobol(count: int, dimensions: int) -> Array:
    """Points (count, dimensions) of a Sobol sequence, the one at the origin left out."""
    from scipy.stats import qmc  # takes a second to import

    sequence = qmc.Sobol(dimensions, scramble=False)
    with warnings.catch_warnings():
        # Balance asks for powers of two, and the first point has no finite quantile.
        warnings.simplefilter("ignore", UserWarning)
        return np.asarray(sequence.random(count + 1)[1:])


N_DRAWS = 320  #: laws drawn in a round
#: equally weighted laws that a first round is worth, below which there is a second
MIN_EFFECTIVE_DRAWS = 100.0
#: largest coordinate of the mode, prior sd: readings without noise have theirs at the
#: end, and draws must fit beyond it
MAX_MODE = MAX_COORDINATE - 1.0
N_PLACEMENTS = 2  #: rounds in which kernels are placed anew at laws drawn from them
PLACEMENT_LAWS = 640  #: laws drawn in each of these rounds
#: factor on the width of kernels: tails that a proposal lacks give large weights
KERNEL_WIDENING = 1.3


@dataclasses.dataclass(frozen=True, eq=False)
class ResidualModel:
    """Standardised residuals of readings about an estimate of z ~ N(0, I)."""

    structure: ReadingStructure
    residual: Array  #: (N,)
    slopes: Array  #: (N, r) over z
    #: (r,) the estimate. Near the solution: the likelihood is a difference of squares,
    #: which loses digits elsewhere
    centre: Array

    def solve(self, laws: Laws) -> Solutions:
        """Log marginal likelihood and posterior of z under each law."""
        structure = self.structure
        shared = structure.effects.shape[1] + structure.course.shape[1]
        columns = 1 + self.slopes.shape[1] + shared
        of_chains = len(structure.run) * len(structure.kinds)
        batches = laws.batches(columns * max(columns, of_chains))
        return concatenate_solutions([self._solve(batch) for batch in batches])

    def cost(self, prior: NoisePrior, u: Array) -> Array:
        """Minus log posterior (L,) of laws at coordinates (L, d)."""
        log_marginal = self.solve(prior.laws(u)).log_marginal
        return np.asarray(0.5 * (u**2).sum(axis=1) - log_marginal)

    def most_probable(self, prior: NoisePrior, near: Array | None = None) -> Array:
        """The most probable coordinates (d,), from several starts, or from one near."""
        starts = prior.starts() if near is None else near[None]
        return find_mode(functools.partial(self.cost, prior), starts, MAX_MODE)

    def integrate(self, prior: NoisePrior, mode: Array | None = None) -> NoisePosterior:
        """The posterior of the noise law, and of z with the law integrated out.

        mode  (d,) most probable coordinates; sought by default

        Where a first round of laws is worth too few, a second is drawn where the first has
        weight, and all are weighted by both rounds' density together (`oed.noise_law.marginal`).
        """
        if mode is None:
            mode = self.most_probable(prior)

        cost = functools.partial(self.cost, prior)
        root = root_about(cost, mode)
        first = split_student(cost, mode, root)
        draws, solutions, target = self._solve_at(prior, first.points(N_DRAWS))
        log_weights = target - first.log_density(draws)
        weights = scipy.special.softmax(log_weights)
        if 1.0 / (weights @ weights) < MIN_EFFECTIVE_DRAWS:
            second = kernels_at(draws, log_weights)
            further, more, more_target = self._solve_at(prior, second.points(N_DRAWS))
            draws = np.vstack([draws, further])
            solutions = concatenate_solutions([solutions, more])
            target = np.concatenate([target, more_target])
            densities = first.log_density(draws), second.log_density(draws)
            weights = scipy.special.softmax(target - np.logaddexp(*densities))
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
    """Of L laws: log marginal likelihood, and posterior of z."""

    #: (L,) log determinant of the readings' covariance, z integrated out
    log_size: Array
    #: (L, r + 1, r + 1) Cholesky factor of the products of slopes and residual, with
    #: the prior
    triangle: Array
    centre: Array  #: (L, r) the z about which they are

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
        triangles = self.triangle[:, :-1, :-1]
        return np.array(
            [scipy.linalg.lapack.dtrtri(t, lower=1)[0].T for t in triangles]
        )

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
    """Posterior of the noise law, as weighted draws."""

    prior: NoisePrior  #: of the coordinates
    structure: ReadingStructure  #: of the readings
    draws: Array  #: (L, d) coordinates u
    weights: Array  #: (L,) sum 1
    mode: Array  #: (d,) most probable coordinates
    root: Array  #: (d, d) root of the covariance about the mode
    mean: Array  #: (r,) of z, over laws
    covariance: Array  #: (r, r) of z, over laws
    solutions: Solutions  #: of each drawn law

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
        for _ in range(N_PLACEMENTS):
            laws = kernels.draw(rng, PLACEMENT_LAWS)
            log_target = -model.cost(self.prior, laws)
            log_weights = log_target - kernels.log_density(laws)
            kernels = kernels_at(laws, log_weights, KERNEL_WIDENING)
        return kernels
