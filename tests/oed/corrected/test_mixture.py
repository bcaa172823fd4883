"""The mixture over a diagnosis' answers, against dense Gaussian algebra.

The reference is written out here: slopes and signatures as matrices, each answer's
evidence, mean and covariance in closed form, and quantiles by bisection of the mixture's
distribution.
"""

import numpy as np
import pytest
from scipy import optimize, special
from shipped_models import backlash

from kernel.answer_mixture import EFFECTS, case, readings
from oed.corrected import AnswerFits
from oed.estimation import identify
from oed.gap import AnswerContent
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
