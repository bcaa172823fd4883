"""The bound over all combinations of measurements against all plans of small
catalogues.
"""

import numpy as np
import pytest

from kernel import plan_catalogues as catalogues
from oed.planning import bound as bounding
from oed.planning import stage as staging
from oed.planning.goal import Goal
from oed.planning.known import Known, known
from oed.planning.option import Option


def bounded(
    options: list[Option], goal: Goal, budget: float, known: float, most: int = 3
) -> bounding.Bounded:
    return bounding.bound(
        options, goal, np.eye(goal.factors.shape[2]), budget, most, known
    )


@pytest.mark.parametrize("alike", [True, False])
def test_no_plan_of_thirty_catalogues_is_below_the_bound(alike: bool) -> None:
    """All sets of readings, under budgets that bind and that do not, of two stages and
    of three.
    """
    gaps, closed = [], 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        options, goal = catalogues.catalogue(rng, alike=alike)
        most = 2 + seed % 2
        value, time = catalogues.every_plan(options, goal, most)
        budget = 1e5 if seed % 5 == 0 else float(rng.uniform(900.0, 2500.0))
        best = value[(time > 0.0) & (time <= budget)].min()
        told = bounded(options, goal, budget, best, most)
        gaps.append(best / told.value - 1.0)
        closed += told.closed
        assert told.closed == (gaps[-1] <= 0.05 + 1e-9)
    assert min(gaps) >= 0.0
    assert closed >= 20
    assert np.median(gaps) < 0.03


def test_the_worst_component_is_bounded_as_well() -> None:
    gaps = []
    for seed in range(8):
        rng = np.random.default_rng(100 + seed)
        options, goal = catalogues.catalogue(rng, wanted=True)
        value, time = catalogues.every_plan(options, goal, 3)
        budget = float(rng.uniform(900.0, 2500.0))
        best = value[(time > 0.0) & (time <= budget)].min()
        gaps.append(best / bounded(options, goal, budget, best).value - 1.0)
    assert min(gaps) >= 0.0
    assert np.median(gaps) < 0.05


def test_a_bound_without_a_number_of_readings_to_keep_is_lower() -> None:
    """Where time does not bind, the numbers of readings do."""
    options, goal = catalogues.catalogue(np.random.default_rng(3), size=8)
    few = [
        catalogues.option(
            o.name,
            o.candidates.blocks[:, 0],
            3,
            counts=(2,),
            mounting=o.mounting,
            seconds=o.seconds,
        )
        for o in options
    ]
    value, time = catalogues.every_plan(few, goal, 3)
    best = value[time > 0.0].min()
    told = bounded(few, goal, 1e5, best)
    assert told.value <= best
    assert told.value > 1.1 * bounded(options, goal, 1e5, best).value


def test_readings_lost_to_the_setup_itself_stay_within_the_bound(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A travel as large as what the set-ups' unknowns do: plans told by many machines
    are not below the bound.
    """
    monkeypatch.setattr(staging, "ROUGH", 1000)
    for seed in range(10):
        rng = np.random.default_rng(200 + seed)
        options, goal = catalogues.catalogue(rng)
        short = [
            catalogues.option(
                o.name,
                o.candidates.blocks[:, 0],
                3,
                counts=o.counts,
                mounting=o.mounting,
                seconds=o.seconds,
                travel=30.0,
            )
            for o in options
        ]
        before: np.ndarray | Known = np.eye(3)
        for o in short:
            chosen = rng.permutation(len(o.candidates))[: o.counts[-1]]
            before = staging.told(o, chosen, before, rng, exact=False).known
        value = goal.value(known(before).square)
        assert bounded(short, goal, 1e5, value).value <= value


def test_too_many_combinations_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    options, goal = catalogues.catalogue(np.random.default_rng(0))
    monkeypatch.setattr(bounding, "COMBINATIONS", 3)
    with pytest.raises(
        ValueError, match="7 combinations of 3 of 3 measurements are too many"
    ):
        bounded(options, goal, 1e5, 1.0)


def test_hopeful_combinations_fit_the_budget_and_could_be_better() -> None:
    options, goal = catalogues.catalogue(np.random.default_rng(5))
    value, time = catalogues.every_plan(options, goal, 3)
    budget = 1500.0
    worst = value[(time > 0.0) & (time <= budget)].min() * 1.3
    told = bounded(options, goal, budget, worst)
    assert told.hopeful
    for some in told.hopeful:
        spent = sum(
            options[s].mounting + n * options[s].seconds[0] for s, n in some.items()
        )
        assert spent <= budget * 1.001
