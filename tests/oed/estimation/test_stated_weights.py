"""What no noise law explains widens intervals, and moves no value."""

import numpy as np
import pytest
from shipped_models import planar_2dof, pose_tracker

from oed import Measurement, mount
from oed.estimation import identify, law_stage
from oed.estimation.fit_stages import ReadingsFit, last_stage
from oed.measurement import draw_parameters, draw_readings
from oed.posterior import LogDensity

position = pose_tracker.position
machine = planar_2dof.machine

MEASUREMENT = Measurement(machine, [mount(position, "tracker")])
ACROSS, UP = np.meshgrid(np.linspace(-1.2, 1.2, 9), np.linspace(0.2, 1.3, 8))
SERIES = [MEASUREMENT.series("tracker", np.column_stack([ACROSS.ravel(), UP.ravel()]))]


def readings_with_wave(amplitude: float) -> np.ndarray:
    """Readings with a smooth error over the workspace, in stated standard deviations."""
    rng = np.random.default_rng(1)
    truth = draw_parameters(MEASUREMENT, rng)
    y = draw_readings(MEASUREMENT, SERIES, truth, rng)
    place = np.repeat((ACROSS + UP).ravel(), len(y) // ACROSS.size)
    return y + amplitude * MEASUREMENT.sigma(SERIES) * np.sin(3.0 * place)


@pytest.fixture
def contradicted(monkeypatch):
    """Every noise law is contradicted, so that readings have their stated weights."""
    monkeypatch.setattr(law_stage, "P_CONTRADICTED", 2.0)


def determined_covariance(estimate):
    """Covariance of the combinations that the readings determine, in stated tolerances."""
    dual = identify(MEASUREMENT, SERIES, readings_with_wave(0.0)).coordinates.dual
    return dual @ estimate.covariance @ dual.T


@pytest.mark.usefixtures("contradicted")
@pytest.mark.parametrize("amplitude", [5.0, 100.0])
def test_doubt_of_the_noise_widens_intervals_and_moves_no_value(amplitude):
    y = readings_with_wave(amplitude)
    doubted = identify(MEASUREMENT, SERIES, y, estimate_noise=True)
    stated = identify(MEASUREMENT, SERIES, y)
    moved = (doubted.theta - stated.theta)[MEASUREMENT.free]
    assert np.abs(moved / stated.sd[MEASUREMENT.free]).max() < 1e-3
    assert any("stated weights" in warning for warning in doubted.warnings)
    assert doubted.scatter == pytest.approx(np.sqrt(doubted.chi2 / doubted.dof))
    factor = doubted.law_check.widening
    assert factor > 0.5 * np.sqrt(stated.chi2 / stated.dof)
    wider, alone = (np.diag(determined_covariance(e)) for e in (doubted, stated))
    assert np.allclose(np.sqrt(wider / alone), factor, rtol=0.02)
    # what readings tell of a parameter is no matter of the widening
    assert np.allclose(doubted.shrinkage, stated.shrinkage, atol=0.02)


@pytest.mark.usefixtures("contradicted")
def test_sampled_density_has_the_widened_covariance():
    y = readings_with_wave(20.0)
    estimate = identify(MEASUREMENT, SERIES, y, estimate_noise=True)
    density = LogDensity(MEASUREMENT, SERIES, y, estimate)
    dual = estimate.coordinates.dual
    expected = dual @ estimate.covariance @ dual.T
    assert np.allclose(density.root @ density.root.T, expected, rtol=1e-6, atol=1e-12)


def test_noise_as_stated_has_its_law():
    estimate = identify(
        MEASUREMENT, SERIES, readings_with_wave(0.0), estimate_noise=True
    )
    assert not estimate.law_check.is_contradicted
    assert estimate.noise_posterior is not None
    assert estimate.scatter == 1.0


def test_a_law_that_does_not_settle_says_so(monkeypatch):
    stated, y = MEASUREMENT.noise(SERIES), readings_with_wave(0.0)
    fit = ReadingsFit(MEASUREMENT, SERIES, y, stated, 100)
    first = last_stage(fit, MEASUREMENT.nominal, ("*",))
    structure, prior = law_stage.structure_and_prior(fit, first)
    assert law_stage.settle_law(fit, first, structure, prior).has_settled
    monkeypatch.setattr(law_stage, "MAX_ROUNDS", 1)
    assert not law_stage.settle_law(fit, first, structure, prior).has_settled
