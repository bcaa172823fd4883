"""Accuracy against readings and the fewest readings: closed forms, every subset."""

import itertools

import numpy as np
import pytest

from oed.design import SizeCurve
from oed.design.how_many import AccuracyGoal


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
