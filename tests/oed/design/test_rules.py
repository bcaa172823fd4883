"""Combinations of set-ups over which plans are bounded, listed by hand."""

import itertools

import numpy as np
import pytest

from oed.design import Rules
from oed.design.rules import SetupLimit, TimeBudget

SETUP = np.array([0, 0, 1, 2, 2, 2, 3])


def combinations(rules: Rules) -> list[set[int]]:
    """Set-ups of each first level."""
    parts = rules.relaxations(len(SETUP))
    return [set(SETUP[part.candidates].tolist()) for part in parts]


@pytest.mark.parametrize("most", [1, 2, 3, 4, 9])
def test_plans_of_a_number_of_set_ups_are_bounded_over_each_combination(most):
    """Of more set-ups than there are, over all of them."""
    rules = Rules(size=3, setups=SetupLimit(SETUP, most=most))
    by_hand = [set(c) for c in itertools.combinations(range(4), min(most, 4))]
    assert combinations(rules) == by_hand


def test_where_mounting_counts_fewer_set_ups_leave_more_of_the_budget():
    cost = np.array([1.0, 2.0, 4.0, 8.0])
    rules = Rules(
        time=TimeBudget(np.ones(len(SETUP)), 7.0),
        setups=SetupLimit(SETUP, cost, most=2),
    )
    every = [set(c) for k in (1, 2) for c in itertools.combinations(range(4), k)]
    times = [float(cost[list(c)].sum()) for c in every]
    by_hand = [(c, t) for c, t in zip(every, times, strict=True) if t < 7.0]
    assert combinations(rules) == [c for c, _ in by_hand]
    totals = [part.total for part in rules.relaxations(len(SETUP))]
    sizes = [int(np.isin(SETUP, list(c)).sum()) for c, _ in by_hand]
    rest = [7.0 - t for _, t in by_hand]
    assert totals == [min(r, n) for r, n in zip(rest, sizes, strict=True)]
