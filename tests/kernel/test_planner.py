"""The planner on small catalogues of linear readings, against every plan there is."""

from __future__ import annotations

import numpy as np
import pytest

from kernel import plan_catalogues as small
from oed.planning import bound, search, stage


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("minutes", [12.0, 40.0])
def test_no_plan_beats_the_bound_and_the_planner_finds_nearly_the_best(seed: int, minutes: float) -> None:
    """All sets of readings of at most two of three options, within a budget that binds and one that hardly does."""
    options, goal = small.catalogue(np.random.default_rng(seed), alike=seed % 2 == 0)
    value, time = small.every_plan(options, goal, 2)
    within = (time > 0.0) & (time <= 60.0 * minutes)
    assert within.any()
    best = float(value[within].min())
    found = search.plan(options, goal, 60.0 * minutes, np.random.default_rng(0), stages=2)
    assert found.bound.value <= best * (1 + 1e-9)
    assert found.most_accurate.value >= best * (1 - 1e-9)
    # readings of unequal length are chosen for what they tell, not for their time
    assert found.most_accurate.value <= (1.03 if seed % 2 == 0 else 1.4) * best
    assert found.most_accurate.seconds <= 60.0 * minutes * (1 + 1e-9)


def test_the_bound_is_the_relaxation_of_the_only_combination() -> None:
    """One option whose readings can all be taken: the bound is its plan of all readings."""
    options, goal = small.catalogue(np.random.default_rng(3), options=1)
    value, _ = small.every_plan(options, goal, 1)
    told = bound.bound(options, goal, np.eye(3), 1e6, 1, known=float(value.min()), loss=1e-4)
    assert told.value <= value.min() * (1 + 1e-9)
    assert told.value == pytest.approx(value.min(), rel=0.1)  # at most four of the five readings are taken


def test_stages_without_travel_add_up_in_any_order(rng: np.random.Generator) -> None:
    """Covariance after two stages, by the joint inverse of machine and both options' own unknowns."""
    (first, second), _ = small.catalogue(rng, options=2)
    chosen = np.array([0, 2, 3])
    ways = []
    for order in ((first, second), (second, first)):
        covariance = np.eye(3)
        for option in order:
            covariance = stage.told(option, chosen, covariance, rng, exact=False).covariance
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
    option = small.option("o", rows, 3, counts=(3,), mounting=1.0, seconds=np.ones(6), travel=1.2)
    covariance = np.diag([1.0, 0.3, 0.1])
    told = stage.available(option, covariance)
    errors = rng.standard_normal((200_000, 4)) * np.sqrt(np.array([1.0, 0.3, 0.1, 1.0]))
    assert told == pytest.approx((np.abs(errors @ rows.T) <= 1.2).mean(axis=0), abs=4e-3)
    assert (stage.available(option, np.zeros((3, 3))) >= told - 1e-12).all()


def test_a_rough_stage_comes_first_only_where_travel_asks_for_it() -> None:
    """A fine option of little range and a rough one of any: errors far beyond the range want the rough one first."""
    rng = np.random.default_rng(1)
    fine, coarse = 300.0 * rng.standard_normal((12, 3)), 20.0 * rng.standard_normal((12, 3))

    def planned(travel: float) -> tuple[str, ...]:
        options = [
            small.option("fine", fine, 3, counts=(4, 8), mounting=600.0, seconds=np.full(12, 10.0), travel=travel),
            small.option("rough", coarse, 3, counts=(4, 8), mounting=600.0, seconds=np.full(12, 10.0)),
        ]
        goal = small.Goal(("a", "b", "c"), np.eye(3)[:, None, :], np.ones(3), wanted=False)
        return search.plan(options, goal, 1500.0, np.random.default_rng(0), stages=2).best.names

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
    first, again = (search.plan(options, goal, 2000.0, np.random.default_rng(3), stages=2) for _ in range(2))
    assert first.best.names == again.best.names
    assert first.best.value == again.best.value
