"""Runs driven the other way than their rows say, on A3 heads of the oracle with play."""

import numpy as np
import pytest
from shipped_models import backlash, leg_thermal

from kernel import a3_plans, warm_head
from kernel.warm_head import turned
from oed.corrected import CorrectedEstimate, EffectReadings
from oed.estimation import identify

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


@pytest.mark.parametrize(("seed", "runs"), [(0, ["80-1"]), (1, [])])
def test_turned_runs_are_named(seed, runs):
    result = corrected(seed, runs).turned_runs()
    if not runs:
        assert result is None
        return
    assert [run for _, run in result.runs] == runs
    assert result.after < 0.75 * result.before
