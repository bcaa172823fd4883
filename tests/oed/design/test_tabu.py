"""Tabu search and exchange of pairs: all subsets, singular starts, exchanges of many starts."""

import itertools

import numpy as np
import pytest

from oed.design import Criterion, Rules, tabu
from oed.design.bounds import bound
from oed.design.forms import Determinant, ExtremeEigenvalues, Variance
from oed.design.objective import CriterionObjective

N = 4
CRITERIA: dict[str, Criterion] = {
    "D": Determinant(N), "A": Variance(np.eye(N), "A"), "E": ExtremeEigenvalues(),
    "kappa": ExtremeEigenvalues(0.5, 0.5, name="kappa"),
}  # fmt: skip


def _value(criterion, blocks, plan, base):
    rows = blocks[plan].reshape(-1, blocks.shape[2])
    return criterion.value(rows.T @ rows + base)


def _log_det(blocks: np.ndarray, plan: np.ndarray) -> float:
    rows = blocks[plan].reshape(-1, blocks.shape[-1])
    return float(np.linalg.slogdet(rows.T @ rows)[1])


@pytest.mark.parametrize(("share", "copies", "k", "near"), [
    (0.0, 1, 1, 500), (0.5, 1, 1, 500), (0.0, 2, 1, 500), (0.0, 1, 2, 500), (0.0, 1, 1, 6),
])  # fmt: skip
@pytest.mark.parametrize("name", CRITERIA)
def test_best_of_all_subsets(name, share, copies, k, near, monkeypatch):
    """Also where only six of the free candidates, near a plan, are looked at."""
    monkeypatch.setattr(tabu, "NEAR_ROWS", near)
    monkeypatch.setattr(tabu, "NEAR_PER_PLACE", 1)
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
def test_no_exchange_helps_at_the_end(name):
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


def test_copies_of_a_row_and_singular_starts():
    rows = np.repeat(np.eye(N), 4, axis=0)[:, None]
    starts = np.array([np.arange(8), np.arange(8, 16)])
    base, rng = 1e-12 * np.eye(N), np.random.default_rng(7)
    plan = tabu.search_plans(rows, starts, base, CRITERIA["D"], 120, rng)
    assert _log_det(rows, plan) == pytest.approx(N * np.log(2.0))  # two of each


def test_relaxation_of_equal_candidates_that_all_lie_in_a_subspace():
    """The full quadratic model on a grid: many candidates have the same first weights."""
    levels = np.linspace(-1.0, 1.0, 4)
    x = np.array(list(itertools.product(levels, repeat=5)))
    products = [x[:, i] * x[:, j] for i in range(5) for j in range(i, 5)]
    rows = np.column_stack([np.ones(len(x)), x, *products])
    nothing = np.zeros((21, 21))
    objective = CriterionObjective(Determinant(21), rows[:, None], nothing)
    for size in (21, 25, 29):
        relaxed = bound(objective, Rules(size=size))
        assert relaxed.duality_gap < 1e-7
