"""Tabu search and exchange of pairs: all subsets, singular starts, exchanges of many starts."""

import itertools

import numpy as np
import pytest

from oed.design import Criterion, Rules, choose, tabu
from oed.design.bounds import bound
from oed.design.forms import Determinant, ExtremeEigenvalues, Variance

N = 4
CRITERIA: dict[str, Criterion] = {
    "D": Determinant(N),
    "A": Variance(np.eye(N), "A"),
    "E": ExtremeEigenvalues(),
    "kappa": ExtremeEigenvalues(0.5, 0.5, name="kappa"),
}


def _value(
    criterion: Criterion, blocks: np.ndarray, plan: np.ndarray, base: np.ndarray
) -> float:
    rows = blocks[plan].reshape(-1, blocks.shape[2])
    return criterion.value(rows.T @ rows + base)


def _log_det(blocks: np.ndarray, plan: np.ndarray) -> float:
    rows = blocks[plan].reshape(-1, blocks.shape[-1])
    return float(np.linalg.slogdet(rows.T @ rows)[1])


@pytest.mark.parametrize(
    ("share", "copies", "k"), [(0.0, 1, 1), (0.5, 1, 1), (0.0, 2, 1), (0.0, 1, 2)]
)
@pytest.mark.parametrize("name", CRITERIA)
def test_best_of_all_subsets(name: str, share: float, copies: int, k: int) -> None:
    criterion, rng = CRITERIA[name], np.random.default_rng(4)
    blocks = np.repeat(rng.standard_normal((14 // copies, k, N)), copies, axis=0)
    base = share * np.diag([1.0, 0.0, 2.0, 0.0]) + 1e-12 * np.eye(N)
    subsets = itertools.combinations(range(14), 5)
    best = max(_value(criterion, blocks, np.array(s), base) for s in subsets)
    starts = np.array([rng.permutation(14)[:5] for _ in range(8)])
    plan = tabu.search_plans(blocks, starts, base, criterion, 800, rng)
    assert len(set(plan.tolist())) == 5
    assert _value(criterion, blocks, plan, base) == pytest.approx(best, abs=1e-9)


@pytest.mark.parametrize("name", ["D", "A"])
def test_no_exchange_helps_at_the_end(name: str) -> None:
    """Also where plans without a candidate are nearly singular."""
    criterion, rng = CRITERIA[name], np.random.default_rng(2)
    blocks = rng.standard_normal((25, 1, N))
    blocks *= 10.0 ** rng.uniform(0.0, 3.0, (25, 1, 1))
    base = np.diag(rng.uniform(1e-3, 1.0, N))
    start = np.arange(N)
    plan = tabu.exchange_pairs(blocks, start, base, criterion, 100)
    value = _value(criterion, blocks, plan, base)
    assert value > _value(criterion, blocks, start, base)
    for place, block in itertools.product(range(N), range(25)):
        if block not in plan:
            changed = plan.copy()
            changed[place] = block
            assert _value(criterion, blocks, changed, base) <= value + 1e-8


def test_copies_of_a_row_and_singular_starts() -> None:
    rows = np.repeat(np.eye(N), 4, axis=0)[:, None]
    starts = np.array([np.arange(8), np.arange(8, 16)])
    base, rng = 1e-12 * np.eye(N), np.random.default_rng(7)
    plan = tabu.search_plans(rows, starts, base, CRITERIA["D"], 120, rng)
    assert _log_det(rows, plan) == pytest.approx(N * np.log(2.0))  # two of each


def test_candidates_that_are_all_equal_but_one() -> None:
    rows = np.vstack([np.tile([1.0, 0.0], (5, 1)), [[0.0, 1.0]]])[:, None]
    starts = np.array([[0, 1, 2], [0, 1, 5]])
    base, rng = 1e-12 * np.eye(2), np.random.default_rng(1)
    plan = tabu.search_plans(rows, starts, base, ExtremeEigenvalues(), 24, rng)
    assert 5 in plan
    assert len(set(plan.tolist())) == 3


def _exchange_in_turn(
    criterion: Criterion, blocks: np.ndarray, plan: np.ndarray
) -> np.ndarray:
    """Each block in turn replaced by the best one until none raises the criterion."""
    before = np.zeros_like(plan)
    ridge = 1e-9 * np.eye(blocks.shape[2])
    while not np.array_equal(plan, before):
        before = plan.copy()
        for place in range(len(plan)):
            others = np.delete(plan, place)
            rows = blocks[others].reshape(-1, blocks.shape[2])
            values = criterion.values_after_adding(rows.T @ rows + ridge, blocks)
            values[others] = -np.inf
            if values.max() > values[plan[place]] + 1e-9:
                plan[place] = int(values.argmax())
    return plan


@pytest.mark.parametrize(
    ("name", "k", "size", "scale"),
    [("D", 1, 18, 5.5), ("D", 3, 8, 0.0), ("A", 1, 16, 0.0), ("A", 1, 13, 0.0)],
)
def test_not_behind_exchanges_from_many_starts(
    name: str, k: int, size: int, scale: float
) -> None:
    """On ill-conditioned rows, blocks, and near saturation: 16 or 13 rows of 12 columns."""
    rng = np.random.default_rng(5)
    white = rng.standard_normal((150, k, 12))
    goal: Criterion = Determinant(12) if name == "D" else Variance(np.eye(12), "A")
    starts = [rng.permutation(150)[:size] for _ in range(12)]
    nothing = np.zeros((12, 12))
    peers = [_exchange_in_turn(goal, white, start) for start in starts]
    peer = max(_value(goal, white, plan, nothing) for plan in peers)
    rows = white * np.logspace(0.0, -scale, 12)
    choice = choose(rows, size, np.random.default_rng(1), name)
    assert choice.directions == 12
    assert _value(goal, white, choice.indices, nothing) >= peer - 1e-9


def test_the_search_leaves_what_the_weights_favour() -> None:
    """Saturated plans of a quadratic model need rows to which the optimum gives no weight."""
    levels = np.linspace(-1.0, 1.0, 4)
    x = np.array(list(itertools.product(levels, repeat=3)))
    products = [x[:, i] * x[:, j] for i in range(3) for j in range(i, 3)]
    rows = np.column_stack([np.ones(len(x)), x, *products])
    choice = choose(rows, 10, np.random.default_rng(1))
    plans = [np.random.default_rng(s).permutation(64)[:10] for s in range(40)]
    goal, blocks = Determinant(10), rows[:, None]
    peers = [_exchange_in_turn(goal, blocks, plan) for plan in plans]
    assert choice.value >= max(_log_det(rows, plan) for plan in peers) - 1e-9


def test_relaxation_of_equal_candidates_that_all_lie_in_a_subspace() -> None:
    """The full quadratic model on a grid: many candidates have the same first weights."""
    levels = np.linspace(-1.0, 1.0, 4)
    x = np.array(list(itertools.product(levels, repeat=5)))
    products = [x[:, i] * x[:, j] for i in range(5) for j in range(i, 5)]
    rows = np.column_stack([np.ones(len(x)), x, *products])
    criterion, nothing = Determinant(21), np.zeros((21, 21))
    for size in (21, 25, 29):
        relaxed = bound(rows[:, None], criterion, Rules(size=size), nothing)
        assert relaxed.duality_gap < 1e-7
