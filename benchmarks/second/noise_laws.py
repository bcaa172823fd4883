"""The second generator's noise laws, with what readings say of a change under each.

Under a law, readings over sigma are d = X theta + a s + e: X are geometry and the reference
readings' own noise, theta ~ N(0, 1), s a change of the readings, e the noise. The
generator draws the law's parameters uniformly; here they take the nodes of Gauss-Legendre
quadrature. Gaussian laws are exact. Student's and outliers take theta out by Laplace's
method about its mode, and score a change by its slope there (Rao), unless its exact
shape is known.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import linalg, special
from scipy.stats import qmc

from benchmarks.second.replay import Replay
from oed.base import Array
from oed.gap.data.evidence import RATE, SHAPE
from oed.noise_law import NoisePrior

#: nodes of quadrature of each law's parameters
REPEAT_NODES, AR_NODES, MIX_NODES = 4, (3, 3), (3, 2, 2)
#: the generator's ranges: run-to-run and AR(1) standard deviations over sigma, rho
RUN_SD, AR_SD, RHO = (0.6, 1.5), (0.4, 0.9), (0.8, 0.95)
#: degrees of freedom of its t distribution; share and size of its outliers, over sigma
DEGREES, OUTLYING, FAR = 3.0, 0.01, (8.0, 20.0)
ITERATIONS = 40
#: points that stand for the toolkit's prior of laws, and the seed of their Sobol sequence
POINTS, POINT_SEED = 256, 1
#: density of readings that no law explains
TINY = 1e-290


@dataclasses.dataclass(frozen=True)
class Law:
    """A noise law: `shape` of single readings, run-to-run and AR(1) parts over sigma.

    single_sd      of what each reading has alone, over sigma
    level_is_free  whether a factor on all of the noise is integrated over, with the
                   toolkit's prior
    """

    shape: str
    run_sd: float = 0.0
    ar_sd: float = 0.0
    rho: float = 0.0
    log_prior: float = 0.0
    single_sd: float = 1.0
    level_is_free: bool = False


def laws() -> list[Law]:
    """Laws that stand for all that the generator draws, with their log priors."""
    sixth = 1.0 / 6.0
    grid = [Law(s, log_prior=np.log(sixth)) for s in ("white", "outlier", "student")]
    for run, weight in zip(*_nodes(RUN_SD, REPEAT_NODES), strict=True):
        grid.append(Law("white", run_sd=run, log_prior=np.log(sixth * weight)))
    for run_nodes, ar_nodes in ((0, AR_NODES), (MIX_NODES[0], MIX_NODES[1:])):
        runs = _nodes(RUN_SD, run_nodes) if run_nodes else ([0.0], [1.0])
        for run, run_weight in zip(*runs, strict=True):
            for ar, ar_weight in zip(*_nodes(AR_SD, ar_nodes[0]), strict=True):
                for rho, rho_weight in zip(*_nodes(RHO, ar_nodes[1]), strict=True):
                    prior = np.log(sixth * run_weight * ar_weight * rho_weight)
                    grid.append(Law("white", run, ar, rho, prior))
    return grid


def usual_laws() -> list[Law]:
    """Gaussian laws by the toolkit's prior of the level, of run-to-run and carried parts."""
    prior = NoisePrior(
        ("level", NoisePrior.CARRIED, NoisePrior.REACH, NoisePrior.RUN), 1
    ).sparse()
    sobol = qmc.Sobol(3, seed=POINT_SEED)
    u = special.ndtri(sobol.random_base2(int(np.log2(POINTS))))
    drawn = prior.laws(np.column_stack([np.zeros(POINTS), u]))
    return [
        Law(
            "white",
            run_sd=run,
            ar_sd=np.sqrt(share),
            rho=np.exp(-1.0 / reach),
            log_prior=-np.log(POINTS),
            single_sd=np.sqrt(1.0 - share),
            level_is_free=True,
        )
        for run, share, reach in zip(
            drawn.level, drawn.carried, drawn.reach, strict=True
        )
    ]


def law_of_label(info: Mapping[str, Any]) -> Law:
    """The law that a case has."""
    name = info["law"]
    return Law(
        shape=name if name in ("outlier", "student") else "white",
        run_sd=info.get("repeat_over_sigma", 0.0),
        ar_sd=info.get("ar_over_sigma", 0.0),
        rho=info.get("rho", 0.0),
    )


