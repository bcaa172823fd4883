"""The planner on small catalogues of linear readings, against every plan and inverses."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from kernel import plan_catalogues as catalogues
from kernel.plan_catalogues import linear_option, searched, stage_after
from oed.planning import Goal, Option, PlanStreams, StagePlan, search_plan
from oed.planning.bound import CombinationBound
from oed.planning.knowledge import Prior, make_knowledge
from oed.planning.prediction import (
    draw_machines,
    estimate_residual,
    profile,
    reading_counts,
)
from oed.planning.problem import PlanProblem, best_plan, is_better, select_readings
from oed.planning.search import beam_search

THREE = Goal(("a", "b", "c"), np.eye(3)[:, None, :], np.ones(3), has_targets=False)


def simulate_two_stages(first, second, limit, rng, machines):
    """Machines d ~ N(0, 1) through two stages of readings with travel `limit`.

    Each stage has a parameter of its own, and noise of 1. Normal equations over machine
    and set-up give the mean squares (2, 3, 3) of the errors after each stage, the mean
    covariance (3, 3) at the end, and the shares (2,) of readings taken.
    """
    square, covariance = np.zeros((2, 3, 3)), np.zeros((3, 3))
    taken = np.zeros(2)
    for _ in range(machines):
        d, mean, information = rng.standard_normal(3), np.zeros(3), np.eye(3)
        for k, rows in enumerate((first, second)):
            deviation = rows[:, :3] @ (d - mean) + rows[:, 3] * rng.standard_normal()
            within = np.abs(deviation) <= limit
            noise = rng.standard_normal(len(rows))
            y, captured = (deviation + noise)[within], rows[within]
            joint = np.eye(4)
            joint[:3, :3] = information
            posterior = np.linalg.inv(joint + captured.T @ captured)
            mean = mean + (posterior @ captured.T @ y)[:3]
            information = np.linalg.inv(posterior[:3, :3])
            square[k] += np.outer(d - mean, d - mean) / machines
            taken[k] += len(captured) / len(rows) / machines
        covariance += posterior[:3, :3] / machines
    return square, covariance, taken


def test_machines_that_lose_readings_are_farther_off_than_their_covariance_says():
    """Two stages against 6000 machines simulated one by one: losses and errors."""
    rng = np.random.default_rng(6)
    rows = [
        np.column_stack([rng.standard_normal((6, 3)) * s, 0.3 * rng.standard_normal(6)])
        for s in (6.0, 20.0)
    ]
    square, covariance, taken = simulate_two_stages(*rows, 8.0, rng, 6000)
    prior: Prior = np.eye(3)
    for k, r in enumerate(rows):
        option = linear_option("o", r, 3, counts=(6,), travel=8.0)
        stage_rng = np.random.default_rng(k)
        stage = stage_after(option, np.arange(6), prior, stage_rng, draws=6000)
        prior = stage.posterior
        assert stage.probability.mean() == pytest.approx(taken[k], abs=0.02)
        assert np.diag(stage.covariance) == pytest.approx(np.diag(square[k]), rel=0.12)
    assert 0.3 < taken[0] < 0.9
    assert np.trace(square[1]) > 1.25 * np.trace(covariance)


def short_options(rows: list[np.ndarray], limit: float) -> list[Option]:
    """Options of eight readings each, with a travel."""
    return [
        linear_option(f"o{k}", r, 3, counts=(4, 8), travel=limit)
        for k, r in enumerate(rows)
    ]


def test_a_machine_that_no_reading_captures_bounds_every_plan():
    """A travel far below the machines' errors: plans stay above the bound."""
    rng = np.random.default_rng(2)
    rows = [
        np.column_stack([50.0 * rng.standard_normal((8, 3)), rng.standard_normal(8)])
        for _ in range(3)
    ]
    bounds = []
    for limit in (10.0, math.inf):
        result = searched(short_options(rows, limit), THREE, 1e4, stages=2)
        assert result.bound.value <= result.most_accurate.value
        bounds.append(result.bound.value)
    assert bounds[0] > 10.0 * bounds[1]
    # the share of drawn machines that no reading of two options captures, and how far
    # off these are
    machines = rng.standard_normal((20000, 3))
    uncaptured = []
    for r in rows:
        of_setup = rng.standard_normal((20000, 1)) * r[:, 3]
        deviation = np.abs(machines @ r[:, :3].T + of_setup)
        uncaptured.append((deviation > 10.0).all(axis=1))
    never = []
    for a, b in itertools.combinations(uncaptured, 2):
        errors = np.where((a & b)[:, None], machines, 0.0)
        never.append(np.sqrt(np.mean(errors**2)))
    assert 0.8 * min(never) < bounds[0] < 1.02 * min(never)


def test_of_equally_good_orders_the_one_of_more_linear_readings_is_taken():
    options, goal = catalogues.catalogue(np.random.default_rng(0), options=2)
    plan = searched(options, goal, 1e4, stages=2).best
    swapped = StagePlan(
        plan.stages[::-1], plan.seconds, plan.value * 1.001, plan.accuracy
    )
    bent_stages = tuple(
        dataclasses.replace(s, linearisation_rms=np.full(len(s.chosen), 0.5))
        for s in plan.stages
    )
    bent = StagePlan(bent_stages, plan.seconds, plan.value, plan.accuracy)
    assert (plan.nonlinearity, bent.nonlinearity) == (0.0, 0.5)
    assert best_plan([bent, swapped]) is swapped
    assert is_better(swapped, bent)
    assert not is_better(bent, swapped)
    assert is_better(bent, dataclasses.replace(swapped, value=1.1 * plan.value))


def test_a_rough_stage_comes_first_only_where_travel_asks_for_it():
    """Errors far beyond the travel of the fine option want the rough one first."""
    rng = np.random.default_rng(1)
    fine_rows = 300.0 * rng.standard_normal((12, 3))
    rough_rows = 20.0 * rng.standard_normal((12, 3))

    def option(name: str, rows: np.ndarray, limit: float) -> Option:
        return linear_option(name, rows, 3, counts=(4, 8), mounting=600.0, travel=limit)

    def best_names(limit: float) -> tuple[str, ...]:
        options = [
            option("fine", fine_rows, limit),
            option("rough", rough_rows, math.inf),
        ]
        return searched(options, THREE, 1500.0, stages=2).best.names

    assert best_names(40.0)[0] == "rough"
    assert "fine" in best_names(40.0)
    assert best_names(1e6)[0] == "fine"


def test_targets_are_reached_at_least_cost_or_reported_out_of_reach():
    options, goal = catalogues.catalogue(np.random.default_rng(8), targets=True)
    value, time = catalogues.every_plan(options, goal, 2)
    within = (time > 0.0) & (time <= 3000.0)
    least = float(value[within].min())
    near = dataclasses.replace(goal, factors=goal.factors / (1.3 * least))
    result = searched(options, near, 3000.0, stages=2)
    assert result.reached
    assert result.best.value <= 1.0
    cheapest = float(time[within & (value / (1.3 * least) <= 1.0)].min())
    assert cheapest - 1e-9 <= result.best.seconds <= 1.25 * cheapest
    far = dataclasses.replace(goal, factors=goal.factors / (0.5 * least))
    never = searched(options, far, 3000.0, stages=2)
    assert not never.reached
    assert never.bound.value > 1.0
    with pytest.raises(ValueError, match="pays for no measurement"):
        searched(options, goal, 10.0)
    with pytest.raises(ValueError, match="no measurement is left to plan"):
        searched([], goal, 3000.0)


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
