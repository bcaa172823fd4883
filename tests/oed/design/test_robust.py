"""Robust designs and the number of readings against every subset of small problems."""

import itertools

import numpy as np
import pytest

from oed.design import Rules, SizeCurve, robust
from oed.design.forms import Determinant, ExtremeEigenvalues, Variance
from oed.design.how_many import AccuracyGoal
from oed.design.rules import TimeBudget


def scenarios(seed, count, size, n, spread=0.7):
    rng = np.random.default_rng(seed)
    middle = rng.standard_normal((1, count, 1, n))
    return middle + spread * rng.standard_normal((size, count, 1, n)), rng


def values(table: np.ndarray, chosen: tuple[int, ...]) -> np.ndarray:
    rows = table[:, list(chosen), 0]
    return np.linalg.slogdet(np.swapaxes(rows, 1, 2) @ rows)[1] / table.shape[3]


def risk_of(v: np.ndarray, risk: str) -> float:
    if risk == "mean":
        return float(v.mean())
    return float(
        v.min() if risk == "worst" else np.sort(v)[:2].mean()
    )  # cvar at level 2 of 5


@pytest.mark.parametrize("risk", ["mean", "cvar", "worst"])
def test_no_subset_exceeds_the_bound(risk):
    """All subsets of 5 of 12 in five scenarios: value below bound, design among the best."""
    table, rng = scenarios(0, 12, 5, 3)
    choice = robust.choose(
        table, Determinant(3), Rules(size=5), rng, risk=risk, tail_share=0.4
    )
    every = np.array(
        [risk_of(values(table, s), risk) for s in itertools.combinations(range(12), 5)]
    )
    assert choice.summary.value == pytest.approx(
        risk_of(values(table, tuple(choice.indices)), risk), abs=1e-9
    )
    assert every.max() <= choice.summary.bound + 1e-9
    assert choice.summary.value >= np.quantile(every, 0.99)
    assert choice.summary.value >= choice.summary.nominal


def test_one_scenario_is_the_plain_problem(rng):
    table, _ = scenarios(3, 40, 1, 4)
    prior = np.eye(4)
    choices = [
        robust.choose(
            table, Variance(np.eye(4)), Rules(size=8), rng, risk=r, prior=prior
        )
        for r in ("mean", "cvar", "worst")
    ]
    assert [k.summary.value for k in choices] == pytest.approx(
        [choices[0].summary.value] * 3, abs=1e-3
    )
    assert [k.summary.bound for k in choices] == pytest.approx(
        [choices[0].summary.bound] * 3, abs=1e-3
    )


def test_budget_and_refusals(rng):
    table, _ = scenarios(1, 30, 4, 3)
    cost = rng.uniform(1.0, 3.0, 30)
    choice = robust.choose(
        table, Determinant(3), Rules(time=TimeBudget(cost, 15.0)), rng
    )
    assert cost[choice.indices].sum() <= 15.0
    assert choice.summary.value <= choice.summary.bound
    with pytest.raises(ValueError, match="needs a smooth criterion"):
        robust.choose(table, ExtremeEigenvalues(), Rules(size=5), rng)
    with pytest.raises(ValueError, match="share of worst"):
        robust.choose(
            table, Determinant(3), Rules(size=5), rng, risk="cvar", tail_share=0.0
        )


def test_equal_readings_follow_the_square_root_law():
    """N readings leave 1 / sqrt(1 + N / 2) of each of two unit directions."""
    rows = np.tile(np.eye(2), (20, 1))[:, None, :]
    goal = AccuracyGoal(("a", "b"), np.eye(2)[:, None, :] / 0.43)
    problem = SizeCurve(rows, np.eye(2), goal, (0,))
    for point in problem.curve([2, 6, 12]):
        exact = 1.0 / np.sqrt(1.0 + point.size / 2) / 0.43
        assert point.accuracy == pytest.approx([exact, exact], rel=1e-9)
        # alone, a direction gets all readings
        assert point.bound == pytest.approx(
            np.full(2, 1.0 / np.sqrt(1.0 + point.size) / 0.43), rel=1e-3
        )
    fewest = problem.fewest(most=20)
    assert (
        fewest.size == 2 * int(np.ceil(1.0 / 0.43**2 - 1.0)) == 10
    )  # 1 + N / 2 >= 1 / 0.43^2
    assert fewest.at_least == 9  # half a reading of each more would do


def test_no_subset_beats_the_bounds_nor_the_fewest():
    rng = np.random.default_rng(0)
    rows, prior = rng.standard_normal((10, 1, 3)), np.eye(3)
    factors = rng.standard_normal((2, 2, 3))
    half = AccuracyGoal(("a", "b"), factors)
    scale = half.accuracy(
        prior + 0.4 * np.einsum("ckn,ckm->nm", rows, rows)
    )  # reachable with some of the ten
    goal = AccuracyGoal(("a", "b"), factors / scale[:, None, None])
    problem = SizeCurve(rows, prior, goal, (0,), rounds=6)

    def accuracies(size: int) -> np.ndarray:
        plans = [rows[list(s), 0] for s in itertools.combinations(range(10), size)]
        return np.array([goal.accuracy(prior + x.T @ x) for x in plans])

    for size in (3, 5):
        every, point = accuracies(size), problem.point(size)
        assert (every.min(axis=0) >= point.bound - 1e-9).all()
        assert point.accuracy.max() <= 1.02 * every.max(axis=1).min()
    fewest = problem.fewest(most=10)
    exact = next(n for n in range(1, 11) if (accuracies(n).max(axis=1) <= 1.0).any())
    assert fewest.at_least <= exact
    assert fewest.size in (exact, exact + 1)


def test_a_goal_out_of_reach_is_reported():
    rows = np.tile(np.eye(2), (3, 1))[:, None, :]
    fewest = SizeCurve(
        rows, np.eye(2), AccuracyGoal(("a", "b"), np.eye(2)[:, None, :] / 0.01), (0,)
    ).fewest(most=6)
    assert fewest.size is None
    assert not fewest.proven
    assert fewest.best.size == 6
    assert (fewest.best.bound > 1.0).all()
