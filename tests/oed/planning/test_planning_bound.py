"""The bound over all combinations, and refinement of plans, against all plans."""

import dataclasses

import numpy as np
import pytest

from kernel import plan_catalogues as catalogues
from oed.planning import PlanProblem, PlanStreams, search
from oed.planning import bound as bound_module
from oed.planning import prediction as stage_module
from oed.planning.bound import bound_goal
from oed.planning.knowledge import Prior, make_knowledge


def bound_of(options, goal, budget, value, stages=3):
    streams, start = PlanStreams.seeded(0), np.eye(3)
    problem = PlanProblem(tuple(options), goal, budget, stages, start, streams)
    return bound_goal(problem, value)


def test_no_plan_of_many_catalogues_is_below_the_bound():
    """All sets of readings, under budgets that bind or not, of two stages or three."""
    gaps = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        # readings of one length, and of several
        options, goal = catalogues.catalogue(rng, equal_times=seed % 3 > 0)
        stages = 2 + seed % 2
        value, time = catalogues.every_plan(options, goal, stages)
        budget = 1e5 if seed % 5 == 0 else float(rng.uniform(900.0, 2500.0))
        best = value[(time > 0.0) & (time <= budget)].min()
        bound = bound_of(options, goal, budget, best, stages)
        gaps.append(best / bound.value - 1.0)
    assert min(gaps) >= 0.0
    certified = sum(gap <= 0.05 + 1e-9 for gap in gaps)
    assert certified >= 8
    assert np.median(gaps) < 0.03


def test_a_bound_without_limits_on_numbers_of_readings_is_lower():
    """Where time does not bind, the numbers of readings do."""
    options, goal = catalogues.catalogue(np.random.default_rng(3), size=8)
    few = [dataclasses.replace(option, counts=(2,)) for option in options]
    value, time = catalogues.every_plan(few, goal, 3)
    best = value[time > 0.0].min()
    bound = bound_of(few, goal, 1e5, best)
    assert bound.value <= best
    assert bound.value > 1.1 * bound_of(options, goal, 1e5, best).value


def test_readings_lost_to_the_setup_itself_stay_within_the_bound(monkeypatch):
    """With a travel as large as what the set-ups' parameters do."""
    monkeypatch.setattr(stage_module, "FIRST_LOOK_DRAWS", 1000)
    for seed in range(4):
        rng = np.random.default_rng(200 + seed)
        options, goal = catalogues.catalogue(rng)
        short = [dataclasses.replace(option, travel=30.0) for option in options]
        prior: Prior = np.eye(3)
        for option in short:
            chosen = rng.permutation(len(option.candidates))[: option.counts[-1]]
            stage = catalogues.stage_after(option, chosen, prior, rng, exact=False)
            prior = stage.posterior
        value = goal.value(make_knowledge(prior).mean_square_error)
        assert bound_of(short, goal, 1e5, value).value <= value


def test_too_many_combinations_are_refused(monkeypatch):
    options, goal = catalogues.catalogue(np.random.default_rng(0))
    monkeypatch.setattr(bound_module, "MAX_COMBINATIONS", 3)
    with pytest.raises(
        ValueError, match="7 combinations of 3 of 3 measurements are too many"
    ):
        bound_of(options, goal, 1e5, 1.0)


def test_promising_combinations_fit_the_budget_and_could_be_better():
    options, goal = catalogues.catalogue(np.random.default_rng(5))
    value, time = catalogues.every_plan(options, goal, 3)
    budget = 1500.0
    worse = value[(time > 0.0) & (time <= budget)].min() * 1.3
    bound = bound_of(options, goal, budget, worse)
    assert bound.promising
    for counts in bound.promising:
        seconds = sum(
            options[s].mounting_seconds + count * options[s].candidate_seconds[0]
            for s, count in counts.items()
        )
        assert seconds <= budget * 1.001


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
