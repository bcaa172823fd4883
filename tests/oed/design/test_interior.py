"""Weights by the interior-point method, by Newton steps and by each solver."""

import itertools

import numpy as np
import pytest
from scipy import optimize

from oed.design import CRITERIA
from oed.design.condition import follow
from oed.design.design_problem import choose_by_weights
from oed.design.interior import InteriorPath, InteriorProblem, build_problem
from oed.design.relaxation import project_to_sum, scale_to_size

COUNT, SIZE, N = 8, 4, 3


def problem(seed: int = 0) -> tuple[np.ndarray, np.ndarray, InteriorProblem]:
    rng = np.random.default_rng(seed)
    rows, prior = rng.standard_normal((COUNT, N)), 0.1 * np.eye(N)
    return rows, prior, build_problem(rows, SIZE, prior, 1.0)


def spectrum(rows: np.ndarray, prior: np.ndarray, w: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.eigvalsh(prior + (rows.T * w) @ rows))


def test_a_problem_is_white_at_its_start():
    rows, prior, p = problem()
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
    rows, prior, p = problem(1)
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
    rows, prior, p = problem(seed)
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
