"""The relaxed D design: equivalence theorem, bounds, and a general convex solver."""

import itertools

import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import linprog

from oed.design import choose, relaxation
from oed.design.blocks import information
from oed.design.forms import Determinant
from oed.design.forms.eigenvalues import trace_after_adding
from oed.design.objective import CriterionObjective, knapsack_value


def candidates(seed, shape):
    rng = np.random.default_rng(seed)
    return rng.standard_normal(shape), rng


@pytest.mark.parametrize("cap", [0.3, 1.0, np.inf])
@pytest.mark.parametrize("shape", [(60, 1, 4), (40, 3, 6)])
def test_agrees_with_a_general_solver(shape, cap):
    """Same optimum as Clarabel's, with and without prior information."""
    blocks, rng = candidates(3, shape)
    n, size = shape[2], 9.0
    for prior in (np.zeros((n, n)), np.diag(rng.uniform(0.5, 2.0, n))):
        relaxed = relaxation.relax(blocks, size, prior, cap)
        w = cp.Variable(len(blocks), nonneg=True)
        m = prior + sum(w[i] * (b.T @ b) for i, b in enumerate(blocks))
        limits = [cp.sum(w) == size] + ([w <= cap] if np.isfinite(cap) else [])
        problem = cp.Problem(cp.Maximize(cp.log_det(m)), limits)
        problem.solve(solver=cp.CLARABEL)
        assert relaxed.value * n == pytest.approx(problem.value, abs=1e-5)
        assert relaxed.bound * n >= problem.value - 1e-6
        assert relaxed.duality_gap < 1e-6


def test_the_equivalence_theorem_holds():
    """Without repeats forbidden, tr(M^-1 A_i) = n / N on the support and no more elsewhere."""
    blocks, _ = candidates(0, (500, 1, 8))
    relaxed = relaxation.relax(blocks, 1.0, cap=np.inf)
    inverse = np.linalg.inv(information(blocks, relaxed.weights))
    slopes = np.einsum("ckn,nm,ckm->c", blocks, inverse, blocks)
    assert slopes.max() <= 8.0 + 1e-6
    assert slopes[relaxed.weights > 1e-6] == pytest.approx(8.0, abs=1e-5)


def test_the_bound_holds_for_every_plan_and_from_any_dual_point():
    """All 495 subsets lie below the bound, even one drawn at weights that are no optimum."""
    blocks, rng = candidates(7, (12, 1, 3))
    best = max(
        float(np.linalg.slogdet(information(blocks[list(s)]))[1])
        for s in itertools.combinations(range(12), 4)
    )
    objective = CriterionObjective(Determinant(3), blocks, np.zeros((3, 3)))
    for _ in range(20):
        tangent = objective.tangent(np.arange(12), rng.exponential(size=12))
        assert 3 * tangent.bound(knapsack_value(tangent.gradient, 4, 1.0)) >= best
    assert 3 * relaxation.relax(blocks, 4).bound >= best


def test_the_knapsack_value_is_a_linear_programs():
    """Equal and unequal caps against a linear program."""
    rng = np.random.default_rng(2)
    for size in (1.0, 3.7, 9.0):
        slopes, caps = rng.exponential(size=30), rng.uniform(0.1, 2.0, 30)
        for cap in (caps, 1.0, np.inf):
            limits = [(0.0, c) for c in np.broadcast_to(cap, 30)]
            exact = -linprog(
                -slopes, A_eq=np.ones((1, 30)), b_eq=[size], bounds=limits
            ).fun
            assert knapsack_value(slopes, size, cap) == pytest.approx(exact, rel=1e-9)


def test_eliminated_candidates_are_in_no_best_plan():
    """Of 14 candidates some are ruled out; every best subset does without them."""
    out = 0
    for seed in range(20):
        blocks, _ = candidates(seed, (14, 1, 3))
        values = {
            s: float(np.linalg.slogdet(information(blocks[list(s)]))[1]) / 3
            for s in itertools.combinations(range(14), 5)
        }
        best = max(values, key=lambda s: values[s])
        optimum = relaxation.relax(blocks, 5)
        active = np.flatnonzero(optimum.weights)
        tangent = CriterionObjective(Determinant(3), blocks, np.zeros((3, 3))).tangent(
            active, optimum.weights[active]
        )
        excluded = relaxation.eliminate(tangent, values[best], 5, np.ones(14))
        assert not set(excluded) & set(best)
        out += len(excluded)
    assert out > 20


def test_a_plan_can_be_proven_optimal():
    """Orthogonal candidates of two lengths: the relaxation is tight."""
    rows = np.vstack([3.0 * np.eye(4), np.eye(4)])
    choice = choose(rows, 4, np.random.default_rng(0))
    assert set(choice.indices) == {0, 1, 2, 3}
    assert choice.proven
    assert choice.efficiency == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("p", [1, 2, 3, 8, 16])
def test_the_power_series_is_exact(p):
    """tr (M + x x^T)^-p from the series equals the one from eigenvalues."""
    rows, rng = candidates(5, (30, 6))
    a = rng.standard_normal((20, 6))
    m = a.T @ a
    values, vectors = np.linalg.eigh(m)
    exact = [np.sum(np.linalg.eigvalsh(m + np.outer(x, x)) ** -float(p)) for x in rows]
    assert trace_after_adding(values, vectors, rows, p) * values[0] ** -float(
        p
    ) == pytest.approx(exact, rel=1e-8)
