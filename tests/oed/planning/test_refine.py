"""Refinement of plans of linear readings: times by hand, values of all plans."""

import dataclasses

import numpy as np
import pytest

from kernel import plan_catalogues as catalogues
from oed.planning import search
from oed.planning.problem import PlanProblem, PlanStreams

N, SIZE = 3, 5


def problem(seed, budget=1500.0, target=None):
    rng = np.random.default_rng(seed)
    options, goal = catalogues.catalogue(
        rng, n=N, size=SIZE, targets=target is not None
    )
    if target is not None:
        goal = dataclasses.replace(goal, factors=goal.factors / target)
    streams = PlanStreams.seeded(0)
    return PlanProblem(tuple(options), goal, budget, 2, np.eye(N), streams)


def test_times_are_mounting_and_a_minute_a_reading():
    first, second, _ = problem(0).options
    steps = [(first, 2), (second, 1)]
    exact = first.mounting_seconds + second.mounting_seconds + 180.0
    assert search.least_seconds(steps) == pytest.approx(exact)
    assert search.replaced_step(steps, 1, 4) == [(first, 2), (second, 4)]
    assert steps == [(first, 2), (second, 1)]
    filled = search.fill_time(steps, exact + 130.0, last=0)
    assert filled == [(first, 2), (second, 3)]
    assert search.fill_time(steps, exact + 130.0, last=1) == [(first, 4), (second, 1)]
    for trial in search.propose_moves(steps, exact + 60.0):
        assert search.least_seconds(trial) <= exact + 60.0 + 1e-9
        assert trial != steps
    assert [(second, 1), (first, 2)] in search.propose_moves(steps, exact)


@pytest.mark.parametrize("seed", range(3))
def test_moved_time_ends_within_a_few_percent_of_all_plans(seed):
    """Of the two options of the plan."""
    p = problem(seed)
    steps = [(p.options[0], 1), (p.options[1], 1)]
    start = search.evaluate_steps(p, steps)
    plan = search.move_time(p, start)
    assert plan.value <= start.value + 1e-12
    assert plan.seconds <= p.budget + 1e-9
    value, time = catalogues.every_plan(list(p.options[:2]), p.goal, 2)
    best = float(value[time <= p.budget].min())
    assert best * (1 - 1e-9) <= plan.value <= 1.05 * best
    assert search.steps_of(plan) == [(s.option, len(s.chosen)) for s in plan.stages]


def test_a_plan_is_verified_with_its_readings():
    """Linear readings without travel are the same on all machines."""
    p = problem(1)
    plan = search.evaluate_steps(p, [(p.options[0], 3), (p.options[2], 2)])
    verified = search.verify_plan(p, plan)
    assert verified.value == pytest.approx(plan.value)
    pairs = zip(plan.stages, verified.stages, strict=True)
    assert all((a.chosen == b.chosen).all() for a, b in pairs)


def test_a_trimmed_plan_has_no_reading_too_many():
    p = problem(2, budget=1e5)
    full = [(p.options[0], SIZE - 1), (p.options[1], SIZE - 1)]
    most = search.evaluate_steps(p, full).value
    # targets that the whole plan reaches by far
    easy = problem(2, budget=1e5, target=2.0 * most)
    steps = [(easy.options[0], SIZE - 1), (easy.options[1], SIZE - 1)]
    plan = search.trim_plan(easy, search.evaluate_steps(easy, steps))
    assert plan.value <= 1.0
    for k, (option, count) in enumerate(search.steps_of(plan)):
        if count > option.counts[0]:
            fewer = search.replaced_step(search.steps_of(plan), k, count - 1)
            assert search.evaluate_steps(easy, fewer, plan).value > 1.0


def test_relaxed_numbers_become_a_plan_within_the_budget():
    p = problem(0, budget=1500.0)
    plan = search.plan_from_counts(p, {0: 3.7, 2: 9.0})
    assert set(plan.names) == {"o0", "o2"}
    assert plan.seconds <= p.budget + 1e-9
    short = dataclasses.replace(p, budget=10.0)
    assert search.plan_from_counts(short, {0: 3.7}) is None
