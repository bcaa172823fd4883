"""Condition number, E and O4: bounds against every plan, values against a conic solver."""

import itertools

import numpy as np
import pytest

from oed.design import condition, conic
from oed.design.forms import ExtremeEigenvalues

KAPPA = ExtremeEigenvalues(0.5, 0.5, name="kappa")
E = ExtremeEigenvalues()
#: O4 = l_min / sqrt(l_max)
O4 = ExtremeEigenvalues(1.0, 0.5, name="O4")
CRITERIA = (KAPPA, E, O4)
TOLERANCES = (1e-4, 1e-4, 1e-3)


def criteria_of(rows, base, weights):
    """1 / kappa, l_min and l_min / sqrt(l_max) from singular values, without forming M."""
    flat = (np.sqrt(weights)[:, None, None] * rows).reshape(-1, rows.shape[2])
    s = np.linalg.svd(np.vstack([flat, np.sqrt(base)]), compute_uv=False)[
        : rows.shape[2]
    ]
    return float(s[-1] / s[0]), float(s[-1] ** 2), float(s[-1] ** 2 / s[0])


def problem(seed: int) -> tuple[np.ndarray, int, np.ndarray]:
    """Random blocks (C, k, n) of columns of unlike scales, a size, a prior in every second."""
    rng = np.random.default_rng(seed)
    k, count = int(rng.integers(1, 4)), int(rng.integers(7, 12))
    n = int(rng.integers(1, min(3 * k, 6) + 1))
    size = int(rng.integers(-(-n // k), 6))
    rows = rng.standard_normal((count, k, n)) @ np.diag(10.0 ** rng.uniform(-2, 2, n))
    return (
        rows,
        size,
        np.diag(10.0 ** rng.uniform(-3, 1, n)) if seed % 2 else np.zeros((n, n)),
    )


@pytest.mark.parametrize("seed", range(6))
def test_no_plan_exceeds_the_bounds_and_the_weights_reach_them(seed):
    rows, size, base = problem(seed)
    plans = []
    for chosen in itertools.combinations(range(len(rows)), size):
        weights = np.zeros(len(rows))
        weights[list(chosen)] = 1.0
        plans.append(criteria_of(rows, base, weights))
    best = np.max(plans, axis=0)
    optimum = [condition.relax(c, rows, size, base) for c in CRITERIA]
    for k, (f, tolerance) in enumerate(zip(optimum, TOLERANCES, strict=True)):
        assert np.exp(f.bound) >= best[k]
        assert f.weights.sum() == pytest.approx(size, rel=1e-9)
        assert f.weights.min() >= 0.0
        assert f.weights.max() <= 1.0 + 1e-12
        reached = criteria_of(rows, base, f.weights)[k]
        assert np.exp(f.value) == pytest.approx(reached, rel=1e-7)
        assert f.duality_gap <= tolerance * 1.01


@pytest.mark.parametrize("cap", [0.3, 1.0, np.inf])
def test_agrees_with_a_conic_solver(cap):
    """Same kappa and E as Clarabel finds for the semidefinite programs."""
    rng = np.random.default_rng(4)
    rows = rng.standard_normal((60, 2, 5)) @ np.diag([0.03, 0.5, 1.0, 4.0, 20.0])
    prior = np.diag(rng.uniform(0.01, 0.1, 5))
    for criterion in (KAPPA, E):
        optimum = condition.relax(criterion, rows, 9.0, prior, cap, 1e-6)
        other = conic.relax(rows, 9.0, criterion, prior, cap)
        assert optimum.value == pytest.approx(other.value, abs=3e-6)
        assert optimum.bound >= other.value - 1e-9
        assert optimum.value <= other.bound + 1e-9


def test_o4_is_the_best_along_the_frontier():
    """The largest O4 over levels of l_max, by a conic solver, is near the value."""
    rng = np.random.default_rng(8)
    rows = rng.standard_normal((25, 1, 3)) * np.array([0.3, 1.0, 5.0])
    optimum = condition.relax(O4, rows, 6.0, tolerance=1e-4)
    best = 0.0
    for level in np.geomspace(5.0, 400.0, 40):
        best = max(best, _at_most(rows, 6.0, float(level)))
    assert best <= np.exp(optimum.bound)
    assert np.exp(optimum.value) == pytest.approx(best, rel=5e-3)
    assert np.exp(optimum.value) >= best * (1 - 2e-4)


def _at_most(rows: np.ndarray, size: float, largest: float) -> float:
    """O4 where l_min is largest with l_max at most at a level, by an independent program."""
    import cvxpy as cp

    w, t = cp.Variable(len(rows), nonneg=True), cp.Variable()
    m = sum(w[i] * (b.T @ b) for i, b in enumerate(rows))
    problem = cp.Problem(
        cp.Maximize(t),
        [m >> t * np.eye(3), m << largest * np.eye(3), cp.sum(w) == size, w <= 1],
    )
    problem.solve(solver=cp.CLARABEL)
    return (
        criteria_of(rows, np.zeros((3, 3)), np.clip(w.value, 0, 1))[2]
        if w.value is not None
        else 0.0
    )


def test_the_gap_closes_over_many_candidates():
    """Problem A, 2000 x 21: no candidate outside the plan has a larger slope than inside."""
    rows = np.random.default_rng(0).standard_normal((2000, 21))
    optimum = condition.relax(E, rows, 30.0)
    assert optimum.duality_gap < 1e-4
    inside = (optimum.weights > 0.01) & (optimum.weights < 0.99)
    assert (
        optimum.gradient[optimum.weights < 1e-6].max()
        <= optimum.gradient[inside].min() * 1.05
    )
    assert condition.relax(KAPPA, rows, 30.0).value == pytest.approx(0.0, abs=1e-4)


def test_widely_spread_singular_values():
    """Columns that spread over five decades, as lengths and angles do."""
    rng = np.random.default_rng(2)
    rows = rng.standard_normal((800, 1, 12)) @ np.diag(np.geomspace(1e-4, 10.0, 12))
    for criterion, tolerance in zip(CRITERIA, TOLERANCES, strict=True):
        optimum = condition.relax(criterion, rows, 20.0, tolerance=tolerance)
        assert optimum.duality_gap <= tolerance * 1.01
    assert condition.relax(KAPPA, rows, 20.0).value < -np.log(1e3)


def test_slopes_are_derivatives():
    """Where both ends of the spectrum are single, they equal differences of -log kappa."""
    rows = (
        np.diag([1.0, 2.0, 5.0])[:, None, :]
        @ np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    )
    base, weights = np.zeros((3, 3)), np.ones(3)
    optimum = condition.relax(KAPPA, rows, 3.0)
    for i, step in enumerate(1e-6 * np.eye(3)):
        low = criteria_of(rows, base, weights - step)[0]
        high = criteria_of(rows, base, weights + step)[0]
        assert optimum.gradient[i] == pytest.approx(
            (np.log(high) - np.log(low)) / 2e-6, abs=1e-6
        )


def test_impossible_problems_are_refused():
    with pytest.raises(ValueError, match="undetermined"):
        condition.relax(KAPPA, np.ones((5, 3)), 3.0)
    with pytest.raises(ValueError, match="cannot carry"):
        condition.relax(KAPPA, np.eye(3), 4.0)
