"""Condition number, E and O4, and weights by the interior-point method: bounds and paths."""

import itertools

import numpy as np
import pytest
from scipy import optimize

from oed.design import CRITERIA, condition, conic
from oed.design.condition import follow
from oed.design.design_problem import choose_by_weights
from oed.design.forms import ExtremeEigenvalues
from oed.design.interior import InteriorPath, InteriorProblem, build_problem
from oed.design.relaxation import project_to_sum, scale_to_size

KAPPA = ExtremeEigenvalues(0.5, 0.5, name="kappa")
E = ExtremeEigenvalues()
#: O4 = l_min / sqrt(l_max)
O4 = ExtremeEigenvalues(1.0, 0.5, name="O4")
RELAXED = (KAPPA, E, O4)
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
    optimum = [condition.relax(c, rows, size, base) for c in RELAXED]
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
    for criterion, tolerance in zip(RELAXED, TOLERANCES, strict=True):
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


COUNT, SIZE, N = 8, 4, 3


def path_problem(seed: int = 0) -> tuple[np.ndarray, np.ndarray, InteriorProblem]:
    rng = np.random.default_rng(seed)
    rows, prior = rng.standard_normal((COUNT, N)), 0.1 * np.eye(N)
    return rows, prior, build_problem(rows, SIZE, prior, 1.0)


def spectrum(rows: np.ndarray, prior: np.ndarray, w: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.eigvalsh(prior + (rows.T * w) @ rows))


def test_a_problem_is_white_at_its_start():
    rows, prior, p = path_problem()
    m = prior + (rows.T * p.start) @ rows
    assert p.start.sum() == pytest.approx(SIZE)
    assert p.turn @ m @ p.turn.T == pytest.approx(np.eye(N), abs=1e-9)
    w = np.random.default_rng(1).uniform(0.1, 0.9, COUNT)
    least, largest = p.extreme_eigenvalues(np.arange(COUNT), w)
    values = spectrum(rows, prior, w)
    assert (least, largest) == pytest.approx((values[0], values[-1]))
    part = p.subset(np.array([2, 5]))
    assert part.blocks[:, 0] == pytest.approx(rows[[2, 5]])


def test_directions_that_nothing_determines_are_refused():
    rows = np.random.default_rng(0).standard_normal((COUNT, N))
    rows[:, 2] = rows[:, 0] - 2.0 * rows[:, 1]
    with pytest.raises(ValueError, match="leave directions undetermined"):
        build_problem(rows, SIZE, None, 1.0)
    with pytest.raises(ValueError, match="cannot carry a weight of 4"):
        build_problem(rows, SIZE, np.eye(N), 0.1)


def test_a_path_stays_feasible_and_raises_the_least_eigenvalue():
    rows, prior, p = path_problem(1)
    path = InteriorPath(p, 0.0, p.start, 0.5)
    first = spectrum(rows, prior, path.iterate.w)[0]
    for _ in range(30):
        if not path.step():
            break
        w = path.iterate.w
        assert w.sum() == pytest.approx(SIZE)
        assert ((w > 0.0) & (w < 1.0)).all()
        assert path.iterate.t <= spectrum(rows, prior, w)[0] * (1.0 + 1e-9)
    assert spectrum(rows, prior, path.iterate.w)[0] > first


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("slope", [0.0, 0.05, None])
def test_no_plan_exceeds_the_bound_of_the_path(seed, slope):
    """F(z) = max l_min - z l_max, and kappa where there is no slope."""
    rows, prior, p = path_problem(seed)
    point = follow(p, slope, 1e-6)
    assert point.plan.weights.sum() == pytest.approx(SIZE)
    values = spectrum(rows, prior, point.plan.weights)
    assert (point.plan.least, point.plan.largest) == pytest.approx(
        (values[0], values[-1])
    )
    assert 0.0 <= point.duality_gap <= 1.01e-6
    for plan in itertools.combinations(range(COUNT), SIZE):
        w = np.isin(np.arange(COUNT), plan).astype(float)
        low, *_, high = spectrum(rows, prior, w)
        if slope is None:
            assert low / high <= values[0] / values[-1] * (1.0 + 1e-5)
        else:
            assert low - slope * high <= point.dual.bound + 1e-9
    # nor do random weights
    rng = np.random.default_rng(seed)
    for w in SIZE * rng.dirichlet(np.ones(COUNT), 50):
        if slope is not None and w.max() <= 1.0:
            low, *_, high = spectrum(rows, prior, w)
            assert low - slope * high <= point.dual.bound + 1e-9


