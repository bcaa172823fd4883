"""Roots of covariances, and what held-out readings add, against dense matrices."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from oed.base import Array
from oed.noise import Errors, LinearFactor

N, STARTS = 14, (0, 6)
CARRIED = np.repeat([0.6, 0.3, 0.9], (6, 4, 4))  # of each chain


@pytest.fixture
def errors(rng: np.random.Generator) -> Errors:
    """Two segments, the second of two chains, in an order that is not the readings'."""
    decay = rng.uniform(0.3, 0.9, N)
    decay[[0, 6, 10]] = 0.0
    return Errors(
        order=rng.permutation(N),
        starts=np.array(STARTS),
        decay=decay,
        single=rng.uniform(0.2, 1.0, N),
        correlated=CARRIED,
        shared=rng.standard_normal((N, 2)),
        scale=rng.uniform(0.5, 2.0, N),
    )


def ordered_covariance(errors: Errors) -> Array:
    """Covariance (N, N) in order, entry by entry."""
    carried = np.zeros((N, N))
    for j in range(N):
        carried[j, j] = CARRIED[j]
        b, step = j, 1.0
        while errors.decay[b]:
            step, b = step * errors.decay[b], b - 1
            carried[j, b] = carried[b, j] = step * CARRIED[j]
    same = np.zeros((N, N))
    same[:6, :6] = same[6:, 6:] = 1.0
    total = np.diag(errors.single) + carried + same * (errors.shared @ errors.shared.T)
    return np.asarray(total * np.outer(errors.scale, errors.scale))


def in_place(errors: Errors) -> Array:
    covariance = np.zeros((N, N))
    covariance[np.ix_(errors.order, errors.order)] = ordered_covariance(errors)
    return covariance


def test_a_linear_factor_is_that_of_its_covariance(
    errors: Errors, rng: np.random.Generator
) -> None:
    factor, dense = LinearFactor(errors), in_place(errors)
    values, inverse = rng.standard_normal((N, 3)), np.linalg.inv(dense)
    root = np.linalg.cholesky(ordered_covariance(errors))
    assert factor.log_det == pytest.approx(np.linalg.slogdet(dense)[1])
    assert_allclose(factor.correlate(values), root @ values, atol=1e-10)
    assert_allclose(factor.precision(values), inverse @ values, atol=1e-10)
    assert_allclose(factor.precision_diagonal(), np.diag(inverse), rtol=1e-9)
    white = factor.whiten(values)
    assert_allclose(white.T @ white, values.T @ inverse @ values, atol=1e-9)
    again = factor.whiten_back(factor.whiten(values))
    assert_allclose(again, inverse @ values, atol=1e-10)


def test_innovations_are_those_of_conditioning(
    errors: Errors, rng: np.random.Generator
) -> None:
    """In squares: their sum is the distance from what the other readings predict."""
    held, values = rng.permutation(N)[:5], rng.standard_normal((N, 2))
    dense = in_place(errors)
    factor = LinearFactor(errors)
    innovations = factor.hold_out(held)
    scored = factor.scored(errors.standardise(values))
    white = innovations.innovations(scored)
    others = np.setdiff1d(np.arange(N), held)
    gain = np.linalg.solve(dense[np.ix_(others, others)], dense[np.ix_(others, held)])
    error = values[held] - gain.T @ values[others]
    spread = dense[np.ix_(held, held)] - dense[np.ix_(held, others)] @ gain
    expected = error.T @ np.linalg.solve(spread, error)
    assert_allclose(white.T @ white, expected, rtol=1e-9)
