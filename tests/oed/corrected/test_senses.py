"""Runs driven the other way than their rows say, on A3 heads of the oracle with play."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from shipped_models import backlash, leg_thermal

from kernel import a3_plans, warm_head
from kernel.warm_head import turned
from oed import checks
from oed.checks.sentences import contradictions
from oed.corrected import CorrectedEstimate, EffectReadings
from oed.estimation import identify
from oed.measurement import Measurement, Series

EFFECTS = [leg_thermal.effect, backlash.effect]


def corrected(seed: int, runs: list[str]) -> CorrectedEstimate:
    m = a3_plans.measurement()
    rng = np.random.default_rng([seed, 26])
    series, rows = warm_head.planned(m)
    truth = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
    y = warm_head.read(series, rows, truth, rng)
    theta = identify(m, [series], y).theta
    given = EffectReadings(m, (series,), y, turned(rows, runs))
    estimate = given.estimate(EFFECTS, theta, estimate_noise=False)
    assert estimate is not None
    return estimate


CASES = [
    (0, ["80-1"]),
    (1, []),
    *(
        pytest.param(seed, runs, marks=pytest.mark.slow)
        for seed in range(2, 8)
        for runs in ([], ["80-1", "200-3"], ["80-0", "200-0", "80-4", "200-5"])
    ),
]


@pytest.mark.parametrize(("seed", "runs"), CASES)
def test_turned_runs_are_named(seed: int, runs: list[str]) -> None:
    result = corrected(seed, runs).turned_runs()
    if not runs:
        assert result is None
        return
    assert [run for _, run in result.runs] == runs
    assert result.after < 0.75 * result.before


@pytest.mark.slow
def test_half_of_the_runs_are_named_or_the_other_half() -> None:
    """Which half is wrong cannot be known: the sign of the play is free."""
    _, rows = warm_head.planned(a3_plans.measurement())
    names = list(dict.fromkeys(rows["run"]))
    back = [name for name in names if int(name[-1]) % 2]
    result = corrected(9, back).turned_runs()
    runs = {run for _, run in result.runs}
    assert runs in (set(back), set(names) - set(back))


# -- order and direction ---------------------------------------------------------------


def session(
    m: Measurement, series: Series, rows: pd.DataFrame
) -> checks.SessionReadings:
    return checks.session_readings(m, [series], np.zeros(len(rows)), rows)


@pytest.fixture(scope="module")
def planned() -> tuple[Measurement, Series, pd.DataFrame]:
    m = a3_plans.measurement()
    return (m, *warm_head.planned(m))


def test_order_and_direction_go_together(
    planned: tuple[Measurement, Series, pd.DataFrame],
) -> None:
    assert not contradictions(session(*planned))
    m, series, rows = planned
    assert not contradictions(session(m, series, rows.drop(columns="direction")))
    outlined = dataclasses.replace(session(*planned)).without([3, 40, 41])
    assert not contradictions(outlined)


def test_a_wrong_direction_contradicts_every_run_of_the_same_circle(
    planned: tuple[Measurement, Series, pd.DataFrame],
) -> None:
    m, series, rows = planned
    wrong = np.where(rows["run"] == "80-1", 1, rows["direction"])
    pairs = contradictions(session(m, series, rows.assign(direction=wrong)))
    assert len(pairs) == 5
    assert all("80-1" in pair.runs for pair in pairs)
    assert {pair.same_order for pair in pairs} == {True, False}


def test_rows_sorted_by_angle_are_found(
    planned: tuple[Measurement, Series, pd.DataFrame],
) -> None:
    """Runs both ways, written in the order of the angle: the order is not that of
    travel.
    """
    m, series, rows = planned
    backward = [r for r in dict.fromkeys(rows["run"]) if int(r[-1]) % 2]
    found = contradictions(session(m, series, turned(rows, backward)))
    assert len(found) == 2 * 3 * 3
    assert all(pair.same_order for pair in found)