def test_weights_scaled_to_a_size_keep_their_ratios_within_caps():
    scaled = scale_to_size(np.array([1.0, 2.0, 9.0]), 6.0, np.full(3, 3.0))
    assert scaled == pytest.approx([1.0, 2.0, 3.0])
    assert scale_to_size(np.ones(4), 2.0, np.full(4, 3.0)) == pytest.approx([0.5] * 4)


def test_weights_beyond_the_size_at_their_caps_are_scaled_down():
    for weights in (np.array([1.2, 1.2, 0.03]), np.ones(3)):
        scaled = scale_to_size(weights, 1.5, np.ones(3))
        assert scaled.sum() == pytest.approx(1.5)
        assert ((scaled > 0.0) & (scaled <= 1.0)).all()


@pytest.mark.parametrize("seed", range(6))
def test_the_projection_is_the_root_that_brentq_finds(seed):
    """Caps that are equal or not, and sums from almost nothing to almost all of them."""
    rng = np.random.default_rng(seed)
    caps = np.full(9, 0.7) if seed % 2 else rng.uniform(0.1, 2.0, 9)
    wanted = np.round(rng.standard_normal(9), 1)  # some are equal
    for share in (1e-6, 0.2, 0.5, 0.8, 1.0 - 1e-6):
        total = share * float(caps.sum())

        def excess(shift: float, total: float = total) -> float:
            return float(np.clip(wanted - shift, 0.0, caps).sum()) - total

        root = optimize.brentq(excess, -4.0, 4.0, xtol=1e-14)
        projected = project_to_sum(wanted, total, caps)
        assert projected == pytest.approx(np.clip(wanted - root, 0.0, caps), abs=1e-12)
        assert projected.sum() == pytest.approx(total, rel=1e-14)


def test_a_projection_onto_the_sum_of_the_caps_is_the_caps():
    caps = np.array([0.3, 1.0, 2.0])
    assert project_to_sum(np.array([5.0, -1.0, 0.0]), 3.3, caps) == pytest.approx(caps)
    assert project_to_sum(np.array([5.0, -1.0, 0.0]), 0.0, caps) == pytest.approx(
        np.zeros(3)
    )


@pytest.mark.parametrize("criterion", CRITERIA.weighed)
def test_solvers_agree(criterion, rng):
    rows = rng.standard_normal((40, 2, 4)) @ np.diag([0.1, 1.0, 3.0, 10.0])
    prior = np.diag([1.0, 0.1, 0.1, 1.0])
    built_in = choose_by_weights(rows, 6, criterion, prior)
    conic = choose_by_weights(rows, 6, criterion, prior, "clarabel")
    assert built_in.value == pytest.approx(conic.value, rel=3e-4)
    assert built_in.bound == pytest.approx(conic.bound, rel=3e-4)
    assert built_in.weights.sum() == pytest.approx(6.0)
    heaviest = np.argsort(-built_in.weights)[:6]
    assert set(built_in.choice.indices) == set(heaviest)
    efficiency = built_in.choice.efficiency
    assert efficiency is not None
    assert 0.0 < efficiency <= 1.0


def test_too_few_readings_are_refused():
    """Too few readings are refused; three take the two that nothing replaces."""
    rows = np.vstack([np.eye(3)[[0, 1]], np.tile(np.eye(3)[2], (6, 1))])
    rows[:2] *= 1e-3
    with pytest.raises(ValueError, match="3 directions"):
        choose_by_weights(rows[:, [2, 0, 1]], 2)
    plan = choose_by_weights(rows, 3).choice
    assert {0, 1} < set(plan.indices)
