"""The test of a noise law's weights, and runs predicted from others, against dense matrices."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from kernel import a3_plans, bar_circles
from kernel.dense_noise import dense_covariance
from oed.estimation import identify, predict_runs
from oed.estimation.law_stage import P_CONTRADICTED, check_law
from oed.measurement import Measurement, Series, draw_readings
from oed.noise import Laws, ReadingStructure


@pytest.fixture(scope="module")
def structure() -> ReadingStructure:
    """Three runs of a ball bar."""
    return bar_circles.circles(12)


@pytest.fixture(scope="module")
def law(structure: ReadingStructure) -> Laws:
    """Most of the noise is carried along, and each run has a level."""
    groups = len(structure.names)
    one = np.ones(1)
    return Laws(np.full((1, groups), 1.5), 0.7 * one, 5.0 * one, 0.8 * one, 0.3 * one)


def test_the_covariance_of_sums_is_that_of_a_dense_matrix(structure, law):
    values = np.random.default_rng(1).standard_normal((len(structure), 4))
    exact = values.T @ dense_covariance(structure, law) @ values
    assert law.errors(structure).covariance_of(values) == pytest.approx(exact)


def test_the_ratio_and_the_widening_are_those_of_dense_matrices(structure, law):
    rng = np.random.default_rng(2)
    slopes = 2.0 * rng.standard_normal((len(structure), 6))
    residual = 3.0 * rng.standard_normal(len(structure))
    c = dense_covariance(structure, law)
    none = np.zeros(1)
    d = dense_covariance(
        structure, dataclasses.replace(law, correlated=none, level=none)
    )
    d *= 1.0 + law.level**2
    by_d = np.linalg.solve(np.eye(6) + slopes.T @ np.linalg.inv(d) @ slopes, slopes.T)
    by_c = np.linalg.solve(np.eye(6) + slopes.T @ np.linalg.inv(c) @ slopes, slopes.T)
    gain = by_d @ np.linalg.inv(d)
    gain_c = by_c @ np.linalg.inv(c)
    fit = np.linalg.cholesky(np.linalg.inv(d)).T @ slopes
    z = (gain - gain_c) @ residual

    def scatter(k: np.ndarray) -> np.ndarray:
        prior = np.eye(6) - k @ slopes
        return k @ c @ k.T + prior @ prior.T

    expected = np.trace(fit @ (scatter(gain) - scatter(gain_c)) @ fit.T)
    check = check_law(structure, law, residual, slopes)
    assert check.ratio == pytest.approx(np.sum((fit @ z) ** 2) / expected, rel=1e-6)
    t = dense_covariance(structure, Laws.stated(structure))
    information = slopes.T @ np.linalg.solve(t, slopes)
    least_squares = np.linalg.solve(information, np.linalg.solve(t, slopes).T)
    variances = least_squares @ c @ least_squares.T @ information
    assert check.widening == pytest.approx(np.sqrt(np.trace(variances) / 6))


def test_readings_of_the_law_are_rarely_contradicted(structure, law):
    rng = np.random.default_rng(3)
    slopes = 2.0 * rng.standard_normal((len(structure), 6))
    root = np.linalg.cholesky(dense_covariance(structure, law))
    count, contradicted = 300, 0
    for _ in range(count):
        errors = root @ rng.standard_normal(len(structure))
        residual = slopes @ rng.standard_normal(6) + errors
        contradicted += check_law(structure, law, residual, slopes).is_contradicted
    rate = stats.binomtest(contradicted, count).proportion_ci(0.999)
    assert rate.low < P_CONTRADICTED < rate.high


def test_noise_of_single_readings_leaves_nothing_to_test(structure, law):
    none = np.zeros(1)
    alone = dataclasses.replace(law, correlated=none, level=none, seat=none)
    slopes = np.random.default_rng(4).standard_normal((len(structure), 6))
    check = check_law(structure, alone, slopes[:, 0], slopes)
    assert not check.is_contradicted
    assert check.widening == pytest.approx(float(law.scale[0, 0]), rel=0.2)


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
