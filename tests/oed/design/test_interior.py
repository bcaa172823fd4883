"""The interior-point method for eigenvalues: its linear system, path and bounds."""

import itertools

import numpy as np
import pytest

from oed.design.condition import follow
from oed.design.interior import InteriorPath, InteriorProblem, build_problem

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
