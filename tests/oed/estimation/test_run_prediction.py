"""Runs predicted from the others, and predictive checks, against dense matrices."""

import numpy as np
import pytest

from kernel import a3_plans
from oed.estimation import identify, predict_runs
from oed.measurement import Measurement, Series, draw_readings

Problem = tuple[Measurement, list[Series], np.ndarray]
POINTS, STROKES = 10, (0.02, 0.08, 0.14, 0.2)


def problem(seed: int) -> Problem:
    """Four circles of an A3 head, a run each."""
    m = a3_plans.measurement()
    circles = a3_plans.circles(m, POINTS, strokes=STROKES)
    runs = [f"c{k // POINTS}" for k in range(len(circles))]
    series = [m.series("cup", circles.reading_commands(), runs)]
    rng = np.random.default_rng([seed, 4])
    truth = m.nominal + 0.1 * m.tolerance * rng.standard_normal(len(m.nominal))
    return m, series, draw_readings(m, series, truth, rng)


@pytest.mark.parametrize("estimate_noise", [False, True])
def test_a_run_is_predicted_as_by_conditional_normal_laws(estimate_noise):
    m, series, y = problem(0)
    estimate = identify(m, series, y, estimate_noise=estimate_noise)
    h = m.jacobian(series, estimate.theta)
    whole = np.linalg.inv(estimate.noise.whiten(np.eye(len(y))))
    spread = whole @ whole.T + (h * m.tolerance**2) @ h.T
    noise = np.linalg.inv(estimate.noise.split_common()[0].whiten(np.eye(len(y))))
    noise = noise @ noise.T
    taken = y if estimate.robust_readings is None else estimate.robust_readings
    linear = m.readings(series, estimate.theta) - h @ (estimate.theta - m.nominal)
    result = predict_runs(m, series, estimate)
    assert [one.run for one in result.runs] == ["c0", "c1", "c2", "c3"]
    r = taken - linear
    for k, one in enumerate(result.runs):
        b = np.arange(k * POINTS, (k + 1) * POINTS)
        a = np.setdiff1d(np.arange(len(y)), b)
        gain = np.linalg.solve(spread[np.ix_(a, a)], spread[np.ix_(a, b)]).T
        error = r[b] - gain @ r[a]
        covariance = spread[np.ix_(b, b)] - gain @ spread[np.ix_(a, b)]
        chi2 = error @ np.linalg.solve(covariance, error)
        assert one.chi2 == pytest.approx(chi2, rel=1e-3)
        size = np.linalg.slogdet(covariance)[1]
        unit = np.linalg.slogdet(noise[np.ix_(b, b)])[1]
        density = -0.5 * (POINTS * np.log(2 * np.pi) + size - unit + chi2)
        assert one.log_score == pytest.approx(density, rel=1e-3)
    assert result.log_score == pytest.approx(sum(o.log_score for o in result.runs))


def test_only_a_run_that_does_not_fit_the_others_is_surprising():
    m, series, y = problem(1)
    sound = predict_runs(m, series, identify(m, series, y))
    assert not sound.surprising
    shifted = y + 20e-6 * (np.arange(len(y)) // POINTS == 2)
    result = predict_runs(m, series, identify(m, series, shifted))
    assert "c2" in [one.run for one in result.surprising]
    assert result.log_score < sound.log_score - 50.0


def test_one_run_alone_has_no_others():
    m = a3_plans.measurement()
    series = [a3_plans.circles(m, POINTS)]
    y = m.readings(series, m.nominal)
    assert len(dict.fromkeys(series[0].run)) == 1
    assert predict_runs(m, series, identify(m, series, y)) is None
