"""Tabu search for D: against all subsets, and against a plain exchange of many starts."""

import itertools

import numpy as np
import pytest

from oed.design import choose, tabu


def _log_det(rows: np.ndarray, plan: np.ndarray, prior: np.ndarray) -> float:
    return float(np.linalg.slogdet(rows[plan].T @ rows[plan] + prior)[1])


@pytest.mark.parametrize(("share", "copies"), [(0.0, 1), (0.5, 1), (0.0, 2)])
def test_best_of_all_subsets(share: float, copies: int) -> None:
    rng = np.random.default_rng(4)
    rows = np.repeat(rng.standard_normal((16 // copies, 4)), copies, axis=0)
    prior = share * np.diag([1.0, 0.0, 2.0, 0.0])
    subsets = np.array(list(itertools.combinations(range(16), 6)))
    best = max(_log_det(rows, subset, prior) for subset in subsets)
    starts = np.array([rng.permutation(16)[:6] for _ in range(5)])
    plan = tabu.search_plans(rows, starts, prior, 60, rng)
    assert len(set(plan.tolist())) == 6
    assert _log_det(rows, plan, prior) == pytest.approx(best, abs=1e-9)


def _exchange(white: np.ndarray, plan: np.ndarray) -> np.ndarray:
    """Each row in turn replaced by the best one until none raises the determinant."""
    before = np.zeros_like(plan)
    while not np.array_equal(plan, before):
        before = plan.copy()
        for place in range(len(plan)):
            others = np.delete(plan, place)
            m = white[others].T @ white[others]
            gains = np.einsum("ci,ij,cj->c", white, np.linalg.inv(m), white)
            gains[others] = -np.inf
            if gains.max() > gains[plan[place]] * (1 + 1e-9):
                plan[place] = int(gains.argmax())
    return plan


def test_not_behind_an_exchange_of_many_starts_on_ill_conditioned_rows() -> None:
    rng = np.random.default_rng(5)
    white = rng.standard_normal((300, 12))
    starts = [rng.permutation(300)[:18] for _ in range(15)]
    nothing = np.zeros((12, 12))
    peer = max(_log_det(white, _exchange(white, start), nothing) for start in starts)
    rows = white * np.logspace(0.0, -5.5, 12)
    choice = choose(rows, 18, np.random.default_rng(1))
    assert choice.directions == 12
    assert _log_det(white, choice.indices, nothing) >= peer - 2e-3


def test_products_stay_exact_over_many_steps() -> None:
    """The plan that the search values highest is the best of those it passed."""
    rng = np.random.default_rng(6)
    rows = rng.standard_normal((80, 6))
    starts = np.array([rng.permutation(80)[:9] for _ in range(4)])
    nothing = np.zeros((6, 6))
    short, long = (
        tabu.search_plans(rows, starts, nothing, steps, np.random.default_rng(1))
        for steps in (30, 300)
    )
    before = max(_log_det(rows, plan, nothing) for plan in starts)
    assert _log_det(rows, long, nothing) >= _log_det(rows, short, nothing) - 1e-5
    assert _log_det(rows, short, nothing) > before


def test_copies_of_a_row_and_singular_starts() -> None:
    rows = np.repeat(np.eye(5), 4, axis=0)
    starts = np.array([np.arange(10), np.arange(10, 20)])
    rng = np.random.default_rng(7)
    plan = tabu.search_plans(rows, starts, np.zeros((5, 5)), 60, rng)
    # two of each: det = 2^5
    assert _log_det(rows, plan, np.zeros((5, 5))) == pytest.approx(5 * np.log(2.0))
