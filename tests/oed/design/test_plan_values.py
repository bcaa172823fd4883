"""Evaluators, searches, rules and bounds against all plans of tiny problems."""

import itertools

import numpy as np
import pytest

from oed.design import Criterion, Rules
from oed.design.bounds import bound, condition_bound
from oed.design.design_problem import drop_untouched_columns, rank_combinations, thin
from oed.design.evaluator import CriterionEvaluator
from oed.design.forms.determinant import Determinant
from oed.design.forms.eigenvalues import ExtremeEigenvalues
from oed.design.forms.variance import Variance
from oed.design.objective import CriterionObjective
from oed.design.rules import DistanceLimit, SetupLimit, TimeBudget
from oed.design.search import _Exchange, _Restarts, improve, search, select_greedily

COUNT, SIZE, N = 9, 4, 3
CRITERIA: dict[str, Criterion] = {
    "D": Determinant(N), "A": Variance(np.eye(N), "A"), "E": ExtremeEigenvalues(),
    "kappa": ExtremeEigenvalues(0.5, 0.5, name="kappa"),
}  # fmt: skip


def problem(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((COUNT, 1, N)), 0.05 * np.eye(N)


def plan_value(criterion, blocks, base, plan):
    rows = blocks[list(plan)].reshape(-1, blocks.shape[2])
    return criterion.value(base + rows.T @ rows)


@pytest.mark.parametrize("name", ["D", "A"])
def test_values_of_plans_are_those_of_their_sums(name):
    criterion, (blocks, base) = CRITERIA[name], problem(0)
    evaluator = CriterionEvaluator(blocks, criterion, base)
    plan = (1, 4, 7)
    assert evaluator.value(np.array(plan)) == pytest.approx(
        plan_value(criterion, blocks, base, plan)
    )
    added = evaluator.values_after_adding(np.array(plan), evaluator.levels - 1, 0.0)
    exact = [plan_value(criterion, blocks, base, (*plan, k)) for k in range(COUNT)]
    assert added == pytest.approx(exact)
    part = evaluator.subset(np.array([1, 4, 7]))
    assert part.count == 3
    assert part.value(np.arange(3)) == pytest.approx(evaluator.value(np.array(plan)))


@pytest.mark.parametrize("name", ["D", "A"])
def test_greedy_plans_take_the_best_candidate_each_time(name):
    criterion, (blocks, base) = CRITERIA[name], problem(1)
    evaluator = CriterionEvaluator(blocks, criterion, base)
    chosen = select_greedily(evaluator, Rules(size=SIZE), 0.0)
    expected: list[int] = []
    for _ in range(SIZE):
        free = [k for k in range(COUNT) if k not in expected]
        values = [plan_value(criterion, blocks, base, (*expected, k)) for k in free]
        expected.append(free[int(np.argmax(values))])
    assert sorted(chosen.tolist()) == sorted(expected)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", CRITERIA)
def test_searches_end_at_the_best_plan_and_below_the_bound(name, seed):
    criterion, (blocks, base) = CRITERIA[name], problem(10 + seed)
    rules, evaluator = Rules(size=SIZE), CriterionEvaluator(blocks, criterion, base)
    objective = CriterionObjective(criterion, blocks, base)
    if criterion.concave:
        upper = bound(objective, rules)
    else:
        found = condition_bound(objective, rules)
        assert found is not None
        upper = found
    every = itertools.combinations(range(COUNT), SIZE)
    best = max(plan_value(criterion, blocks, base, plan) for plan in every)
    assert best <= upper.bound + 1e-9
    assert upper.weights.sum() == pytest.approx(SIZE, rel=1e-3)
    start = np.arange(SIZE)
    rng = np.random.default_rng(0)
    plan = search(evaluator, rules, upper.weights, upper.gradient, [start], rng, 20)
    assert len(set(plan.tolist())) == SIZE
    assert evaluator.value(plan) == pytest.approx(best, abs=1e-9)
    improved = improve(evaluator, rules, start, evaluator.levels - 1)
    assert evaluator.value(start) <= evaluator.value(improved) <= best + 1e-9


@pytest.mark.parametrize("name", CRITERIA)
def test_sweeps_end_where_no_exchange_helps(name):
    """Candidate by candidate, as under any limit but a size alone."""
    blocks, base = problem(10)
    evaluator = CriterionEvaluator(blocks, CRITERIA[name], base)
    rules = Rules(time=TimeBudget(np.ones(COUNT), SIZE))
    plan = improve(evaluator, rules, np.arange(SIZE), evaluator.levels - 1)
    assert len(set(plan.tolist())) == SIZE
    for place, other in itertools.product(range(SIZE), range(COUNT)):
        exchanged = plan.copy()
        exchanged[place] = other
        if len(set(exchanged.tolist())) == SIZE:
            assert evaluator.value(exchanged) <= evaluator.value(plan) + 1e-9


@pytest.mark.parametrize(("size", "most"), [(1, 1), (4, 4), (8, 6)])
def test_a_restart_replaces_two_to_six_candidates(size, most):
    """Each number about as often; of one candidate, that one."""
    blocks = np.random.default_rng(3).standard_normal((20, 1, N))
    evaluator = CriterionEvaluator(blocks, CRITERIA["D"], 0.05 * np.eye(N))
    exchange = _Exchange(evaluator, Rules(size=size))
    restarts = _Restarts(exchange, np.random.default_rng(3))
    plan = np.arange(size)
    changed = [restarts._change(plan) for _ in range(100)]
    assert {len(np.unique(one)) for one in changed} == {size}
    replaced = {len(np.setdiff1d(plan, one)) for one in changed}
    assert replaced == set(range(min(2, most), most + 1))


def test_a_budget_of_time_bounds_plans_of_any_size():
    criterion, (blocks, base) = CRITERIA["D"], problem(5)
    cost = np.random.default_rng(5).uniform(1.0, 3.0, COUNT)
    rules = Rules(time=TimeBudget(cost, 7.0))
    objective = CriterionObjective(criterion, blocks, base)
    upper = bound(objective, rules)
    assert upper.weights @ cost == pytest.approx(7.0, rel=1e-3)
    for size in range(1, 8):
        for plan in itertools.combinations(range(COUNT), size):
            if cost[list(plan)].sum() <= 7.0:
                value = plan_value(criterion, blocks, base, plan)
                assert value <= upper.bound + 1e-9
    kappa = CriterionObjective(CRITERIA["kappa"], blocks, base)
    assert condition_bound(kappa, rules) is None
    assert condition_bound(objective, Rules(size=3)) is None


def test_the_best_two_set_ups_are_those_of_all_pairs():
    """Few candidates each: the ranks are by relaxations, near the plans themselves."""
    rng = np.random.default_rng(3)
    blocks, setup = rng.standard_normal((12, 1, N)), np.repeat(np.arange(4), 3)
    blocks[setup == 2] *= 3.0
    blocks[setup == 0] *= 2.5
    base, criterion = 0.05 * np.eye(N), CRITERIA["D"]
    setups = SetupLimit(setup, most=2)
    rules = Rules(size=6, setups=setups)
    objective = CriterionObjective(criterion, blocks, base)
    (first, *_) = rank_combinations(objective, rules, setups)

    def value(pair: tuple[int, ...]) -> float:
        # six readings of six: all of them
        members = np.flatnonzero(np.isin(setup, pair))
        return plan_value(criterion, blocks, base, tuple(members.tolist()))

    pairs = list(itertools.combinations(range(4), 2))
    assert first == max(pairs, key=value)
    assert (
        thin(setups, first).tolist() == np.flatnonzero(np.isin(setup, first)).tolist()
    )


def test_columns_that_no_block_touches_leave():
    blocks = np.random.default_rng(1).standard_normal((5, 1, 4))
    blocks[:, :, 2] = 0.0
    base = np.diag([1.0, 2.0, 3.0, 4.0])
    objective = CriterionObjective(Determinant(4), blocks, base)
    fewer = drop_untouched_columns(objective)
    assert fewer.blocks.shape == (5, 1, 3)
    assert np.diag(fewer.base).tolist() == [1.0, 2.0, 4.0]
    assert fewer.criterion.value(fewer.base) == pytest.approx(np.log(8.0) / 3.0)
    base[2, 0] = base[0, 2] = 0.5
    assert drop_untouched_columns(objective) is objective


CANDIDATES, SETUPS = 12, 4
MOUNTING = (30.0, 10.0, 50.0, 20.0)
MOUNTED = (1,)


def limits(seed: int) -> tuple[SetupLimit, TimeBudget, DistanceLimit]:
    rng = np.random.default_rng(seed)
    setups = SetupLimit(
        rng.integers(0, SETUPS, CANDIDATES), np.array(MOUNTING), most=2, mounted=MOUNTED
    )
    budget = TimeBudget(rng.uniform(1.0, 5.0, CANDIDATES), 70.0)
    return setups, budget, DistanceLimit(rng.uniform(0.0, 6.0, (CANDIDATES, 1)), 0.8)


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
        free = rules.additions(np.array(plan, dtype=np.intp), CANDIDATES)
        for k in range(CANDIDATES):
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
    whole = rules.additions(pool[:1], CANDIDATES)
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
