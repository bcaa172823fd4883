"""Readings taken again: what differs between them, and errors that recur at each pose."""

import numpy as np
import pandas as pd
import pytest
from scipy import integrate, stats
from shipped_models import encoder_scale, planar_2dof, pose_tracker

from kernel.laws import STATED_LAW
from oed import Measurement, mount
from oed.effect_model import UNKNOWN_SIZES
from oed.gap import diagnose, prepare
from oed.gap.cause.scatter import Energies, replicates, shape
from oed.gap.data.diagnosis import AGAIN, ON_THE_SPOT

effect = encoder_scale.effect
position = pose_tracker.position
machine = planar_2dof.machine

SIGMA = 10e-6
POSES, TIMES = 15, 3


def problem(recurring, *, on_the_spot, loud_run=1.0, seed=3):
    """Of poses at random read three times, with errors that recur, in noise units."""
    rng = np.random.default_rng(seed)
    measurement = Measurement(machine, [mount(position, "tracker", sigma=(SIGMA,) * 3)])
    poses = np.column_stack(
        [rng.uniform(-1.2, 1.2, 2 * POSES), rng.uniform(0.2, 1.3, 2 * POSES)]
    )
    errors = recurring * SIGMA * rng.standard_normal((2 * POSES, 3))
    once = np.arange(2 * POSES)
    numbers = np.repeat(once, TIMES) if on_the_spot else np.tile(once, TIMES)
    runs = np.repeat([str(k) for k in range(6)], POSES)
    series = measurement.series("tracker", poses[numbers], runs)
    noise = SIGMA * rng.standard_normal((len(numbers), 3))
    noise[runs == "4"] *= loud_run
    y = measurement.readings([series], measurement.nominal)
    y = y + (errors[numbers] + noise).ravel()
    order = np.tile(np.arange(1, POSES + 1), 6)
    covariates = pd.DataFrame({"setup": "tracker", "run": runs, "order": order})
    return prepare(measurement, [series], y, covariates)


def test_what_differs_between_readings_taken_again_is_the_variance_within_poses():
    of = problem(3.0, on_the_spot=False)
    again = replicates(of)
    assert not again.on_the_spot
    energy, freedom = again.energy(of, STATED_LAW)
    by_pose = of.residual.reshape(TIMES, 2 * POSES, 3)
    expected = ((by_pose - by_pose.mean(axis=0)) ** 2).sum()
    assert energy == pytest.approx(expected, rel=1e-9)
    assert freedom == (TIMES - 1) * 2 * POSES * 3


def test_long_sessions_count_some_of_their_poses(monkeypatch):
    of = problem(3.0, on_the_spot=False)
    monkeypatch.setattr("oed.gap.cause.scatter.MAX_POSES", 20)
    again = replicates(of)
    _, freedom = again.energy(of, STATED_LAW)
    assert len(again.rows) == TIMES * 20
    assert freedom == (TIMES - 1) * 20


def test_the_evidence_of_what_recurs_is_the_integral_over_the_noise_level():
    parts = Energies(18.0, 20, 60.0, 30)

    def density(variance: float, inflation: float) -> float:
        prior = stats.invgamma.pdf(variance, 2.0, scale=2.0)
        pure = stats.chi2.pdf(parts.pure / variance, parts.pure_freedom)
        of_rest = inflation * variance
        rest = stats.chi2.pdf(parts.rest / of_rest, parts.rest_freedom)
        return float(prior * pure / variance * rest / of_rest)

    none = integrate.quad(density, 0.05, 20.0, args=(1.0,))[0]
    prior = np.exp(UNKNOWN_SIZES.log_visible_shares(np.array([30.0])))[0]
    rough = sum(
        share * integrate.quad(density, 0.05, 20.0, args=(1.0 + size**2,))[0]
        for size, share in zip(UNKNOWN_SIZES.values, prior, strict=True)
        if share > 0.0
    )
    assert parts.log_evidence == pytest.approx(np.log(rough / none), rel=1e-4)


@pytest.mark.parametrize(("on_the_spot", "against", "words"), [
    (False, AGAIN, "what recurs in runs"),
    (True, ON_THE_SPOT, "take the same run again"),
])  # fmt: skip
def test_errors_that_recur_at_each_pose_are_no_noise(on_the_spot, against, words):
    of = problem(1.2, on_the_spot=on_the_spot)
    result = diagnose(of, [effect], np.random.default_rng(1))
    assert result.verdict == "scatter"
    assert result.scatter.against == against
    expected = np.sqrt(1.0 + TIMES * 1.2**2)
    assert result.scatter.factor == pytest.approx(expected, rel=0.2)
    assert words in result.next[0]


def test_the_same_scatter_without_a_recurring_part_is_noise():
    of = problem(0.0, on_the_spot=False)
    assert diagnose(of, [effect], np.random.default_rng(1)).verdict == "none"


def test_a_run_that_scatters_more_is_named():
    of = problem(0.0, on_the_spot=False, loud_run=2.5)
    assert shape(of, STATED_LAW) == "run 4"
    assert shape(problem(0.0, on_the_spot=False), STATED_LAW) == "white"
