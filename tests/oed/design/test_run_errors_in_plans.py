"""Errors that a run shares change which plan is best: A3 head, 48 readings of a bar.

Six circles of eight readings against two of twelve, each run twice. The standard deviation
of theta over the workspace follows from the oracle's slopes and dense matrices.
"""

import dataclasses

import numpy as np
import pytest
import sample
from oracles import a3_geometry as a3
from reference import tian_2016 as paper

from kernel import a3_plans
from oed import checks, identifiability
from oed.accuracy import ErrorMaps
from oed.checks import copies
from oed.measurement import Measurement, Series
from oed.units import from_si

NOISE, RUN = 0.5e-6, 1.0e-6
#: circles of each plan: readings, strokes, how often
PLANS = {
    "six circles": (8, tuple(np.linspace(0.0, 0.2, 6)), 1),
    "two circles twice": (12, (0.08, 0.2), 2),
}
#: sd of theta, arcsec, as docs/howto/plan.md states it: without and with run errors
STATED = {"six circles": (1.27, 2.30), "two circles twice": (1.86, 1.86)}


def plan(m: Measurement, name: str) -> Series:
    points, strokes, times = PLANS[name]
    circles = a3_plans.circles(m, points, strokes=strokes).reading_commands()
    command = np.vstack([circles] * times)
    return m.series("cup", command, [f"c{k // points}" for k in range(len(command))])


def theta_sd(maps: ErrorMaps, covariance: np.ndarray) -> float:
    """Root mean square over the workspace, arcsec, after compensation."""
    row = maps.raw[:, maps.names.index("theta")]
    variance = np.einsum("np,pq,nq->n", row, covariance[:24, :24], row)
    return float(from_si(np.sqrt(variance.mean()), "arcsec"))


@pytest.mark.parametrize("name", list(PLANS))
def test_theta_of_both_plans(name):
    m = a3_plans.measurement()
    maps = ErrorMaps.of(m.kinematics, a3_plans.workspace(), "home")
    series = plan(m, name)
    z, psi, theta = series.reading_commands().T
    cup = np.array([0.0, 0.0, paper.TEACH_Z])
    slopes = a3.bar_rows(z, psi, theta, cup) * m.tolerance
    same_run = np.asarray(series.run)[:, None] == np.asarray(series.run)
    for run_error, stated in zip((0.0, RUN), STATED[name], strict=True):
        noise = NOISE**2 * np.eye(len(z)) + run_error**2 * same_run
        precision = np.eye(27) + slopes.T @ np.linalg.solve(noise, slopes)
        covariance = np.linalg.inv(precision) * np.outer(m.tolerance, m.tolerance)
        assert theta_sd(maps, covariance) == pytest.approx(stated, abs=0.005)
        assert theta_sd(maps, toolkit(m, series, run_error)) == pytest.approx(
            theta_sd(maps, covariance), rel=2e-3
        )


def toolkit(m: Measurement, series: Series, run_error: float) -> np.ndarray:
    """The covariance by a set-up that states an error of the run."""
    setup = m.setups["cup"]
    channel = dataclasses.replace(
        setup.instrument.channels[0], shared=run_error / NOISE
    )
    instrument = dataclasses.replace(setup.instrument, channels=(channel,))
    noisy = m.with_setups([dataclasses.replace(setup, instrument=instrument)])
    h = identifiability.scaled(noisy, [series], noisy.nominal, "tolerance")
    scale = np.outer(m.tolerance, m.tolerance)
    return identifiability.posterior_covariance(h) * scale


def test_a_study_states_the_error_of_a_run_and_the_step_of_a_display():
    text = sample.changed(
        sample.STUDY, ("length_um = 0.5", "length_um = 0.5\nlength_run_um = 1.0")
    )
    (setup,) = sample.resolved(text).setups.values()
    (channel,) = setup.instrument.channels
    assert setup.sigma == (pytest.approx(0.5e-6),)
    assert channel.shared * setup.sigma[0] == pytest.approx(1.0e-6)
    text = sample.changed(
        sample.STUDY, ("length_um = 0.5", "length_um = 0.5\nlength_resolution_um = 6.0")
    )
    (setup,) = sample.resolved(text).setups.values()
    uniform = 6e-6 * (np.arange(10001) / 10000 - 0.5)
    assert setup.sigma[0] ** 2 == pytest.approx(0.25e-12 + uniform.var(), rel=1e-3)
    error = sample.refused(
        sample.STUDY, ("length_um = 0.5", "length_um = 0.5\nlenght_run_um = 1.0")
    )
    assert "length_run" in error.remedy


def test_a_stated_step_is_no_coarse_column():
    m = a3_plans.measurement()
    series = [a3_plans.circles(m, 10)]
    y = np.round(m.readings(series, m.nominal) + 3e-6 * np.arange(20), 5)
    assert copies.coarse_columns(checks.session_readings(m, series, y))
    setup = m.setups["cup"]
    channel = dataclasses.replace(setup.instrument.channels[0], resolution=1e-5)
    instrument = dataclasses.replace(setup.instrument, channels=(channel,))
    stated = m.with_setups([dataclasses.replace(setup, instrument=instrument)])
    assert not copies.coarse_columns(checks.session_readings(stated, series, y))
