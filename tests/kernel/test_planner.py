"""The planner on small catalogues of linear readings, against every plan there is."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from kernel import plan_catalogues as small
from oed.planning import bound, search, stage, travel
from oed.planning.known import Known


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("minutes", [12.0, 40.0])
def test_no_plan_beats_the_bound_and_the_planner_finds_nearly_the_best(
    seed: int, minutes: float
) -> None:
    """All sets of readings of at most two of three options, within a budget that binds
    and one that hardly does.
    """
    options, goal = small.catalogue(np.random.default_rng(seed), alike=seed % 2 == 0)
    value, time = small.every_plan(options, goal, 2)
    within = (time > 0.0) & (time <= 60.0 * minutes)
    assert within.any()
    best = float(value[within].min())
    found = search.plan(
        options, goal, 60.0 * minutes, np.random.default_rng(0), stages=2
    )
    assert found.bound.value <= best * (1 + 1e-9)
    assert found.most_accurate.value >= best * (1 - 1e-9)
    # readings of unequal length are chosen for what they tell, not for their time
    assert found.most_accurate.value <= (1.03 if seed % 2 == 0 else 1.4) * best
    assert found.most_accurate.seconds <= 60.0 * minutes * (1 + 1e-9)


def test_the_bound_is_the_relaxation_of_the_only_combination() -> None:
    """One option whose readings can all be taken: the bound is its plan of all
    readings.
    """
    options, goal = small.catalogue(np.random.default_rng(3), options=1)
    value, _ = small.every_plan(options, goal, 1)
    told = bound.bound(
        options, goal, np.eye(3), 1e6, 1, known=float(value.min()), loss=1e-4
    )
    assert told.value <= value.min() * (1 + 1e-9)
    assert told.value == pytest.approx(
        value.min(), rel=0.1
    )  # at most four of the five readings are taken


def test_stages_without_travel_add_up_in_any_order(rng: np.random.Generator) -> None:
    """Covariance after two stages, by the joint inverse of machine and both options'
    own unknowns.
    """
    (first, second), _ = small.catalogue(rng, options=2)
    chosen = np.array([0, 2, 3])
    ways = []
    for order in ((first, second), (second, first)):
        covariance = np.eye(3)
        for option in order:
            covariance = stage.told(
                option, chosen, covariance, rng, exact=False
            ).covariance
        ways.append(covariance)
    assert ways[0] == pytest.approx(ways[1], rel=1e-9)
    joint = np.eye(5)
    for k, option in enumerate((first, second)):
        rows = option.candidates.blocks[chosen, 0]
        wide = np.zeros((3, 5))
        wide[:, :3], wide[:, 3 + k] = rows[:, :3], rows[:, 3]
        joint += wide.T @ wide
    assert ways[0] == pytest.approx(np.linalg.inv(joint)[:3, :3], rel=1e-9)


def test_readings_out_of_travel_are_lost_as_monte_carlo_loses_them() -> None:
    rng = np.random.default_rng(5)
    rows = rng.standard_normal((6, 4))
    option = small.option(
        "o", rows, 3, counts=(3,), mounting=1.0, seconds=np.ones(6), travel=1.2
    )
    covariance = np.diag([1.0, 0.3, 0.1])
    told = travel.available(option, covariance)
    errors = rng.standard_normal((200_000, 4)) * np.sqrt(np.array([1.0, 0.3, 0.1, 1.0]))
    assert told == pytest.approx(
        (np.abs(errors @ rows.T) <= 1.2).mean(axis=0), abs=4e-3
    )
    assert (travel.available(option, np.zeros((3, 3))) >= told - 1e-12).all()


def two_stages(
    first: np.ndarray,
    second: np.ndarray,
    travel_: float,
    rng: np.random.Generator,
    machines: int,
) -> tuple:
    """Machines d ~ N(0, 1) through two lots of readings of travel, each with an unknown
    of its own and noise of 1.

    Returns mean squares (3, 3) of what is wrong after either lot, the mean covariance
    that the readings themselves tell at the end, and the shares (2,) of readings taken:
    by normal equations over machine and unknown.
    """
    wrong, told, taken = np.zeros((2, 3, 3)), np.zeros((3, 3)), np.zeros(2)
    for _ in range(machines):
        d, mean, held = rng.standard_normal(3), np.zeros(3), np.eye(3)
        for k, rows in enumerate((first, second)):
            off = rows[:, :3] @ (d - mean) + rows[:, 3] * rng.standard_normal()
            kept = rows[np.abs(off) <= travel_]
            read = (off + rng.standard_normal(len(rows)))[np.abs(off) <= travel_]
            joint = np.eye(4)
            joint[:3, :3] = held
            left = np.linalg.inv(joint + kept.T @ kept)
            mean = mean + (left @ kept.T @ read)[:3]
            held = np.linalg.inv(left[:3, :3])
            wrong[k] += np.outer(d - mean, d - mean) / machines
            taken[k] += len(kept) / len(rows) / machines
        told += left[:3, :3] / machines
    return wrong, told, taken


def test_machines_that_lose_readings_are_farther_off_than_those_tell() -> None:
    """Two stages against 6000 machines simulated one by one: what is lost in either,
    and what is wrong after it.
    """
    rng = np.random.default_rng(6)
    rows = [
        np.column_stack([rng.standard_normal((6, 3)) * s, 0.3 * rng.standard_normal(6)])
        for s in (6.0, 20.0)
    ]
    wrong, told, taken = two_stages(*rows, 8.0, rng, 6000)
    kinds: np.ndarray | Known = np.eye(3)
    for k, r in enumerate(rows):
        made = small.option(
            "o", r, 3, counts=(6,), mounting=1.0, seconds=np.ones(6), travel=8.0
        )
        done = stage.told(
            made, np.arange(6), kinds, np.random.default_rng(k), draws=6000
        )
        kinds = done.known
        assert done.available.mean() == pytest.approx(taken[k], abs=0.02)
        assert np.diag(done.covariance) == pytest.approx(np.diag(wrong[k]), rel=0.12)
    assert 0.3 < taken[0] < 0.9
    assert np.trace(wrong[1]) > 1.25 * np.trace(told)


def test_a_machine_that_no_reading_can_follow_bounds_every_plan() -> None:
    """Options of a travel far below the machine's errors: the bound knows, plans worked
    out are not below it.
    """
    rng = np.random.default_rng(2)
    rows = [
        np.column_stack([50.0 * rng.standard_normal((8, 3)), rng.standard_normal(8)])
        for _ in range(3)
    ]
    goal = small.Goal(("a", "b", "c"), np.eye(3)[:, None, :], np.ones(3), wanted=False)
    values = []
    for far in (10.0, None):
        options = [
            small.option(
                f"o{k}",
                r,
                3,
                counts=(4, 8),
                mounting=60.0,
                seconds=np.full(8, 10.0),
                travel=far,
            )
            for k, r in enumerate(rows)
        ]
        found = search.plan(options, goal, 1e4, np.random.default_rng(0), stages=2)
        assert found.bound.value <= found.most_accurate.value
        values.append(found.bound.value)
    assert values[0] > 10.0 * values[1]
    # the share of drawn machines that all readings of two options are out of, and how
    # far off these are
    machines = rng.standard_normal((20000, 3))
    out = [
        (
            np.abs(machines @ r[:, :3].T + rng.standard_normal((20000, 1)) * r[:, 3])
            > 10.0
        ).all(axis=1)
        for r in rows
    ]
    never = [
        np.sqrt(np.mean(np.where((a & b)[:, None], machines, 0.0) ** 2))
        for a, b in itertools.combinations(out, 2)
    ]
    assert 0.8 * min(never) < values[0] < 1.02 * min(never)


def test_of_equally_good_orders_the_one_of_straighter_readings_is_taken() -> None:
    options, goal = small.catalogue(np.random.default_rng(0), options=2)
    made = search.plan(options, goal, 1e4, np.random.default_rng(0), stages=2).best
    again = search.StagePlan(
        made.stages[::-1], made.seconds, made.value * 1.001, made.accuracy
    )
    bent = [
        dataclasses.replace(s, cut_off=np.full(len(s.chosen), 0.5)) for s in made.stages
    ]
    curved = search.StagePlan(tuple(bent), made.seconds, made.value, made.accuracy)
    assert (made.bent, curved.bent) == (0.0, 0.5)
    assert search._best([curved, again]) is again
    assert search._better(again, curved)
    assert not search._better(curved, again)
    assert search._better(curved, dataclasses.replace(again, value=1.1 * made.value))


def test_a_rough_stage_comes_first_only_where_travel_asks_for_it() -> None:
    """A fine option of little range and a rough one of any: errors far beyond the range
    want the rough one first.
    """
    rng = np.random.default_rng(1)
    fine, coarse = (
        300.0 * rng.standard_normal((12, 3)),
        20.0 * rng.standard_normal((12, 3)),
    )

    def planned(travel: float) -> tuple[str, ...]:
        options = [
            small.option(
                "fine",
                fine,
                3,
                counts=(4, 8),
                mounting=600.0,
                seconds=np.full(12, 10.0),
                travel=travel,
            ),
            small.option(
                "rough",
                coarse,
                3,
                counts=(4, 8),
                mounting=600.0,
                seconds=np.full(12, 10.0),
            ),
        ]
        goal = small.Goal(
            ("a", "b", "c"), np.eye(3)[:, None, :], np.ones(3), wanted=False
        )
        return search.plan(
            options, goal, 1500.0, np.random.default_rng(0), stages=2
        ).best.names

    assert planned(40.0)[0] == "rough"
    assert "fine" in planned(40.0)
    assert planned(1e6)[0] == "fine"


def test_what_is_wanted_is_reached_at_least_cost_or_said_to_be_out_of_reach() -> None:
    options, goal = small.catalogue(np.random.default_rng(8), wanted=True)
    value, time = small.every_plan(options, goal, 2)
    within = (time > 0.0) & (time <= 3000.0)
    least = float(value[within].min())
    near = small.Goal(goal.names, goal.factors / (1.3 * least), goal.unit, wanted=True)
    found = search.plan(options, near, 3000.0, np.random.default_rng(0), stages=2)
    assert found.reached
    assert found.best.value <= 1.0
    cheapest = float(time[within & (value / (1.3 * least) <= 1.0)].min())
    assert cheapest - 1e-9 <= found.best.seconds <= 1.25 * cheapest
    far = small.Goal(goal.names, goal.factors / (0.5 * least), goal.unit, wanted=True)
    never = search.plan(options, far, 3000.0, np.random.default_rng(0), stages=2)
    assert not never.reached
    assert never.bound.value > 1.0
    with pytest.raises(ValueError, match="pays for no measurement"):
        search.plan(options, goal, 10.0, np.random.default_rng(0))


def test_same_seed_same_plan() -> None:
    options, goal = small.catalogue(np.random.default_rng(4))
    first, again = (
        search.plan(options, goal, 2000.0, np.random.default_rng(3), stages=2)
        for _ in range(2)
    )
    assert first.best.names == again.best.names
    assert first.best.value == again.best.value
