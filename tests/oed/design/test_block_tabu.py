"""Exchanges of blocks for D: gains by determinants, all subsets, starts of several kinds."""

import itertools

import numpy as np
import pytest

from oed.design import block_tabu, choose
from oed.design.block_exchange import exchange_blocks, log_gains


def _log_det(blocks: np.ndarray, plan: np.ndarray, base: np.ndarray) -> float:
    rows = blocks[plan].reshape(-1, blocks.shape[2])
    return float(np.linalg.slogdet(rows.T @ rows + base)[1])


@pytest.mark.parametrize("k", [2, 3, 6])
def test_gains_of_all_exchanges(k: int) -> None:
    rng = np.random.default_rng(k)
    blocks = rng.standard_normal((12, k, 7))
    base = np.diag([0.0, 0.0, 1.0, 0.0, 0.2, 0.0, 0.0])
    plan = np.array([3, 1, 4, 0, 5])
    rows = blocks[plan].reshape(-1, 7)
    gains = log_gains(blocks, plan, rows.T @ rows + base)
    before = _log_det(blocks, plan, base)
    for place, block in itertools.product(range(5), range(12)):
        if block not in plan:
            changed = plan.copy()
            changed[place] = block
            exact = _log_det(blocks, changed, base) - before
            assert gains[place, block] == pytest.approx(exact, abs=1e-9)


def test_no_exchange_helps_at_the_end_where_plans_without_a_block_are_singular() -> (
    None
):
    rng = np.random.default_rng(2)
    blocks = rng.standard_normal((25, 2, 8))
    ridge = 1e-10 * np.eye(8)
    plan = exchange_blocks(blocks, np.arange(4), ridge)
    value = _log_det(blocks, plan, ridge)
    assert value > _log_det(blocks, np.arange(4), ridge)
    for place, block in itertools.product(range(4), range(25)):
        if block not in plan:
            changed = plan.copy()
            changed[place] = block
            assert _log_det(blocks, changed, ridge) <= value + 1e-5


def test_best_of_all_subsets() -> None:
    rng = np.random.default_rng(3)
    blocks = rng.standard_normal((14, 2, 6))
    base = 1e-12 * np.eye(6)
    subsets = itertools.combinations(range(14), 5)
    best = max(_log_det(blocks, np.array(subset), base) for subset in subsets)
    starts = np.array([rng.permutation(14)[:5] for _ in range(16)])
    plan = block_tabu.search_plans(blocks, starts, base, 240, rng)
    assert len(set(plan.tolist())) == 5
    assert _log_det(blocks, plan, base) == pytest.approx(best, abs=1e-9)


def _exchange_in_turn(blocks: np.ndarray, plan: np.ndarray) -> np.ndarray:
    """Each block in turn replaced by the best one until none raises the determinant."""
    before = np.zeros_like(plan)
    identity = np.eye(blocks.shape[1])
    while not np.array_equal(plan, before):
        before = plan.copy()
        for place in range(len(plan)):
            others = np.delete(plan, place)
            rows = blocks[others].reshape(-1, blocks.shape[2])
            inverse = np.linalg.inv(rows.T @ rows)
            factors = np.linalg.det(identity + blocks @ inverse @ blocks.mT)
            factors[others] = 0.0
            if factors.max() > factors[plan[place]] * (1.0 + 1e-9):
                plan[place] = int(factors.argmax())
    return plan


def test_not_behind_exchanges_from_ten_random_starts() -> None:
    nothing = np.zeros((12, 12))
    for seed in range(4):
        rng = np.random.default_rng(seed)
        blocks = rng.standard_normal((150, 3, 12))
        starts = [rng.permutation(150)[:8] for _ in range(10)]
        peer = max(
            _log_det(blocks, _exchange_in_turn(blocks, start), nothing)
            for start in starts
        )
        plan = choose(blocks, 8, np.random.default_rng(1))
        assert _log_det(blocks, plan.indices, nothing) >= peer - 2e-3
