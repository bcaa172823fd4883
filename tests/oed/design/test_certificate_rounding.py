"""The bound in exact arithmetic: it holds however ill-conditioned the candidates are."""

import math
from fractions import Fraction

import numpy as np
import pytest

from oed.design import choose, condition, relaxation
from oed.design.blocks import whiten
from oed.design.forms import Determinant, ExtremeEigenvalues
from oed.design.objective import CriterionObjective

DIRECTIONS, SIZE, COUNT = 8, 14, 200


Matrix = list[list[Fraction]]


def _exact_information(rows: np.ndarray, weights: np.ndarray) -> Matrix:
    """sum w x x^T of the numbers as they are stored, by fractions."""
    exact = [[Fraction(float(x)) for x in row] for row in rows]
    w = [Fraction(float(x)) for x in weights]
    n = rows.shape[1]
    return [
        [
            sum((c * x[i] * x[j] for c, x in zip(w, exact, strict=True)), Fraction(0))
            for j in range(n)
        ]
        for i in range(n)
    ]


def _pivots(matrix: Matrix) -> list[Fraction]:
    """Pivots of Gauss' elimination, up to the first that is not positive."""
    m, pivots = [list(row) for row in matrix], []
    for k in range(len(m)):
        pivots.append(m[k][k])
        if m[k][k] <= 0:
            break
        for i in range(k + 1, len(m)):
            factor = m[i][k] / m[k][k]
            m[i] = [a - factor * b for a, b in zip(m[i], m[k], strict=True)]
    return pivots


def _exceeds(matrix: Matrix, least: float) -> bool:
    """Whether all eigenvalues exceed a number."""
    shifted = [list(row) for row in matrix]
    for k in range(len(shifted)):
        shifted[k][k] -= Fraction(least)
    return _pivots(shifted)[-1] > 0


def _exact_log_det(rows: np.ndarray, weights: np.ndarray) -> float:
    """log det(sum w x x^T) of the numbers as they are stored, by fractions."""
    determinant = math.prod(_pivots(_exact_information(rows, weights)))
    return math.log(determinant.numerator) - math.log(determinant.denominator)


def _candidates(kappa: float, mixed: bool) -> np.ndarray:
    rng = np.random.default_rng(3)
    rows = rng.standard_normal((COUNT, DIRECTIONS))
    rows = rows * np.logspace(0.0, -np.log10(kappa), DIRECTIONS)
    if mixed:
        rows = rows @ np.linalg.qr(rng.standard_normal((DIRECTIONS, DIRECTIONS)))[0]
    return rows


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("kappa", [1e2, 1e5, 1e7, 1e9])
def test_bound_lies_above_the_exact_optimum_and_near_it(kappa, mixed):
    rows = _candidates(kappa, mixed)
    optimum = relaxation.relax(rows, float(SIZE))
    used = optimum.weights > 0
    # the stored weights add up to the size but for rounding
    weights = optimum.weights[used] * (1.0 - 1e-15)
    exact = _exact_log_det(rows[used], weights) / DIRECTIONS
    allowed = 1e-8 + 1e-13 * kappa
    assert 0.0 <= optimum.bound - exact < 2.0 * allowed
    assert optimum.duality_gap >= 0.0
    assert optimum.value == pytest.approx(exact, abs=allowed)


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("kappa", [1e5, 1e7, 1e9])
def test_value_of_a_plan_is_exact(kappa, mixed):
    rows = _candidates(kappa, mixed)
    rng = np.random.default_rng(1)
    choice = choose(rows, SIZE, rng, tolerance=1e-12)
    assert choice.directions == DIRECTIONS
    exact = _exact_log_det(rows[choice.indices], np.ones(SIZE))
    assert choice.value == pytest.approx(exact, abs=1e-14 * kappa + 1e-10)
    assert choice.bound is not None
    assert choice.bound >= exact


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("kappa", [1e2, 1e6])
def test_bounds_of_eigenvalues_hold_exactly(kappa, mixed):
    rows = _candidates(kappa, mixed)
    best = condition.relax(ExtremeEigenvalues(), rows, SIZE)
    used = best.weights > 0
    exact = _exact_information(rows[used], best.weights[used] * (1.0 - 1e-15))
    least = float(np.exp(best.value))
    assert not _exceeds(exact, float(np.exp(best.bound)))
    assert _exceeds(exact, least * (1.0 - 1e-10))
    assert not _exceeds(exact, least * (1.0 + 1e-10))
    narrow = condition.relax(ExtremeEigenvalues(0.5, 0.5), rows, SIZE)
    used = narrow.weights > 0
    exact = _exact_information(rows[used], narrow.weights[used])
    negative = [[-entry for entry in row] for row in exact]
    squared = Fraction(float(np.exp(-narrow.bound))) ** 2
    least = float(
        np.linalg.svd(rows[used] * np.sqrt(narrow.weights[used, None]))[1][-1]
    )
    # l_min <= least (1 + 1e-9), so that l_max >= bound^2 l_min is not contradicted
    assert not _exceeds(exact, least**2 * (1.0 + 1e-9))
    largest = float(squared) * least**2 * (1.0 - 1e-9)
    assert not _exceeds(negative, -largest)


def test_directions_below_the_tolerance_are_counted():
    rows = _candidates(1e7, True)
    rng = np.random.default_rng(1)
    choice = choose(rows, SIZE, rng)
    values = np.linalg.svd(rows, compute_uv=False)
    assert choice.weak == int(np.sum(values <= 1e-6 * values[0])) == 2
    unseen = np.column_stack([rows[:, :3], rows[:, 0] + rows[:, 1]])
    assert choose(unseen, SIZE, rng).weak == 0


def test_white_candidates_are_within_their_stated_rounding():
    rows = _candidates(1e8, True)
    prior = np.diag(np.linspace(0.0, 1e-9, DIRECTIONS))
    white = whiten(rows[:, None], prior, 0.0)
    exact = rows.astype(np.longdouble) @ white.basis.astype(np.longdouble)
    error = np.linalg.norm(np.asarray(exact - white.blocks[:, 0], dtype=float), axis=1)
    assert 0.0 < error.max() <= white.rounding.rows
    information = white.blocks[:, 0].T @ white.blocks[:, 0] + white.prior
    np.testing.assert_allclose(information, np.eye(DIRECTIONS), atol=1e-6)


def test_the_rounding_of_slopes_is_that_of_the_largest():
    """A candidate with a tiny slope beside it, of no weight, makes it no less."""
    large, tiny = np.diag([3.0, 4.0])[None], np.full((1, 2, 2), 1e-6)
    objectives = [
        CriterionObjective(Determinant(2), blocks, np.eye(2))
        for blocks in (large, np.concatenate([large, tiny]))
    ]
    first, second = (o.tangent(np.array([0]), np.ones(1)) for o in objectives)
    assert second.gradient[0] == pytest.approx(first.gradient[0])
    assert second.gradient[1] < 1e-9 * second.gradient[0]
    assert 0.0 < first.rounding <= second.rounding
