"""Readings taken again, readings that scatter, and effects that readings can test."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy import integrate, stats
from shipped_models import encoder_scale, planar_2dof, pose_tracker

from kernel.laws import STATED_LAW
from oed import Measurement, mount
from oed.effect_model import UNKNOWN_SIZES
from oed.gap import GapProblem, diagnose, prepare
from oed.gap.cause.scatter import Energies, replicates, shape
from oed.gap.data.diagnosis import AGAIN, ON_THE_SPOT, Diagnosis
from oed.gap.forms import library
from oed.measurement import draw_parameters, draw_readings

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


def diagnosis(factor: float, *, assumed: bool = False) -> Diagnosis:
    """Of 48 poses whose readings scatter a factor of the stated noise, without effects."""
    setup = mount(position, "tracker", sigma=(SIGMA,) * 3)
    statement = dataclasses.replace(setup.statement, is_assumed=assumed)
    setup = dataclasses.replace(setup, statement=statement)
    measurement = Measurement(machine, [setup])
    y, z = np.meshgrid(np.linspace(-1.2, 1.2, 8), np.linspace(0.2, 1.3, 6))
    runs = np.repeat([str(k) for k in range(6)], 8)
    command = np.column_stack([y.ravel(), z.ravel()])
    series = measurement.series("tracker", command, runs)
    rng = np.random.default_rng(7)
    noise = factor * SIGMA * rng.standard_normal(3 * len(command))
    readings = measurement.readings([series], measurement.nominal) + noise
    order = np.tile(np.arange(1, 9), 6)
    rows = {"setup": "tracker", "run": runs, "order": order, "direction": 1}
    covariates = pd.DataFrame(rows)
    problem = prepare(measurement, [series], readings, covariates)
    return diagnose(problem, [effect], rng)


def test_scatter_that_a_data_sheet_is_good_for_is_noise():
    result = diagnosis(1.3)
    assert result.verdict == "none"
    assert result.scatter is None
    assert "compensate the geometry" in result.next[0]


def test_more_scatter_is_reported_with_its_factor_and_no_go_ahead():
    result = diagnosis(3.0)
    assert result.verdict == "scatter"
    assert result.scatter.factor == pytest.approx(3.0, rel=0.2)
    assert result.next[0].startswith("Do not compensate yet: read some poses several")
    assert result.where == ()


def test_an_assumed_noise_is_no_data_sheet():
    assert diagnosis(3.0, assumed=True).verdict == "none"


def grid_problem(noise: float) -> GapProblem:
    sigma = np.full(3, noise)
    measurement = Measurement(machine, [mount(position, "tracker", sigma=sigma)])
    y, z = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    series = measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    rng = np.random.default_rng(1)
    truth = draw_parameters(measurement, rng)
    readings = draw_readings(measurement, [series], truth, rng)
    covariates = pd.DataFrame(
        {"setup": "tracker", "run": "1", "order": np.arange(25), "direction": 1}
    )
    return prepare(measurement, [series], readings, covariates)


@pytest.mark.parametrize(("norm", "tested"), [(3.0, True), (0.1, True), (0.003, False)])
def test_an_effect_is_tested_where_its_usual_sizes_show(norm, tested):
    """By the norm over all readings of what it changes at its expected size."""
    quiet = grid_problem(1e-6)
    (constants,) = effect.constant_grid()
    columns = quiet.signature(effect, constants).columns
    noise = float(np.linalg.norm(columns)) / norm
    built = library.build(grid_problem(noise), [effect])
    assert (effect.name not in built.not_testable) == tested
