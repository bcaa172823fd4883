"""Where laws are drawn: the mode, a split Student about it, then kernels at its draws.

What a run shares may be as large as the readings show, or nothing while an error that
is carried far stands for it. Such a posterior is steep on one side of its mode and has
a long, crooked tail on the other. The split Student (Geweke 1989, Econometrica 57,
1317-1339) is as wide on either side of each axis as the posterior; the kernels at the
weighted draws follow the tail (population Monte Carlo; Cappe et al. 2004, Journal of
Computational and Graphical Statistics 13, 907-929).

Points are those of a Sobol sequence, so that the same readings give the same laws. A
sampler draws from the kernels at random.
"""

from __future__ import annotations

import dataclasses
import functools
import warnings
from collections.abc import Callable

import numpy as np
from scipy import optimize, special

from oed.base.arrays import Array
from oed.base.linear_algebra import eigenvectors

#: step of numerical slopes and curvatures, and least curvature, in prior sd
SLOPE_STEP, CURVATURE_STEP, LEAST_CURVATURE = 1e-4, 0.15, 0.5
#: Newton steps after the search, at most; a step that is none, and that of their slopes,
#: in prior sd; and by how much the cost may rise by rounding
NEWTON_STEPS, CONVERGED, FINE_STEP, ROUNDING = 6, 3e-4, 0.01, 1e-6

#: minus log posterior density (L,), up to a constant, at coordinates (L, d)
Cost = Callable[[Array], Array]


