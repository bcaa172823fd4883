"""The test of a noise law's weights: against dense matrices, and its rate of false answers on
readings of the law."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from kernel import bar_circles
from kernel.dense_noise import dense_covariance
from oed.estimation.law_stage import P_CONTRADICTED, check_law
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
