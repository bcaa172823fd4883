"""Single rules of a plan against counting by hand, candidate by candidate."""

import itertools

import numpy as np
import pytest

from oed.design import Rules
from oed.design.rules import DistanceLimit, SetupLimit, TimeBudget

COUNT, SETUPS = 12, 4
MOUNTING = (30.0, 10.0, 50.0, 20.0)
MOUNTED = (1,)


def limits(seed: int) -> tuple[SetupLimit, TimeBudget, DistanceLimit]:
    rng = np.random.default_rng(seed)
    setups = SetupLimit(
        rng.integers(0, SETUPS, COUNT), np.array(MOUNTING), most=2, mounted=MOUNTED
    )
    budget = TimeBudget(rng.uniform(1.0, 5.0, COUNT), 70.0)
    return setups, budget, DistanceLimit(rng.uniform(0.0, 6.0, (COUNT, 1)), 0.8)


def is_allowed(plan, setups, budget, distance):
    """Whether a plan keeps the rules, by their definition."""
    used = {int(setups.setup[k]) for k in plan} - set(MOUNTED)
    seconds = sum(MOUNTING[s] for s in used) + sum(float(budget.cost[k]) for k in plan)
    apart = all(
        abs(distance.position[i, 0] - distance.position[j, 0]) >= distance.least
        for i, j in itertools.combinations(plan, 2)
        if setups.setup[i] == setups.setup[j]
    )
    return len(used) <= 2 and seconds <= budget.available and apart


@pytest.mark.parametrize("seed", range(10))
def test_what_may_join_a_plan_keeps_every_rule(seed):
    setups, budget, distance = limits(seed)
    rules = Rules(size=5, time=budget, setups=setups, distance=distance)
    plan: list[int] = []
    rng = np.random.default_rng(100 + seed)
    while True:
        free = rules.additions(np.array(plan, dtype=np.intp), COUNT)
        for k in range(COUNT):
            joins = k not in plan and len(plan) < 5
            assert free[k] == (
                joins and is_allowed({*plan, k}, setups, budget, distance)
            )
        if not free.any():
            break
        plan.append(int(rng.choice(np.flatnonzero(free))))
    used = {int(setups.setup[k]) for k in plan} - set(MOUNTED)
    seconds = sum(MOUNTING[s] for s in used) + budget.cost[plan].sum()
    assert rules.time_of(np.array(plan)) == pytest.approx(seconds)


def test_a_part_of_the_candidates_has_their_rules():
    setups, budget, distance = limits(3)
    pool = np.array([0, 2, 5, 7, 11])
    rules = Rules(size=5, time=budget, setups=setups, distance=distance)
    part = rules.subset(pool)
    whole = rules.additions(pool[:1], COUNT)
    assert (part.additions(np.array([0]), len(pool)) == whole[pool]).all()


def test_only_a_size_alone_is_the_sole_rule():
    setups, budget, distance = limits(0)
    free = SetupLimit(setups.setup)
    assert Rules(size=5, setups=free).sole_size == 5
    assert Rules(size=5, setups=setups).sole_size is None
    assert Rules(size=5, setups=setups).any_setups.sole_size == 5
    assert Rules(size=5, time=budget).sole_size is None
    assert Rules(size=5, distance=distance).sole_size is None


def test_a_plan_needs_a_limit_and_a_budget_needs_times():
    with pytest.raises(ValueError, match="a number of readings or a budget"):
        Rules()
    with pytest.raises(ValueError, match="positive cost"):
        TimeBudget(np.zeros(3), 10.0)