def find_mode(cost: Cost, starts: Array, farthest: float) -> Array:
    """Coordinates (d,) of least cost from some starts (s, d), none beyond `farthest`."""
    dimensions = starts.shape[1]
    steps = np.vstack([np.zeros(dimensions), np.eye(dimensions)]) * SLOPE_STEP

    def cost_and_slope(u: Array) -> tuple[float, Array]:
        costs = cost(u + steps)
        return float(costs[0]), (costs[1:] - costs[0]) / SLOPE_STEP

    limits = [(-farthest, farthest)] * dimensions
    minima = [
        optimize.minimize(
            cost_and_slope,
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
    that is depends on rounding. Newton steps go on to where the slopes vanish.
    """
    root = root_about(cost, u)
    moves = FINE_STEP * np.eye(len(u))
    moves = np.vstack([np.zeros(len(u)), moves, -moves])
    lowest, least = u, np.inf
    for _ in range(NEWTON_STEPS):
        costs = cost(u + moves)
        if costs[0] > least + ROUNDING:
            break
        lowest, least = u, float(costs[0])
        ahead, behind = np.split(costs[1:], 2)
        slope = (ahead - behind) / (2.0 * FINE_STEP)
        step = -root @ (root.T @ slope)
        if np.abs(step).max() < CONVERGED:
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
    root: Array = vectors / np.sqrt(np.maximum(values, LEAST_CURVATURE))
    return root


def signed(vectors: Array) -> Array:
    """Vectors in columns (d, k), each with its largest component positive.

    An eigenvector's sign is a matter of rounding.
    """
    largest = np.argmax(np.abs(vectors), axis=0)
    return vectors * np.sign(vectors[largest, range(vectors.shape[1])])


#: degrees of freedom of the Student t. Tails of 5 waste nearly all draws of ten
#: coordinates, as six channels have: 17 of 320 were left, and intervals a third too wide
DEGREES = 20.0
#: distances, in standard deviations by the curvature, at which the tails are looked at;
#: limits of what they stretch it; least rise of the cost
STRETCH_STEPS, STRETCH_LIMITS, LEAST_RISE = (1.0, 2.0, 3.5), (0.7, 4.0), 1e-3
#: power of the weights by which kernels are placed: a single draw must not take all
TEMPER = 0.5
#: numbers of offsets from kernels that are computed at once
KERNEL_VALUES = 500_000


@dataclasses.dataclass(frozen=True, eq=False)
class SplitStudent:
    """Student t about a mode, with a width of its own on either side of each axis.

    mode           (d,)
    root           (d, d) axes in columns
    behind, ahead  (d,) widths on either side, over the axes' lengths
    """

    mode: Array
    root: Array
    behind: Array
    ahead: Array

    def points(self, count: int) -> Array:
        """Points (count, d)."""
        uniform = _sobol(count, len(self.mode) + 1)
        share = self.behind / (self.behind + self.ahead)
        place, chi2 = uniform[:, :-1], _chi2(uniform[:, -1:])
        below = 0.5 * place / share
        above = 1.0 - 0.5 * (1.0 - place) / (1.0 - share)
        normal = special.ndtri(np.where(place < share, below, above))
        student = normal / np.sqrt(chi2 / DEGREES)
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
    """Student t kernels at points.

    centres  (m, d)
    weights  (m,) sum 1
    root     (d, d) of the kernels' scale matrix
    """

    centres: Array
    weights: Array
    root: Array

    def points(self, count: int) -> Array:
        """Points (count, d)."""
        uniform = _sobol(count, self.centres.shape[1] + 2)
        ends = np.cumsum(self.weights)
        number = np.searchsorted(ends, uniform[:, -2] * ends[-1])
        normal = special.ndtri(uniform[:, :-2])
        student = normal / np.sqrt(_chi2(uniform[:, -1:]) / DEGREES)
        return np.asarray(self.centres[number] + student @ self.root.T)

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Random points (count, d)."""
        number = rng.choice(len(self.weights), size=count, p=self.weights)
        normal = rng.standard_normal((count, self.centres.shape[1]))
        student = normal / np.sqrt(rng.chisquare(DEGREES, (count, 1)) / DEGREES)
        return np.asarray(self.centres[number] + student @ self.root.T)

    def log_density(self, u: Array) -> Array:
        """Log density (L,) at points (L, d)."""
        few = max(1, KERNEL_VALUES // self.centres.size)
        starts = range(0, len(u), few)
        return np.concatenate([self._log_density(u[k : k + few]) for k in starts])

    def _log_density(self, u: Array) -> Array:
        offsets = (u[:, None] - self.centres).reshape(-1, u.shape[1])
        student = np.asarray(np.linalg.solve(self.root, offsets.T).T, dtype=float)
        kernels = _log_student(student).reshape(len(u), -1)
        total = special.logsumexp(kernels, axis=1, b=self.weights)
        return np.asarray(total - np.linalg.slogdet(self.root)[1])


def split_student(
    cost: Callable[[Array], Array], mode: Array, root: Array
) -> SplitStudent:
    """The split Student for a cost (L,) of points (L, d), minus its log density.

    root  (d, d) of the inverse curvature at the mode
    """
    steps = np.array(STRETCH_STEPS)[:, None, None]
    moves = (steps * np.vstack([-root.T, root.T])).reshape(-1, len(root))
    costs = cost(mode + np.vstack([np.zeros(len(root)), moves]))
    rise = np.maximum(costs[1:] - costs[0], LEAST_RISE)
    ratio = steps[..., 0] / np.sqrt(2.0 * rise).reshape(len(steps), -1)
    behind, ahead = np.split(np.clip(ratio.max(axis=0), *STRETCH_LIMITS), 2)
    return SplitStudent(mode, root, behind, ahead)


def kernels_at(
    draws: Array, log_weights: Array, widening: float = 1.0
) -> KernelMixture:
    """Kernels at draws (m, d), more where their weights are larger.

    widening  of the kernels, over the best for a normal density
    """
    weights = np.exp(TEMPER * (log_weights - log_weights.max()))
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
    power = 0.5 * (DEGREES + d)
    size = special.gammaln(power) - special.gammaln(0.5 * DEGREES)
    size -= 0.5 * d * np.log(np.pi * DEGREES)
    return np.asarray(size - power * np.log1p((student**2).sum(axis=1) / DEGREES))


def _chi2(uniform: Array) -> Array:
    return np.asarray(special.chdtri(DEGREES, 1.0 - uniform))


@functools.cache
def _sobol(count: int, dimensions: int) -> Array:
    """Points (count, dimensions) of a Sobol sequence, the one at the origin left out."""
    from scipy.stats import qmc  # takes a second to import

    sequence = qmc.Sobol(dimensions, scramble=False)
    with warnings.catch_warnings():
        # Balance asks for powers of two, and the first point has no finite quantile.
        warnings.simplefilter("ignore", UserWarning)
        return np.asarray(sequence.random(count + 1)[1:])