def _nodes(interval: tuple[float, float], count: int) -> tuple[Array, Array]:
    """Nodes and weights, of sum 1, of quadrature over an interval."""
    places, weights = np.polynomial.legendre.leggauss(count)
    low, high = interval
    return low + 0.5 * (high - low) * (places + 1.0), 0.5 * weights


def noise_covariance(replay: Replay, law: Law) -> Array:
    """(n, n) of the noise over sigma, by the Fisher information of single readings."""
    order, run = np.arange(len(replay.run)), replay.run
    same = run[:, None] == run
    level = (DEGREES + 3.0) / (DEGREES + 1.0) if law.shape == "student" else 1.0
    covariance = level * law.single_sd**2 * np.eye(len(run))
    covariance += replay.reference @ replay.reference.T
    covariance += law.run_sd**2 * same
    if law.ar_sd:
        distance = np.abs(order[:, None] - order)
        covariance += same * law.ar_sd**2 * law.rho**distance
    return np.asarray(covariance)


class LawModel:
    """Readings of a case under one law."""

    def __init__(self, replay: Replay, law: Law) -> None:
        self.law = law
        self._design = np.hstack([replay.slopes, replay.reference])
        covariance = noise_covariance(replay, law) + replay.slopes @ replay.slopes.T
        self._root = linalg.cholesky(covariance, lower=True)
        self._log_det = 2.0 * float(np.log(np.diag(self._root)).sum())

    def whiten(self, columns: Array) -> Array:
        """Columns (n, k), free of geometry and correlation."""
        return np.asarray(linalg.solve_triangular(self._root, columns, lower=True))

    def scores(self, data: Array) -> tuple[Array, Array]:
        """Log density (R,) of data (n, R) without a change, and their whitened scores.

        The inner products of the scores with a whitened change are its slopes.
        """
        if self.law.shape == "white":
            white = self.whiten(data)
            return self._log_density(white), white
        log_density, pseudo = self._robust(data)
        return log_density, self.whiten(pseudo)

    def along(self, data: Array, change: Array, sizes: Array) -> Array:
        """Log density (S, R) of data (n, R) with a change (n,) of these sizes.

        A size is the norm of the whitened change.
        """
        white_change = self.whiten(change[:, None])[:, 0]
        norm = float(np.linalg.norm(white_change))
        if self.law.shape == "white":
            white = self.whiten(data)
            slope = (white_change / norm) @ white
            gain = sizes[:, None] * slope - 0.5 * sizes[:, None] ** 2
            return self._log_density(white) + self.log_ratio(white, gain)
        shifted = [data - (size / norm) * change[:, None] for size in sizes]
        return np.array([self._robust(part)[0] for part in shifted])

    def log_ratio(self, white: Array, gain: Array) -> Array:
        """Log density ratio (S, R) where half the energy falls by `gain` (S, R)."""
        if not self.law.level_is_free:
            return gain
        half_energy = RATE + 0.5 * np.einsum("nr,nr->r", white, white)
        power = 0.5 * len(white) + SHAPE
        return np.asarray(-power * np.log1p(-gain / half_energy))

    def _log_density(self, white: Array) -> Array:
        energy = np.einsum("nr,nr->r", white, white)
        size = len(white)
        if self.law.level_is_free:
            half = 0.5 * size + SHAPE
            constant = special.gammaln(half) - special.gammaln(SHAPE)
            constant += SHAPE * np.log(RATE) - 0.5 * size * np.log(2.0 * np.pi)
            kernel = -half * np.log(RATE + 0.5 * energy)
            return np.asarray(kernel + constant - 0.5 * self._log_det)
        constant = size * np.log(2.0 * np.pi)
        return np.asarray(-0.5 * (energy + self._log_det + constant))

    def _robust(self, data: Array) -> tuple[Array, Array]:
        """Laplace's log density (R,) and pseudo-data (n, R) about the mode of theta."""
        design, values = self._design, data.T
        count = design.shape[1]
        upper = np.triu_indices(count)
        products = design[:, upper[0]] * design[:, upper[1]]
        theta = np.linalg.solve(design.T @ design + np.eye(count), design.T @ data).T
        single = _student if self.law.shape == "student" else _outlying
        for _ in range(ITERATIONS):
            residual = values - theta @ design.T
            weight = single(residual).weight
            inner = _symmetric(weight @ products, upper, count)
            right = (weight * values) @ design
            updated = np.linalg.solve(inner, right[..., None])[..., 0]
            moved = float(np.abs((updated - theta) @ design.T).max())
            theta = updated
            if moved < 1e-4:
                break
        residual = values - theta @ design.T
        at_mode = single(residual)
        log_density = at_mode.log_density.sum(axis=1) - 0.5 * (theta**2).sum(axis=1)
        exact = np.linalg.slogdet(
            _symmetric(at_mode.curvature @ products, upper, count)
        )
        # beyond a saddle the curvature of least squares stands in
        plain = np.linalg.slogdet(_symmetric(at_mode.weight @ products, upper, count))
        log_density -= 0.5 * np.where(exact[0] > 0.0, exact[1], plain[1])
        level = (DEGREES + 3.0) / (DEGREES + 1.0) if single is _student else 1.0
        pseudo = level * at_mode.weight * residual + theta @ design.T
        return log_density, pseudo.T


