"""Tabu search for E: its traces by eigenvalues, and all subsets; copies among candidates."""

import itertools
from unittest import mock

import numpy as np
import pytest

from oed.design import Rules, choose, eigenvalue_tabu
from oed.design.bounds import bound
from oed.design.copies import find_copies
from oed.design.eigenvalue_tabu import _EigenvalueSearch
from oed.design.forms import Determinant


def _least(rows: np.ndarray, plan: np.ndarray, prior: np.ndarray) -> float:
    return float(np.linalg.eigvalsh(rows[plan].T @ rows[plan] + prior)[0])


@pytest.mark.parametrize("power", [1, 2, 4])
def test_traces_of_all_exchanges(power: int) -> None:
    rng = np.random.default_rng(8)
    rows = rng.standard_normal((20, 5))
    prior = np.diag([0.5, 0.0, 0.0, 1.0, 0.0])
    starts = np.array([np.arange(8), np.arange(7, 15)])
    search = _EigenvalueSearch(rows, prior, find_copies(rows), starts, rng)
    traces = search._traces_after_exchange(power)
    for k, place, row in itertools.product(range(2), range(8), range(20)):
        plan = starts[k].copy()
        least = _least(rows, plan, prior)
        plan[place] = row
        m = rows[plan].T @ rows[plan] + prior
        exact = np.sum((np.linalg.eigvalsh(m) / least) ** -power)
        if exact < 1e3:
            assert traces[k, place, row] == pytest.approx(exact, rel=2e-3)


@pytest.mark.parametrize(("share", "copies"), [(0.0, 1), (0.5, 1), (0.0, 2)])
def test_best_of_all_subsets(share: float, copies: int) -> None:
    rng = np.random.default_rng(4)
    rows = np.repeat(rng.standard_normal((16 // copies, 4)), copies, axis=0)
    prior = share * np.diag([1.0, 0.0, 2.0, 0.0])
    subsets = itertools.combinations(range(16), 6)
    best = max(_least(rows, np.array(subset), prior) for subset in subsets)
    starts = np.array([rng.permutation(16)[:6] for _ in range(8)])
    plan = eigenvalue_tabu.search_plans(rows, starts, prior, 60, rng)
    assert len(set(plan.tolist())) == 6
    assert _least(rows, plan, prior) == pytest.approx(best, rel=1e-6)


def test_candidates_that_are_all_equal_but_one() -> None:
    rows = np.vstack([np.tile([1.0, 0.0], (5, 1)), [[0.0, 1.0]]])
    starts = np.array([[0, 1, 2], [0, 1, 5]])
    rng = np.random.default_rng(1)
    plan = eigenvalue_tabu.search_plans(rows, starts, np.zeros((2, 2)), 12, rng)
    assert 5 in plan
    assert len(set(plan.tolist())) == 3


def test_ahead_of_exchanges_from_many_starts() -> None:
    """Exchange sweeps along the continuation, with restarts, as a peer."""
    ours, peer = [], []
    for seed in range(3):
        rows = np.random.default_rng(seed).standard_normal((100, 5))
        plan = choose(rows, 7, np.random.default_rng(1), "E", certify=False)
        ours.append(np.log(plan.value))
        with mock.patch.object(eigenvalue_tabu, "search_plans", return_value=None):
            rng = np.random.default_rng(1)
            plan = choose(rows, 7, rng, "E", certify=False, rounds=2)
        peer.append(np.log(plan.value))
    assert np.mean(ours) > np.mean(peer) + 0.01


def test_copies_share_the_weight_and_keep_the_bound() -> None:
    rng = np.random.default_rng(9)
    rows = rng.standard_normal((60, 1, 5))
    several = rows[rng.permutation(np.repeat(np.arange(60), 3))]
    copies = find_copies(several)
    assert copies.exist
    assert np.array_equal(several[copies.first][copies.label], several)
    assert copies.number.sum() == 180
    nothing = np.zeros((5, 5))
    goal = Determinant(5)
    merged = bound(several, goal, Rules(size=12), nothing)
    # the same weights, without the copies: three of each as one of three times the weight
    apart = bound(rows * np.sqrt(3.0), goal, Rules(size=4), nothing)
    assert merged.bound == pytest.approx(apart.bound, abs=1e-8)
    assert merged.weights.sum() == pytest.approx(12.0)
    assert merged.weights.max() <= 1.0 + 1e-9
    choice = choose(several, 12, rng)
    assert len(set(choice.indices.tolist())) == 12


def test_kinds_and_different_candidates() -> None:
    rows = np.array([[1.0], [2.0], [1.0], [3.0], [2.0], [1.0]])
    copies = find_copies(rows)
    assert copies.first.tolist() == [0, 1, 3]
    assert copies.label.tolist() == [0, 1, 0, 2, 1, 0]
    kinds = np.array([0, 2, 0, 1, 0])
    chosen = copies.different(kinds)
    assert sorted(chosen.tolist()) == [0, 2, 3, 4, 5]
    assert copies.label[chosen].tolist() == kinds.tolist()


def test_copies_take_turns() -> None:
    """Of eight kinds read to and fro, half are in each direction; none stands twice."""
    rows = np.tile(np.eye(8), (2, 1))
    copies = find_copies(rows)
    chosen = copies.different(np.arange(8))
    assert sorted(copies.label[chosen]) == [*range(8)]
    assert np.count_nonzero(chosen < 8) == 4
    both = copies.different(np.repeat(np.arange(4), 2))
    assert len(set(both)) == 8
