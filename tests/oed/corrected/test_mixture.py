"""Parameters and effects together: the mixture over answers, readings row by row."""

import numpy as np
import pytest
from scipy import optimize, special
from shipped_models import backlash, planar_2dof, pose_tracker

from kernel.answer_mixture import EFFECTS, case, readings
from oed.corrected import AnswerFits
from oed.corrected.fit import MeasurementWithEffects
from oed.estimation import identify
from oed.gap import AnswerContent
from oed.instrument import TakenReadings, mount
from oed.measurement import Measurement
from oed.result import AnswerRecord

__all__ = ["case"]  # fixtures


def test_mean_and_covariance_are_those_of_the_dense_mixture(case):
    means = np.array([a.mean for a in case.answers])
    mean = case.shares @ means
    free = case.mixture.answers[0].covariance.diagonal() > 0.0
    covariance = sum(
        share * (a.covariance + np.outer(a.mean - mean, a.mean - mean))
        for share, a in zip(case.shares, case.answers, strict=True)
    )
    sd = np.sqrt(np.diag(covariance))
    assert np.abs((case.mixture.mean - mean)[free] / sd[free]).max() < 1e-4
    unit = np.outer(sd, sd)[np.ix_(free, free)]
    difference = (case.mixture.covariance - covariance)[np.ix_(free, free)]
    assert np.abs(difference / unit).max() < 1e-4
    # the answers disagree: a part of the variance is between them
    within = case.shares @ [np.diag(a.covariance) for a in case.answers]
    assert (within[free] < 0.97 * sd[free] ** 2).any()


def mixture_quantile(level, shares, means, sds):
    """Quantile of a mixture of normals, by bisection."""

    def excess(x: float) -> float:
        return float(shares @ special.ndtr((x - means) / sds)) - level

    reach = 9.0 * sds.max()
    low, high = means.min() - reach, means.max() + reach
    return float(optimize.brentq(excess, low, high, xtol=1e-15))


def test_intervals_are_quantiles_of_the_dense_mixture(case):
    levels = (0.025, 0.5, 0.975)
    quantiles = case.mixture.quantiles(levels)
    sd = np.sqrt(np.diag(case.mixture.covariance))
    for k in np.flatnonzero(sd):
        means = np.array([a.mean[k] for a in case.answers])
        sds = np.sqrt([a.covariance[k, k] for a in case.answers])
        for row, level in enumerate(levels):
            exact = mixture_quantile(level, case.shares, means, sds)
            assert abs(quantiles[row, k] - exact) < 0.12 * sd[k]


def test_draws_have_the_shares_and_the_moments_of_the_mixture(case):
    drawn = case.mixture.draw(np.random.default_rng(2), 3000)
    counts = np.bincount(drawn.answer, minlength=3) / 3000
    assert counts == pytest.approx(case.mixture.shares, abs=1e-3)
    sd = np.sqrt(np.diag(case.mixture.covariance))
    free = sd > 0.0
    off = (drawn.theta.mean(axis=0) - case.mixture.mean)[free] / sd[free]
    assert np.abs(off).max() < 0.1
    assert drawn.theta.std(axis=0)[free] == pytest.approx(sd[free], rel=0.08)
    # an answer's effects act in its draws alone
    names = np.array(drawn.columns.discrepancy.names)[drawn.columns.discrepancy.group]
    for number, effect in enumerate(EFFECTS, start=1):
        of_effect = np.char.startswith(names, effect.name)
        acts = drawn.coefficients[:, of_effect].any(axis=1)
        assert (acts == (drawn.answer == number)).all()


def test_an_answer_below_the_least_share_is_left_out_and_said(case):
    given = readings()
    plain = identify(given.measurement, given.series, given.y)
    records = [AnswerRecord((), 0.99), AnswerRecord(("backlash",), 0.01)]
    forms = [
        AnswerContent({}, unknown=False),
        AnswerContent({"backlash": backlash.effect.constant_grid()[0]}, unknown=False),
    ]
    fits = AnswerFits(
        given, EFFECTS, None, estimate_noise=False, rng=np.random.default_rng(1)
    )
    mixture = fits.fit(records, forms, plain)
    assert len(mixture.answers) == 1
    assert mixture.rest == pytest.approx(0.01)
    assert mixture.mean == pytest.approx(plain.theta)


def test_without_an_answer_that_is_likely_enough_there_is_no_mixture():
    """Not one that takes no gap for sure."""
    given = readings()
    plain = identify(given.measurement, given.series, given.y)
    fits = AnswerFits(
        given, EFFECTS, None, estimate_noise=False, rng=np.random.default_rng(1)
    )
    forms = [AnswerContent({}, unknown=False)]
    assert fits.fit([AnswerRecord((), 0.01)], forms, plain) is None


position = pose_tracker.position

SIZES = np.array([2e-6, 5e-6])
BASE = Measurement(planar_2dof.machine, [mount(position, "tracker")])
SERIES = BASE.series(
    "tracker", np.array([[0.0, 0.5], [1.0, 0.5], [-0.7, 1.0], [0.3, 0.2]])
)
N = len(BASE.readings([SERIES], BASE.nominal))
_rng = np.random.default_rng(3)
COLUMNS, OFFSET = _rng.standard_normal((N, 2)), 1e-6 * _rng.standard_normal(N)
BOTH = MeasurementWithEffects(
    BASE, [SERIES], ["play: leg 1", "play: leg 2"], SIZES, COLUMNS, OFFSET
)


def theta(rng: np.random.Generator) -> np.ndarray:
    of_base = BASE.nominal + BASE.tolerance * rng.standard_normal(len(BASE.nominal))
    return np.append(of_base, SIZES * rng.standard_normal(2))


def test_readings_are_the_machines_plus_the_effects(rng):
    point = theta(rng)
    expected = BASE.readings([SERIES], point[:-2]) + COLUMNS @ point[-2:] + OFFSET
    assert BOTH.readings([SERIES], point) == pytest.approx(expected, abs=1e-12)
    assert [p.name for p in BOTH.parameters[-2:]] == ["play: leg 1", "play: leg 2"]
    assert BOTH.tolerance[-2:] == pytest.approx(SIZES)


def test_slopes_are_differences_of_readings(rng):
    point, step = theta(rng), 1e-6
    slopes = BOTH.jacobian([SERIES], point)
    for k, change in enumerate(step * np.eye(len(point))):
        ahead = BOTH.readings([SERIES], point + change)
        behind = BOTH.readings([SERIES], point - change)
        expected = (ahead - behind) / (2.0 * step)
        assert slopes[:, k] == pytest.approx(expected, abs=1e-7)


def test_some_readings_have_their_rows(rng):
    rows, point = np.array([0, 2]), theta(rng)
    part = SERIES.take(rows)
    some = BOTH.taken_measurement([TakenReadings(SERIES, part, rows)])
    channels = N // len(SERIES)
    values = (rows[:, None] * channels + np.arange(channels)).ravel()
    every = BOTH.readings([SERIES], point)
    assert some.readings([part], point) == pytest.approx(every[values], abs=1e-12)


def test_a_coefficient_is_as_long_as_its_change_of_the_readings():
    expected = SIZES * np.sqrt((COLUMNS**2).mean(axis=0))
    assert BOTH.length_factors[-2:] == pytest.approx(expected)
