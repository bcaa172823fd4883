"""Odds of gross errors against quadrature, and what a design's freedom lets them prove."""

import numpy as np
import pytest
from scipy import integrate, stats

from oed.checks import outlier_odds
from oed.checks.outlier_odds import (
    GROSS_ODDS,
    GROSS_SCALE,
    LOCATED_ODDS,
    LeaveOneOut,
    OutlierOdds,
)
from oed.noise import Noise

READINGS, UNKNOWNS = 30, 5


def precision(slopes: np.ndarray) -> np.ndarray:
    """Inverse (N, N) of the covariance of residuals, of unit noise and tolerances."""
    return np.asarray(np.linalg.inv(np.eye(len(slopes)) + slopes @ slopes.T))


def odds_of(slopes, residual, student=None):
    """Of readings of one value each, of unit noise."""
    p = precision(slopes)
    values, vectors = np.linalg.eigh(np.eye(len(p)) - p)
    factor = vectors * np.sqrt(np.maximum(values, 0.0))
    noise, reading = Noise(np.ones(len(p))), np.arange(len(p), dtype=np.intp)
    gradient, diagonal = p @ residual, np.diag(p).copy()
    return OutlierOdds(LeaveOneOut(gradient, diagonal, factor, noise, reading), student)


def session(seed: int, sizes: dict[int, float]) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of wide tolerances, and residuals with gross errors in sigma."""
    rng = np.random.default_rng([41, seed])
    slopes = 100.0 * rng.standard_normal((READINGS, UNKNOWNS))
    residual = slopes @ rng.standard_normal(UNKNOWNS) + rng.standard_normal(READINGS)
    for place, size in sizes.items():
        residual[place] += size
    return slopes, residual


@pytest.mark.parametrize("size", [0.0, 4.0, 12.0])
def test_a_shift_weighs_what_quadrature_of_its_prior_gives(size):
    slopes, residual = session(1, {3: size})
    p = precision(slopes)
    covariance = np.eye(READINGS) + slopes @ slopes.T
    law = stats.multivariate_normal(np.zeros(READINGS), covariance)
    unit = np.eye(READINGS)[3]
    middle = float((p @ residual)[3] / p[3, 3])

    def density(shift: float) -> float:
        ratio = law.logpdf(residual - shift * unit) - law.logpdf(residual)
        return float(np.exp(ratio) * stats.cauchy.pdf(shift, scale=GROSS_SCALE))

    expected, _ = integrate.quad(density, middle - 60.0, middle + 60.0, points=[middle])
    weights = outlier_odds.log_weights_of_shifts(
        p @ residual, np.diag(p), np.ones(READINGS)
    )
    assert weights[3] == pytest.approx(np.log(expected), abs=1e-3)


def test_with_one_degree_of_freedom_no_reading_is_located():
    """The residual has one direction: every single shift explains it equally."""
    rng = np.random.default_rng(5)
    slopes = 1e4 * rng.standard_normal((7, 6))
    residual = slopes @ rng.standard_normal(6)
    residual[2] += 2000.0
    p = precision(slopes)
    pulls = p @ residual / np.sqrt(np.diag(p))
    assert np.abs(pulls) == pytest.approx(np.abs(pulls[2]), rel=1e-2)
    assert abs(pulls[2]) > 7.0
    asked = odds_of(slopes, residual)
    assert asked.location_odds([2])[2] < np.log(1.0)
    assert set(asked.rivals([2], 2)) == set(range(7))


@pytest.mark.parametrize("places", [(4,), (4, 11), (4, 11, 20), (1, 4, 9, 11, 20)])
def test_redundant_readings_locate_gross_errors(places):
    signs = (1, -1, -1, 1, 1)
    sizes = {k: 20.0 * s for k, s in zip(places, signs, strict=False)}
    slopes, residual = session(2, sizes)
    asked = odds_of(slopes, residual)
    assert min(asked.location_odds(places).values()) > np.log(LOCATED_ODDS)
    assert min(asked.gross_error_odds(places, rest_fits=True).values()) > np.log(
        GROSS_ODDS
    )
    assert asked.rivals(places, places[0]) == (places[0],)


def test_a_sound_reading_is_no_gross_error():
    slopes, residual = session(3, {})
    p = precision(slopes)
    worst = int(np.argmax(np.abs(p @ residual / np.sqrt(np.diag(p)))))
    asked = odds_of(slopes, residual)
    assert asked.gross_error_odds([worst], rest_fits=True)[worst] < 0.0
    assert asked.location_odds([worst])[worst] < np.log(LOCATED_ODDS)


def odds_of_one(errors: np.ndarray, *, student: float | None = None) -> float:
    """Log odds of reading 8, which is off by 15 sigma, beside errors of the others."""
    slopes = 100.0 * np.random.default_rng(6).standard_normal((READINGS, UNKNOWNS))
    residual = errors.copy()
    residual[8] = 15.0
    asked = odds_of(slopes, residual, student)
    return asked.gross_error_odds([8], rest_fits=True)[8]


def test_heavy_tails_of_the_others_make_a_far_reading_noise():
    rng = np.random.default_rng(7)
    normal = [odds_of_one(rng.standard_normal(READINGS)) for _ in range(20)]
    tails = [odds_of_one(rng.standard_t(3.0, READINGS)) for _ in range(20)]
    assert np.median(normal) > np.log(GROSS_ODDS)
    assert np.median(tails) < np.log(GROSS_ODDS)
    errors = rng.standard_normal(READINGS)
    stated = [odds_of_one(errors, student=dof) for dof in (3.0, 6.0, 30.0)]
    assert stated == sorted(stated)


def test_beside_a_misfit_a_moderate_error_proves_nothing():
    slopes, residual = session(5, {})
    residual += 2.0 * np.random.default_rng(8).standard_normal(READINGS)
    residual[8] += 8.0
    residual[15] += 60.0
    asked = odds_of(slopes, residual)
    odds = asked.gross_error_odds([8, 15], rest_fits=False)
    assert odds[8] < np.log(GROSS_ODDS) < odds[15]
