"""The bound over all combinations of measurements, against all plans of catalogues."""

import dataclasses

import numpy as np
import pytest

from kernel import plan_catalogues as catalogues
from oed.planning import PlanProblem, PlanStreams
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
