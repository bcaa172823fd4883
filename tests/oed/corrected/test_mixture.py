"""The mixture over a diagnosis' answers, against dense Gaussian algebra.

The reference is written out here: slopes and signatures as matrices, each answer's
evidence, mean and covariance in closed form, and quantiles by bisection of the mixture's
distribution.
"""

import numpy as np
import pytest
from scipy import optimize, special, stats
from shipped_models import backlash

from kernel.answer_mixture import EFFECTS, Case, case, readings
from oed.corrected import AnswerFits, AnswerMixture
from oed.corrected.answer_fits import AnswerPosterior
from oed.estimation import Estimate, identify
from oed.gap import AnswerContent
from oed.result import AnswerRecord

__all__ = ["case"]  # fixtures


def test_mean_and_covariance_are_those_of_the_dense_mixture(case: Case) -> None:
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


def mixture_quantile(
    level: float, shares: np.ndarray, means: np.ndarray, sds: np.ndarray
) -> float:
    """Quantile of a mixture of normals, by bisection."""

    def excess(x: float) -> float:
        return float(shares @ special.ndtr((x - means) / sds)) - level

    reach = 9.0 * sds.max()
    low, high = means.min() - reach, means.max() + reach
    return float(optimize.brentq(excess, low, high, xtol=1e-15))


def test_intervals_are_quantiles_of_the_dense_mixture(case: Case) -> None:
    levels = (0.025, 0.5, 0.975)
    quantiles = case.mixture.quantiles(levels)
    sd = np.sqrt(np.diag(case.mixture.covariance))
    for k in np.flatnonzero(sd):
        means = np.array([a.mean[k] for a in case.answers])
        sds = np.sqrt([a.covariance[k, k] for a in case.answers])
        for row, level in enumerate(levels):
            exact = mixture_quantile(level, case.shares, means, sds)
            assert abs(quantiles[row, k] - exact) < 0.12 * sd[k]


def test_draws_have_the_shares_and_the_moments_of_the_mixture(case: Case) -> None:
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


def test_an_answer_below_the_least_share_is_left_out_and_said(case: Case) -> None:
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


def test_without_an_answer_that_is_likely_enough_there_is_no_mixture() -> None:
    """Not one that takes no gap for sure."""
    given = readings()
    plain = identify(given.measurement, given.series, given.y)
    fits = AnswerFits(
        given, EFFECTS, None, estimate_noise=False, rng=np.random.default_rng(1)
    )
    forms = [AnswerContent({}, unknown=False)]
    assert fits.fit([AnswerRecord((), 0.01)], forms, plain) is None


def drawn_answers(
    rng: np.random.Generator, estimate: Estimate
) -> tuple[np.ndarray, AnswerMixture]:
    """Parameters of a linear machine of one of three kinds, and the mixture over them.

    No effect, or one of two that look partly like the geometry, each with its columns'
    coefficients N(0, 1). The estimate is of another machine, which nothing here asks for.
    """
    slopes = rng.standard_normal((10, 3))
    kinds = [
        np.zeros((10, 0)),
        slopes[:, :1] + 0.5 * rng.standard_normal((10, 1)),
        slopes[:, 1:2] - slopes[:, 2:] + 0.5 * rng.standard_normal((10, 1)),
    ]
    acting = kinds[rng.integers(3)]
    theta = rng.standard_normal(3)
    y = slopes @ theta + acting @ rng.standard_normal(acting.shape[1])
    y = y + rng.standard_normal(10)
    log_evidence, moments = [], []
    for columns in kinds:
        prior = np.eye(10) + slopes @ slopes.T + columns @ columns.T
        gain = np.linalg.solve(prior, slopes).T
        log_evidence.append(stats.multivariate_normal(cov=prior).logpdf(y))
        moments.append((gain @ y, np.eye(3) - gain @ slopes))
    answers = [
        AnswerPosterior(
            effects=(),
            unseen=False,
            probability=float(share),
            mean=mean,
            covariance=covariance,
            theta=rng.multivariate_normal(mean, covariance, 400),
            estimate=estimate,
            noise_law=np.zeros((400, 0)),
        )
        for share, (mean, covariance) in zip(
            special.softmax(log_evidence), moments, strict=True
        )
    ]
    return theta, AnswerMixture(tuple(answers), 0.0)


def test_intervals_of_the_mixture_hold_where_those_of_the_best_answer_do_not() -> None:
    rng = np.random.default_rng(8)
    given = readings()
    estimate = identify(given.measurement, given.series, given.y)
    inside, inside_best, errors, errors_best = [], [], [], []
    for _ in range(600):
        theta, mixture = drawn_answers(rng, estimate)
        low, high = mixture.quantiles((0.025, 0.975))
        inside.append((low < theta) & (theta < high))
        best = mixture.answers[int(np.argmax(mixture.shares))]
        half = 1.96 * np.sqrt(np.diag(best.covariance))
        inside_best.append(np.abs(theta - best.mean) < half)
        errors.append((mixture.mean - theta) ** 2)
        errors_best.append((best.mean - theta) ** 2)
    assert 0.93 < np.mean(inside) < 0.97  # the standard error is below .01
    assert np.mean(inside_best) < 0.90
    assert np.mean(errors) < 0.97 * np.mean(errors_best)
