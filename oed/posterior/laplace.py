"""Draws of the parameters from the approximation about an estimate, without sampling.

Under each noise law the identifiable coordinates are normal; laws are drawn by their
weight, so that the draws have the tails that few readings leave. Directions that no
reading determines are drawn from their prior and followed exactly: the readings stay as
they were, however far a lost direction leads.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base import Array
from oed.estimation import Estimate
from oed.linear_algebra import covariance_root
from oed.measurement import Measurement, Series
from oed.posterior.log_density import LogDensity, OutOfBoundsError

#: draws of the parameters: their covariance is known to 2 %; rounds of them at most
DRAWS, MOST_ROUNDS = 2000, 30


@dataclasses.dataclass(frozen=True)
class ApproximateDraws:
    """Draws of parameters (m, n), SI, and coordinates (m, d) of the law.

    worth    number of independent draws that they are worth; None: all
    effects  (m, k) coefficients of effects that belong to them; k is 0 without effects
    """

    theta: Array
    noise_law: Array
    worth: float | None = None
    effects: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))


def draw_approximation(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    estimate: Estimate,
    rng: np.random.Generator,
    count: int = DRAWS,
) -> ApproximateDraws:
    """Draws from the approximation, `count` of them or few less.

    y  (N,) the readings, SI

    Draws that cannot be assembled, or are out of bounds, are left out; in place of the
    latter others are drawn. Raises AssemblyError at the estimate, OutOfBoundsError where
    hardly any draw keeps to the bounds.
    """
    if estimate.effects is not None:
        count = len(estimate.effects.theta)
    parts: list[Array] = []
    laws: list[Array] = []
    effects: list[Array] = []
    missing = count
    for _ in range(MOST_ROUNDS):
        points = _draw_points(estimate, rng, count)
        z, law = points.z, points.law
        theta = draw_lost_directions(measurement, series, y, estimate, z, rng)
        assembled = np.isfinite(theta).all(axis=1)
        inside = assembled & measurement.in_bounds(theta)
        parts.append(theta[inside][:missing])
        laws.append(law[inside][:missing])
        effects.append(points.effects[inside][:missing])
        missing -= int(inside.sum())
        if missing <= 0 or (inside == assembled).all():
            return ApproximateDraws(
                np.concatenate(parts),
                np.concatenate(laws),
                effects=np.concatenate(effects),
            )
    raise OutOfBoundsError(measurement, theta[assembled])


def draw_coordinates(estimate: Estimate, rng: np.random.Generator, count: int) -> Array:
    """Draws (count, r) of the identifiable coordinates."""
    return _draw_points(estimate, rng, count).z


@dataclasses.dataclass(frozen=True, eq=False)
class _Points:
    """Draws of identifiable coordinates (m, r), of the law's (m, d), of effects (m, k)."""

    z: Array
    law: Array
    effects: Array


def _draw_points(estimate: Estimate, rng: np.random.Generator, count: int) -> _Points:
    """`count` draws; with effects, those that were drawn with them, in a drawn order."""
    posterior, none = estimate.noise_posterior, np.zeros((count, 0))
    if estimate.effects is not None and posterior is not None:
        sampled = estimate.effects
        number = rng.permutation(np.arange(count) % len(sampled.theta))
        coordinates = estimate.coordinates
        z = (sampled.theta[number] - coordinates.origin) @ coordinates.dual.T
        _, law = posterior.draw(rng, count)
        return _Points(z, law, sampled.coefficients[number])
    if posterior is not None:
        return _Points(*posterior.draw(rng, count), none)
    dual = estimate.coordinates.dual
    root = covariance_root(dual @ estimate.covariance @ dual.T)
    normal = rng.standard_normal((count, len(estimate.z)))
    return _Points(estimate.z + normal @ root.T, none, none)


def draw_lost_directions(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    estimate: Estimate,
    z: Array,
    rng: np.random.Generator,
) -> Array:
    """Parameters (m, n), SI, at coordinates (m, r), with lost directions drawn.

    y  (N,) the readings, SI. Raises AssemblyError at the estimate.
    """
    target = LogDensity(measurement, series, y, estimate)
    null = estimate.coordinates.null_basis
    change = rng.standard_normal((len(z), null.shape[1])) @ null.T
    return target.move_along_null(estimate.coordinates.to_theta(z), change)
