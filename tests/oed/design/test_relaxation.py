"""Relaxed designs: equivalence theorem, bounds, conic and Newton steps, general solvers."""

import itertools

import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import linprog

from oed.design import Criterion, choose, conic, relaxation
from oed.design.blocks import information
from oed.design.conic import Polytope
from oed.design.forms import (
    Compound,
    Determinant,
    ExtremeEigenvalues,
    LargestVariance,
    PowerMean,
    Variance,
)
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


def criteria(n: int, rng: np.random.Generator) -> list[Criterion]:
    """All that have a conic form, for n columns."""
    interest, factors = rng.standard_normal((n, 2)), rng.standard_normal((4, 2, n))
    return [
        Determinant(n), Determinant(n, interest, "Ds"), Variance(np.eye(n), "A"),
        Variance(factors[0, :1], "c"), Variance(factors[0], "I"),
        LargestVariance(factors), ExtremeEigenvalues(),
        ExtremeEigenvalues(0.5, name="O3"), ExtremeEigenvalues(0.5, 0.5, name="kappa"),
        PowerMean(0.5, n, "O5"), PowerMean(1.0, n), PowerMean(2.0, n),
        PowerMean(8.0, n),
        Compound(
            (Determinant(n), Variance(np.eye(n)), ExtremeEigenvalues()), (0.2, 0.3, 0.5)
        ),
        Compound((PowerMean(0.5, n), LargestVariance(factors)), (0.6, 0.4)),
    ]  # fmt: skip


@pytest.mark.parametrize("seed", range(15))
def test_no_plan_exceeds_the_bound(seed):
    """Random sizes, ranks, blocks, priors and limits: all plans lie below a tight bound."""
    rng = np.random.default_rng(seed)
    k = int(rng.integers(1, 4))
    count = int(rng.integers(7, 10))
    n = int(rng.integers(2, 5))
    size = int(rng.integers(-(-n // k), 6))
    rows = rng.standard_normal((count, k, n)) @ np.diag(10.0 ** rng.uniform(-1, 1, n))
    base = np.diag(10.0 ** rng.uniform(-2, 1, n)) if seed % 2 else np.zeros((n, n))
    costs = rng.uniform(0.5, 2.0, (1, count))
    limits = (costs, np.array([1.1 * size * costs.mean()])) if seed % 3 == 0 else None
    subsets = [list(c) for c in itertools.combinations(range(count), size)]
    if limits is not None:
        subsets = [c for c in subsets if costs[0, c].sum() <= limits[1][0]]
    every = criteria(n, rng)
    for criterion in (every[seed % len(every)], every[(seed + 7) % len(every)]):
        optimum = conic.relax(rows, size, criterion, base, 1.0, limits)
        matrices = [base + information(rows[c]) for c in subsets]
        values = np.array([criterion.value(matrix) for matrix in matrices])
        assert values.max() <= optimum.bound
        ahead = [optimum.gradient[c].sum() for c in subsets]
        ahead -= optimum.gradient @ optimum.weights
        assert max(ahead) < 1e-3  # no plan gains along the gradient at the optimum
        if criterion.concave:
            assert (values - optimum.value <= ahead + 1e-3).all()
        assert optimum.value == pytest.approx(
            criterion.value(base + information(rows, optimum.weights))
        )
        assert optimum.weights.sum() == pytest.approx(size, rel=1e-7)
        assert optimum.weights.min() >= 0.0
        assert optimum.weights.max() <= 1.0
        assert limits is None or costs[0] @ optimum.weights <= limits[1][0] + 1e-6
        assert optimum.duality_gap < 1e-4


@pytest.mark.parametrize("which", [0, 2, 4, 5, 10, 11])
@pytest.mark.parametrize("cap", [0.4, np.inf])
def test_agrees_with_newton_steps(which, cap):
    """D, A, I, G, phi_1 and phi_2 against the relaxation without a conic solver."""
    rng = np.random.default_rng(3)
    rows = rng.standard_normal((40, 2, 4)) * np.array([0.2, 1.0, 2.0, 9.0])
    prior = np.diag(rng.uniform(0.1, 1.0, 4))
    criterion = criteria(4, rng)[which]
    optimum = conic.relax(rows, 8.0, criterion, prior, cap)
    newton = relaxation.relax(rows, 8.0, prior, cap, 1e-8, criterion)
    if criterion.smooth:
        assert optimum.value == pytest.approx(newton.value, abs=2e-5)
    assert optimum.value <= newton.bound + 1e-9
    assert newton.value <= optimum.bound + 1e-9


@pytest.mark.parametrize("which", range(15))
def test_two_solvers_agree(which):
    rng = np.random.default_rng(5)
    rows = rng.standard_normal((20, 1, 3))
    group = (np.arange(20) < 10).astype(float)[None]
    criterion = criteria(3, rng)[which]
    limits = (group, np.array([1.5]))
    optimum = [
        conic.relax(rows, 5.0, criterion, limits=limits, solver=s)
        for s in ("CLARABEL", "SCS")
    ]
    assert optimum[0].value == pytest.approx(optimum[1].value, abs=1e-3)
    assert optimum[0].bound >= optimum[1].value - 1e-9
    assert optimum[1].bound >= optimum[0].value - 1e-9
    assert max(float(group[0] @ f.weights) for f in optimum) <= 1.5 + 1e-6


def test_the_bound_under_limits_holds_at_random_weights():
    """No feasible weights exceed the bound of their gain, and one plan attains it."""
    rng = np.random.default_rng(6)
    rows, most = rng.uniform(0.0, 1.0, (3, 30)), np.array([2.0, 2.5, 3.0])
    feasible = Polytope(6.0, np.full(30, 1.0), rows, most)
    gains = rng.standard_normal(30)
    bound, weights = feasible.maximise(gains)
    assert gains @ weights == pytest.approx(bound, abs=1e-8)
    for _ in range(200):
        near = feasible.nearest(rng.dirichlet(np.ones(30)) * 6.0)
        assert near.sum() == pytest.approx(6.0)
        assert (rows @ near <= most + 1e-6).all()
        assert gains @ near <= bound + 1e-6


def test_impossible_problems_are_refused():
    rows = np.random.default_rng(0).standard_normal((8, 3))
    with pytest.raises(ValueError, match="no weights keep"):
        conic.relax(
            rows, 4.0, Determinant(3), limits=(np.ones((1, 8)), np.array([3.0]))
        )
    with pytest.raises(ValueError, match="no conic form"):
        conic.relax(rows, 4.0, PowerMean(3.0, 3))
    with pytest.raises(ValueError, match="no conic form"):
        conic.relax(rows, 4.0, ExtremeEigenvalues(1.0, 0.5, name="O4"))
    with pytest.raises(ValueError, match="undetermined"):
        conic.relax(np.ones((5, 3)), 3.0, Determinant(3))
