"""Parts of the planner on linear readings, against inverses and all sets of readings."""

import dataclasses
import itertools

import numpy as np
import pytest

from kernel import plan_catalogues as catalogues
from kernel.plan_catalogues import linear_option
from oed.planning import Goal, Option, PlanStreams, search_plan
from oed.planning.bound import CombinationBound
from oed.planning.knowledge import make_knowledge
from oed.planning.prediction import (
    draw_machines,
    estimate_residual,
    profile,
    reading_counts,
)
from oed.planning.problem import PlanProblem, select_readings
from oed.planning.search import beam_search

N, ROWS = 3, 5


def catalogue(seed: int = 0) -> tuple[list[Option], Goal]:
    return catalogues.catalogue(np.random.default_rng(seed), options=3, n=N, size=ROWS)


def problem(seed: int = 0, budget: float = 2000.0, stages: int = 2) -> PlanProblem:
    options, goal = catalogue(seed)
    streams = PlanStreams.seeded(0)
    return PlanProblem(tuple(options), goal, budget, stages, np.eye(N), streams)


def covariance_after(start, option, chosen):
    """Of the machine (n, n), by the joint inverse with the set-up's parameter."""
    rows = option.candidates.blocks[list(chosen), 0]
    joint = np.eye(N + 1)
    joint[:N, :N] = np.linalg.inv(start)
    return np.linalg.inv(joint + rows.T @ rows)[:N, :N]


def test_a_plan_grows_by_the_joint_inverse():
    p = problem()
    option, empty = p.options[0], p.empty_plan()
    assert empty.value == pytest.approx(p.goal.value(np.eye(N)))
    assert p.setup_columns(option) == 1
    probability = p.capture_probability(option, np.eye(N))
    assert probability == pytest.approx(np.ones(ROWS))
    stage = p.predict(empty, option, np.array([0, 3]), probability)
    exact = covariance_after(np.eye(N), option, (0, 3))
    assert stage.covariance == pytest.approx(exact)
    plan = p.extend(empty, stage)
    assert plan.value == pytest.approx(p.goal.value(exact))
    assert plan.seconds == pytest.approx(
        option.mounting_seconds + option.candidate_seconds[[0, 3]].sum()
    )


def test_readings_that_are_not_captured_are_not_selected():
    options, goal = catalogue(1)
    probability = np.array([1.0, 1.0, 0.0, 1.0, 0.0])
    chosen = select_readings(options[0], 3, np.eye(N), goal.criterion(1), probability)
    assert chosen.tolist() == [0, 1, 3]


def test_selected_readings_of_unequal_length_keep_the_time():
    seconds = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
    options, goal = catalogue(1)
    option = dataclasses.replace(options[0], candidate_seconds=seconds)
    chosen = select_readings(
        option, 3, np.eye(N), goal.criterion(1), np.ones(ROWS), seconds=65.0
    )
    assert seconds[chosen].sum() <= 65.0


def test_a_beam_search_has_every_short_plan_and_its_accuracy():
    p = problem(budget=1e6, stages=1)
    plans = beam_search(p, 6, None)
    lengths = {(plan.names, len(plan.stages[0].chosen)) for plan in plans}
    counts = [(o.name, c) for o in p.options for c in o.affordable_counts(1e6)]
    assert lengths == {((name,), count) for name, count in counts}
    for plan in plans:
        (stage,) = plan.stages
        chosen = tuple(stage.chosen.tolist())
        exact = covariance_after(np.eye(N), stage.option, chosen)
        assert plan.value == pytest.approx(p.goal.value(exact))
    shares: list[float] = []
    beam_search(problem(), 6, shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)


def test_machines_without_travel_give_all_readings(rng):
    """Their covariance after a stage is the joint inverse."""
    (option, *_), chosen = catalogue()[0], np.array([1, 2, 4])
    machines = draw_machines(
        option, chosen, make_knowledge(np.eye(N)), np.ones(3), 50, rng
    )
    assert machines.patterns.tolist() == [[1.0, 1.0, 1.0]]
    assert machines.knowledge.errors is None
    rows = option.candidates.blocks[chosen, 0]
    information = (rows.T @ rows)[None]
    knowledge = machines.update(profile(information, N, N + 1), rng)
    exact = covariance_after(np.eye(N), option, (1, 2, 4))
    assert knowledge.mean_square_error == pytest.approx(exact)
    joint = machines.joint_posterior(information, np.array([0]))[0]
    assert joint == pytest.approx(np.linalg.inv(np.eye(N + 1) + information[0]))


def test_drawn_machines_lose_what_is_beyond_the_travel(rng):
    """A reading y ~ N(0, 2^2) is within 1 of what is expected with P = 0.383."""
    rows = np.array([[2.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    option = linear_option("o", rows, N, counts=(1, 2), travel=1.0)
    known, both = make_knowledge(np.eye(N)), np.arange(2)
    machines = draw_machines(option, both, known, np.array([0.38, 1.0]), 8000, rng)
    captured = machines.patterns[machines.pattern_of]
    assert captured.mean(axis=0) == pytest.approx([0.3829, 1.0], abs=0.02)
    assert machines.knowledge.errors is not None
    within = np.abs(machines.knowledge.errors @ rows[0]) <= 1.0
    assert (captured[:, 0] > 0.0).tolist() == within.tolist()
    assert machines.knowledge.lost_readings.tolist() == (~within).tolist()


def test_linear_readings_have_no_residual(rng):
    (option, *_), chosen = catalogue()[0], np.array([0, 2])
    posterior, pattern = np.eye(N + 1)[None], np.ones((1, 2))
    residual = estimate_residual(
        option, chosen, posterior, np.zeros(20, dtype=int), pattern, rng
    )
    assert residual.rms == pytest.approx(0.0, abs=1e-9)
    assert residual.columns is None
    assert reading_counts(option, chosen).tolist() == [1, 1]


def test_no_combination_is_above_its_bound():
    """All sets of readings of one or two options that the budget pays for."""
    p = problem(seed=4, budget=1500.0)
    combined = CombinationBound.of(p)
    pairs = np.array([[0, 1], [0, 2], [1, 2]])
    weights: dict[int, np.ndarray] = {}
    for pair in pairs:
        weights |= combined.relax(pair.tolist())
    bounds = combined.bound_all(pairs, weights)
    criterion = p.goal.criterion(0)
    for pair, upper in zip(pairs, bounds, strict=True):
        options = [p.options[k] for k in pair]
        gains = [catalogues.every_subset(option, N) for option in options]
        for (a, s), (b, t) in itertools.product(
            zip(*gains[0], strict=True), zip(*gains[1], strict=True)
        ):
            if s + t <= p.budget:
                assert criterion.value(np.eye(N) + a + b) <= upper + 1e-9


def test_streams_that_begin_anew_give_the_same_plan():
    """However far the generators of an earlier search went."""
    first, again = (search_plan(problem(2, 1500.0)) for _ in range(2))
    options, goal = catalogue(2)
    assert first.best.names == again.best.names
    assert first.best.value == again.best.value
    value, time = catalogues.every_plan(options, goal, 2)
    best = float(value[(time > 0.0) & (time <= 1500.0)].min())
    assert first.bound.value <= best * (1 + 1e-9)
    assert best * (1 - 1e-9) <= first.best.value <= 1.05 * best
