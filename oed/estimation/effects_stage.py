"""Parameters, effects and noise law together: the effects' draws.

Residuals about nominal parameters are r = H z + G b + e, with z ~ N(0, I), the effects'
coefficients b of an uncertain common size and e of a noise law. In turn, size and
coefficients are drawn under a law (`oed.estimation.discrepancy`), and the most probable
law is found with the effects at the sizes drawn. A large error can pass for noise or for an
effect: both the stated law and that of a fit without effects are starts, weighed by evidence.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy import special

from oed.base import Array, Index
from oed.estimation.coordinates import IdentifiableCoordinates
from oed.estimation.discrepancy import (
    Discrepancy,
    EffectDraws,
    SampledEffects,
    sample_effects,
)
from oed.linear_algebra import precision_root
from oed.noise import Laws, ReadingStructure
from oed.noise_law import NoisePrior, ResidualModel, robust_residuals

#: rounds of effects and law; draws in each, and at the end
ROUNDS, PARTICLES, DRAWS = 3, 150, 400
#: singular values of the effects' columns, in units of the noise, below which they are
#: left out of the covariance
FAINT = 0.1


@dataclasses.dataclass(frozen=True, eq=False)
class ReadingsAbout:
    """Standardised readings to first order about some parameters.

    coordinates  identifiable ones, z (r,)
    residual     (N,) about nominal parameters, z = 0
    slopes       (N, r) over z
    """

    coordinates: IdentifiableCoordinates
    residual: Array
    slopes: Array


@dataclasses.dataclass(frozen=True, eq=False)
class EffectsStart:
    """Where effects are sought from: parameters (n,) and the law's coordinates (d,).

    mode  None: the stated law
    """

    theta: Array
    mode: Array | None


@dataclasses.dataclass(frozen=True, eq=False)
class FittedEffects:
    """Effects, and where the fit of the parameters goes on.

    sampled    the draws
    structure  of the readings, with the effects at the sizes drawn
    theta      (n,) mean parameters
    covariance (n, n) of the parameters, without directions that no reading determines
    mode       (d,) coordinates of the most probable law
    """

    sampled: SampledEffects
    structure: ReadingStructure
    theta: Array
    covariance: Array
    mode: Array


Linearise = Callable[[Array], ReadingsAbout]


def fit_effects(
    linearise: Linearise,
    structure: ReadingStructure,
    prior: NoisePrior,
    stated: Laws,
    discrepancy: Discrepancy,
    starts: list[EffectsStart],
    rng: np.random.Generator,
) -> FittedEffects:
    """Draw effects with the parameters, from all starts.

    linearise  readings about some parameters (n,)
    stated     the stated law, one of some laws
    """
    columns = structure.standardise(discrepancy.columns)
    alternation = _Alternation(linearise, structure, prior, discrepancy, columns, rng)
    fits = [alternation.run(start, stated) for start in starts]
    weights = special.softmax([fit.log_evidence for fit in fits])
    number = rng.choice(len(fits), size=DRAWS, p=weights)
    best = fits[int(np.argmax(weights))]
    parts = [fit.taken(np.flatnonzero(number == k)) for k, fit in enumerate(fits)]
    means = np.vstack([p[3] for p in parts])
    theta = means.mean(axis=0)
    offsets = means - theta
    within = sum(w * fit.within() for w, fit in zip(weights, fits, strict=True))
    sampled = SampledEffects(
        discrepancy=discrepancy,
        coefficients=np.vstack([p[0] for p in parts]),
        size=np.concatenate([p[1] for p in parts]),
        theta=np.vstack([p[2] for p in parts]),
        log_evidence=best.log_evidence - alternation.log_evidence_without(best),
    )
    widened = alternation.widened(sampled.size)
    return FittedEffects(
        sampled=sampled,
        structure=dataclasses.replace(structure, effects=widened),
        theta=theta,
        covariance=np.asarray(within + offsets.T @ offsets / len(offsets)),
        mode=best.mode,
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Settled:
    """Draws of effects under a most probable law, and their evidence.

    clean       (N,) residuals about nominal, with those far off replaced
    z, means    (m, r) of the coordinates, drawn given each draw of the effects, and means
    root        (r, r) of the covariance of z given the effects
    """

    linear: ReadingsAbout
    clean: Array
    draws: EffectDraws
    z: Array
    means: Array
    root: Array
    mode: Array
    log_evidence: float

    def taken(self, rows: Index) -> tuple[Array, Array, Array, Array]:
        """Coefficients, sizes, parameters and mean parameters of some draws."""
        draws, to_theta = self.draws, self.linear.coordinates.to_theta
        return (
            draws.coefficients[rows],
            draws.size[rows],
            to_theta(self.z[rows]),
            to_theta(self.means[rows]),
        )

    def within(self) -> Array:
        """Covariance (n, n) of the parameters given the effects, SI."""
        spread = self.linear.coordinates.basis @ self.root
        return np.asarray(spread @ spread.T)


@dataclasses.dataclass(frozen=True, eq=False)
class _Alternation:
    """Effects and law in turn."""

    linearise: Linearise
    structure: ReadingStructure
    prior: NoisePrior
    discrepancy: Discrepancy
    columns: Array
    rng: np.random.Generator

    def run(self, start: EffectsStart, stated: Laws) -> _Settled:
        """From one start."""
        theta, law = start.theta, stated
        mode = np.zeros(len(self.prior.names))
        if start.mode is not None:
            mode, law = start.mode, self.prior.laws(start.mode[None])
        linear = self.linearise(theta)
        gram = self._gram(law, linear, linear.residual)
        draws = self._draw(gram, PARTICLES)
        for _ in range(ROUNDS):
            linear = self.linearise(theta)
            clean = self._clean(law, linear, draws)
            draws = self._draw(self._gram(law, linear, clean), PARTICLES)
            slopes = np.hstack([linear.slopes, self.widened(draws.size)])
            mode = self._most_probable_law(slopes, clean, mode)
            law = self.prior.laws(mode[None])
            gram = self._gram(law, linear, clean)
            means, _ = self._coordinates(gram, draws)
            theta = linear.coordinates.to_theta(means.mean(axis=0))
        draws = self._draw(gram, DRAWS)
        means, root = self._coordinates(gram, draws)
        z = means + self.rng.standard_normal(means.shape) @ root.T
        evidence = self._log_evidence(linear, clean, mode) + draws.log_evidence
        return _Settled(linear, clean, draws, z, means, root, mode, evidence)

    def log_evidence_without(self, fit: _Settled) -> float:
        """Log evidence without effects, under its own most probable law."""
        mode = self._most_probable_law(fit.linear.slopes, fit.clean, fit.mode)
        return self._log_evidence(fit.linear, fit.clean, mode)

    def widened(self, size: Array) -> Array:
        """Principal columns (N, k) that count, at the root mean square of sizes (m,)."""
        scaled = np.sqrt((size**2).mean()) * self.columns
        squares, axes = np.linalg.eigh(scaled.T @ scaled)
        return np.asarray(scaled @ axes[:, squares > FAINT**2])

    def _clean(self, law: Laws, linear: ReadingsAbout, draws: EffectDraws) -> Array:
        """Residuals (N,) about nominal, with those far off replaced."""
        structure = dataclasses.replace(
            self.structure, effects=self.widened(draws.size)
        )
        return robust_residuals(structure, law, linear.residual, linear.slopes)

    def _gram(self, law: Laws, linear: ReadingsAbout, clean: Array) -> Array:
        """Products, under a law, of the r slopes, clean residuals and effects' columns."""
        values = np.column_stack([linear.slopes, clean, self.columns])
        return np.asarray(law.whitening(self.structure).gram(values)[0])

    def _draw(self, gram: Array, count: int) -> EffectDraws:
        """Draws of the effects, with the parameters integrated out."""
        r = len(gram) - 1 - self.columns.shape[1]
        precision = gram[:r, :r] + np.eye(r)
        reduced = gram[r:, r:] - gram[r:, :r] @ np.linalg.solve(precision, gram[:r, r:])
        return sample_effects(
            0.5 * (reduced[1:, 1:] + reduced[1:, 1:].T),
            reduced[1:, 0],
            self.discrepancy.sizes,
            self.rng,
            count,
        )

    def _most_probable_law(self, slopes: Array, clean: Array, near: Array) -> Array:
        """Coordinates (d,) of the most probable law, unknowns of slopes integrated out."""
        return self._model(slopes, clean, near).most_probable(self.prior, near)

    def _log_evidence(self, linear: ReadingsAbout, clean: Array, mode: Array) -> float:
        """Log evidence without effects under a law at coordinates (d,), with their prior."""
        model = self._model(linear.slopes, clean, mode)
        solved = model.solve(self.prior.laws(mode[None]))
        return float(solved.log_marginal[0]) - 0.5 * float(mode @ mode)

    def _model(self, slopes: Array, clean: Array, mode: Array) -> ResidualModel:
        """Clean residuals as a linear model about its solution under a law."""
        middle = np.zeros(slopes.shape[1])
        model = ResidualModel(self.structure, clean, slopes, middle)
        centre = model.solve(self.prior.laws(mode[None])).mean[0]
        residual = clean - slopes @ centre
        return ResidualModel(self.structure, residual, slopes, centre)

    def _coordinates(self, gram: Array, draws: EffectDraws) -> tuple[Array, Array]:
        """Means (m, r) of z given each draw of the effects, and root (r, r) of its
        covariance.
        """
        r = len(gram) - 1 - self.columns.shape[1]
        root = precision_root(gram[:r, :r] + np.eye(r))
        score = gram[:r, r, None] - gram[:r, r + 1 :] @ draws.coefficients.T
        return np.asarray((score.T @ root) @ root.T), root