@dataclasses.dataclass(frozen=True)
class _Single:
    """Of single readings (R, n): log density, weight of least squares, curvature."""

    log_density: Array
    weight: Array
    curvature: Array


def _student(residual: Array) -> _Single:
    spread = DEGREES + residual**2
    constant = special.gammaln(0.5 * (DEGREES + 1.0)) - special.gammaln(0.5 * DEGREES)
    constant -= 0.5 * np.log(DEGREES * np.pi)
    power = 0.5 * (DEGREES + 1.0)
    return _Single(
        log_density=constant - power * np.log1p(residual**2 / DEGREES),
        weight=(DEGREES + 1.0) / spread,
        curvature=(DEGREES + 1.0) * (DEGREES - residual**2) / spread**2,
    )


def _outlying(residual: Array) -> _Single:
    """Standard normal, and rarely one more error, uniform on both sides."""
    inlier = (1.0 - OUTLYING) * np.exp(-0.5 * residual**2) / np.sqrt(2.0 * np.pi)
    size, (low, high) = np.abs(residual), FAR
    between = special.ndtr(size - low) - special.ndtr(size - high)
    outlier = 0.5 * OUTLYING * between / (high - low)
    total = inlier + outlier + TINY
    probability = inlier / total
    return _Single(
        log_density=np.log(total),
        weight=probability,
        curvature=probability * (1.0 - (1.0 - probability) * residual**2),
    )


def _symmetric(values: Array, upper: tuple[Any, Any], count: int) -> Array:
    """I plus symmetric matrices (R, count, count) of their upper triangles (R, m)."""
    full = np.zeros((len(values), count, count))
    full[:, upper[0], upper[1]] = values
    full[:, upper[1], upper[0]] = values
    return full + np.eye(count)


def draw_noise(replay: Replay, law: Law, count: int, rng: np.random.Generator) -> Array:
    """Noise (n, count) of a law, over sigma, with what the geometry makes of it."""
    size = len(replay.run)
    plain = dataclasses.replace(law, shape="white")
    extra = noise_covariance(replay, plain) - np.eye(size)
    values, axes = np.linalg.eigh(extra + replay.slopes @ replay.slopes.T)
    kept = values > 1e-9
    root = axes[:, kept] * np.sqrt(values[kept])
    shared = root @ rng.standard_normal((root.shape[1], count))
    single = rng.standard_normal((size, count))
    if law.shape == "student":
        single = rng.standard_t(DEGREES, (size, count))
    if law.shape == "outlier":
        hit = rng.random((size, count)) < OUTLYING
        sign = rng.choice([-1.0, 1.0], (size, count))
        single = single + hit * sign * rng.uniform(*FAR, (size, count))
    return np.asarray(shared + single)


def draw_law(rng: np.random.Generator) -> Law:
    """A law as the generator draws it for a case."""
    name = str(rng.choice(["white", "repeat", "ar1", "outlier", "student", "mix"]))
    has_run, has_ar = name in ("repeat", "mix"), name in ("ar1", "mix")
    return Law(
        shape=name if name in ("outlier", "student") else "white",
        run_sd=float(rng.uniform(*RUN_SD)) if has_run else 0.0,
        ar_sd=float(rng.uniform(*AR_SD)) if has_ar else 0.0,
        rho=float(rng.uniform(*RHO)) if has_ar else 0.0,
    )


def over_laws(by_law: Sequence[Array], grid: Sequence[Law]) -> Array:
    """Log densities integrated over laws, one entry a law."""
    log_priors = np.array([law.log_prior for law in grid])
    shape = (-1,) + (1,) * (np.ndim(by_law[0]))
    return np.asarray(
        special.logsumexp(np.array(by_law) + log_priors.reshape(shape), axis=0)
    )
