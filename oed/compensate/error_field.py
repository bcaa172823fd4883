"""Pose errors over a box of commands by Gaussian processes, and where to read them.

What calibration leaves is smooth in the struts, which yield under load, not in the
pose: near a singular pose a strut's error moves the tool far. So a reading is J u, with
J the motion of the tool per strut and u the strut errors that would cause it. Each of
them is a linear trend plus a field with Matern's correlation of order 3/2
(the discrepancy's, `oed.base.smooth_basis`) or 5/2, one length for
each axis. Lengths, size and order maximise the marginal likelihood times a weak prior
on the lengths (Rasmussen and Williams 2006, Gaussian Processes for Machine Learning,
Eqs. 2.25-2.26, 2.42, 4.9, 4.17, 5.8).

A grid design takes the readings of least predicted variance. A field of errors is a sum
of its leading Karhunen-Loeve modes with unit normal coefficients, besides a trend. Then a
reading is a row, and the mean variance over the box is criterion I with a prior, for
which `oed.design.exchange` chooses the places and certifies them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from scipy import linalg, optimize

from oed.base.arrays import Array
from oed.compensate.table import grid_nodes
from oed.design.criterion import Variance
from oed.design.exchange import choose

#: kernels that compete: correlation at scaled distances
ORDERS = ("3/2", "5/2")
#: prior of a correlation length, in half spans of the box: median, and sd of its log
LENGTH, LENGTH_SPREAD = 1.0, 1.0
#: standard deviation of the trend's coefficients over the size of the readings
TREND_SIZE = 10.0
#: share of a component's variance that is added to each reading: rounding
NUGGET = 1e-9
#: lengths from which the optimisation starts
STARTS = (0.5, 2.0)
#: candidate places along an axis, by the number of axes; further ones have the last
CANDIDATES = (41, 11, 6, 4)
#: share of a field's variance that its modes hold, and most modes of a component
ENERGY, MODES = 0.999, 40
#: standard deviation of the trend's coefficients over the size of the field
TREND = 10.0
#: rounds of the design's local search
ROUNDS = 1


@dataclasses.dataclass(frozen=True)
class Box:
    """A box of commands.

    names  (a,) of the coordinates
    lower  (a,) SI
    upper  (a,) SI
    """

    names: tuple[str, ...]
    lower: Array
    upper: Array

    def scaled(self, places: Array) -> Array:
        """Places (n, a) with the box from -1 to 1."""
        return 2.0 * (places - self.lower) / (self.upper - self.lower) - 1.0

    def lattice(self, counts: Sequence[int]) -> tuple[Array, ...]:
        """`counts` (a,) evenly spaced places along each axis, SI."""
        spans = zip(self.lower, self.upper, counts, strict=True)
        return tuple(np.linspace(low, high, n) for low, high, n in spans)


@dataclasses.dataclass(frozen=True)
class Kernel:
    """Covariance of one error component, without its trend.

    order   one of ORDERS
    size    standard deviation, SI
    length  (a,) correlation lengths, in half spans of the box
    """

    order: str
    size: float
    length: Array

    def covariance(self, first: Array, second: Array) -> Array:
        """Covariance (n, m) between scaled places (n, a) and (m, a)."""
        difference = (first[:, None] - second[None]) / self.length
        distance = np.sqrt((difference**2).sum(axis=-1))
        return self.size**2 * _correlation(self.order, distance)


def _correlation(order: str, distance: Array) -> Array:
    if order == "5/2":
        scaled = np.sqrt(5.0) * distance
        return np.asarray((1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled))
    scaled = np.sqrt(3.0) * distance
    return np.asarray((1.0 + scaled) * np.exp(-scaled))


#: motion (n, k, k) of the pose components per strut error at places (n, a), SI
Motion = Callable[[Array], Array]


@dataclasses.dataclass(frozen=True)
class ErrorField:
    """Errors of k components over a box, given readings.

    box      of commands
    motion   J at places
    places   (n, a) of the readings, SI
    struts   (n, k) strut errors that the readings amount to, SI
    sd_read  (n, k) noise of these, SI
    kernels  (k,) of the strut errors
    """

    box: Box
    motion: Motion
    places: Array
    struts: Array
    sd_read: Array
    kernels: tuple[Kernel, ...]

    def mean(self, places: Array) -> Array:
        """Expected pose errors (m, k) at places (m, a), SI."""
        means = [self._strut(places, k)[0] for k in range(len(self.kernels))]
        strut_errors = np.column_stack(means)
        return np.asarray(np.einsum("mkj,mj->mk", self.motion(places), strut_errors))

    def sd(self, places: Array, reference: Array) -> Array:
        """Standard deviations (m, k) of error less that at the reference (a,), SI."""
        both = np.vstack([places, reference[None]])
        motion = self.motion(both)
        variance = np.zeros((len(places), motion.shape[1]))
        for j in range(len(self.kernels)):
            covariance = self._strut(both, j)[1]
            here, there = motion[:-1, :, j], motion[-1, :, j]
            variance += here**2 * np.diag(covariance)[:-1, None]
            variance += there**2 * covariance[-1, -1]
            variance -= 2.0 * here * there * covariance[:-1, -1, None]
        return np.sqrt(np.maximum(variance, 0.0))

    def _strut(self, places: Array, k: int) -> tuple[Array, Array]:
        """Mean (m,) and covariance (m, m) of strut error k, Eqs. 2.25-2.26."""
        scaled, read = self.box.scaled(places), self.box.scaled(self.places)
        kernel, trend = self.kernels[k], _trend_size(self.struts[:, k])
        prior = _with_trend(kernel, trend, scaled, scaled)
        cross = _with_trend(kernel, trend, scaled, read)
        among = _with_trend(kernel, trend, read, read)
        noise = self.sd_read[:, k] ** 2 + NUGGET * kernel.size**2
        factor = linalg.cho_factor(among + np.diag(noise))
        gain = linalg.cho_solve(factor, cross.T).T
        return gain @ self.struts[:, k], prior - gain @ cross.T


def fit_error_field(
    box: Box, motion: Motion, places: Array, errors: Array, sigma: Array
) -> ErrorField:
    """The field that readings `errors` (n, k) at places (n, a) make most probable.

    sigma  (k,) noise of a reading, SI

    Raises ValueError for fewer readings than a trend needs, with one to spare.
    """
    needed = places.shape[1] + 2
    if len(places) < needed:
        raise ValueError(
            f"{len(places)} readings of the grid are too few: take {needed} or more"
        )
    scaled = box.scaled(places)
    inverse = np.linalg.inv(motion(places))
    struts = np.einsum("njk,nk->nj", inverse, errors)
    sd_read = np.sqrt(np.einsum("njk,k->nj", inverse**2, np.asarray(sigma) ** 2))
    kernels = tuple(
        _fit_kernel(scaled, strut, sd)
        for strut, sd in zip(struts.T, sd_read.T, strict=True)
    )
    return ErrorField(box, motion, places, struts, sd_read, kernels)


def _fit_kernel(scaled: Array, errors: Array, sigma: Array) -> Kernel:
    """The kernel with the largest posterior density among all orders."""
    axes = scaled.shape[1]
    size = max(float(np.std(errors)), float(np.median(sigma)), 1e-12)

    def kernel_of(values: Array, order: str) -> Kernel:
        length = LENGTH * np.exp(np.clip(values[1:], -3.0, 3.0))
        return Kernel(
            order, size * float(np.exp(np.clip(values[0], -8.0, 8.0))), length
        )

    best, best_value = Kernel("3/2", size, np.full(axes, LENGTH)), np.inf
    for order in ORDERS:
        for start in STARTS:
            initial = np.r_[0.0, np.full(axes, np.log(start))]
            solution = optimize.minimize(
                lambda values, order=order: _negative_log_posterior(
                    kernel_of(values, order), values, scaled, errors, sigma
                ),
                initial,
                method="L-BFGS-B",
                bounds=[(-8.0, 8.0), *[(-3.0, 3.0)] * axes],
            )
            if solution.fun < best_value:
                best, best_value = kernel_of(solution.x, order), solution.fun
    return best


def _negative_log_posterior(
    kernel: Kernel, values: Array, scaled: Array, errors: Array, sigma: Array
) -> float:
    """Of the marginal likelihood, Eq. 5.8, and the prior on the lengths."""
    covariance = _with_trend(kernel, _trend_size(errors), scaled, scaled)
    noise = sigma**2 + NUGGET * kernel.size**2
    try:
        root = linalg.cholesky(covariance + np.diag(noise), lower=True)
    except linalg.LinAlgError:
        return 1e10
    whitened = linalg.solve_triangular(root, errors, lower=True)
    fit = 0.5 * float(whitened @ whitened) + float(np.log(np.diag(root)).sum())
    return fit + 0.5 * float(np.sum((values[1:] / LENGTH_SPREAD) ** 2))


def _trend_size(errors: Array) -> float:
    return TREND_SIZE * max(float(np.abs(errors).max()), 1e-12)


def _with_trend(kernel: Kernel, size: float, first: Array, second: Array) -> Array:
    """Covariance (n, m) of field and linear trend with coefficients of sd `size`."""
    trend = 1.0 + first @ second.T
    return kernel.covariance(first, second) + size**2 * trend


@dataclasses.dataclass(frozen=True)
class GridDesign:
    """Places to read, with their certificate.

    places      (n, a) SI
    predicted   (k,) rms error that interpolation between these readings leaves, SI
    efficiency  share of the readings that the best plan would need
    """

    places: Array
    predicted: Array
    efficiency: float | None


def expected_kernel(size: float, axes: int) -> Kernel:
    """The kernel before any reading: the discrepancy's, Matern's of order 3/2.

    size  standard deviation that calibration is expected to leave, SI
    """
    return Kernel("3/2", size, np.full(axes, LENGTH))


def design_grid(
    box: Box,
    motion: Motion,
    budget: int,
    kernels: tuple[Kernel, ...],
    sigma: Array,
    rng: np.random.Generator,
    *,
    reference: Array,
    read: Array | None = None,
) -> GridDesign:
    """Choose `budget` further places, where `read` (n, a) are read already.

    motion     of the pose components per strut error, at places
    kernels    (k,) of the strut errors
    sigma      (k,) noise of a reading, SI
    reference  (a,) place whose errors are subtracted from all others, SI

    Raises ValueError for a budget of nothing, or beyond the number of candidates.
    """
    axes = len(box.names)
    count = CANDIDATES[min(axes, len(CANDIDATES)) - 1]
    candidates = grid_nodes(box.lattice([count] * axes))
    if not 1 <= budget <= len(candidates):
        raise ValueError(f"a budget of {budget} is not between 1 and {len(candidates)}")
    earlier = np.zeros((0, axes)) if read is None else read
    places = np.vstack([candidates, earlier, reference[None]])
    modes = [_modes(kernel, box.scaled(places)) for kernel in kernels]
    errors = _error_rows(motion(places), modes)
    blocks = errors / sigma[:, None]
    known = blocks[len(candidates) : -1].reshape(-1, blocks.shape[2])
    prior = np.eye(blocks.shape[2]) + known.T @ known
    blocks = blocks[: len(candidates)]
    relative = errors[: len(candidates)] - errors[-1]
    rows = relative.reshape(-1, blocks.shape[2]) / max(k.size for k in kernels)
    factor = np.linalg.qr(rows, mode="r") / np.sqrt(len(rows))
    choice = choose(
        blocks, budget, rng, criterion=Variance(factor), prior=prior, rounds=ROUNDS
    )
    chosen = blocks[choice.indices].reshape(-1, blocks.shape[2])
    covariance = np.linalg.inv(prior + chosen.T @ chosen)
    variance = np.einsum("ckn,nm,ckm->ck", relative, covariance, relative)
    return GridDesign(
        places=candidates[choice.indices],
        predicted=np.sqrt(variance.mean(axis=0)),
        efficiency=choice.efficiency,
    )


def _modes(kernel: Kernel, scaled: Array) -> Array:
    """Trend and leading modes (n, r) of a component at scaled places (n, a)."""
    values, vectors = np.linalg.eigh(kernel.covariance(scaled, scaled))
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    needed = int(np.searchsorted(np.cumsum(values), ENERGY * values.sum())) + 1
    size = min(needed, MODES)
    field = vectors[:, :size] * np.sqrt(values[:size])
    trend = TREND * kernel.size * np.column_stack([np.ones(len(scaled)), scaled])
    return np.hstack([trend, field])


def _error_rows(motion: Array, modes: list[Array]) -> Array:
    """Rows (n, k, sum r) of the pose errors over the coefficients of all struts' modes.

    motion  (n, k, struts)
    modes   of each strut (n, r)
    """
    parts = [motion[:, :, j, None] * m[:, None] for j, m in enumerate(modes)]
    return np.concatenate(parts, axis=2)
