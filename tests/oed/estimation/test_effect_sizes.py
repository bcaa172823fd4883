"""Draws of effects' coefficients and common size, against the exact mixture of normals."""

import numpy as np
import pytest
from scipy import special

from oed.estimation import Discrepancy, discrepancy

COUNT = 4000  #: draws; the standard error of a mean is 1.6 % of the standard deviation
INFORMATION = np.array([[4.0, 1.5], [1.5, 2.0]])


def exact_mixture(information, score, sizes):
    """Log evidence over no effects, mean and variance of the coefficients."""
    weights, means, squares = [], [], []
    for size in sizes:
        precision = information + np.eye(len(score)) / size**2
        covariance = np.linalg.inv(precision)
        mean = covariance @ score
        log_det = np.linalg.slogdet(precision * size**2)[1]
        weights.append(0.5 * score @ mean - 0.5 * log_det)
        means.append(mean)
        squares.append(np.diag(covariance) + mean**2)
    share = special.softmax(weights)
    mean = share @ np.array(means)
    variance = share @ np.array(squares) - mean**2
    evidence = float(special.logsumexp(weights)) - np.log(len(sizes))
    return evidence, mean, variance


@pytest.mark.parametrize(
    "sizes", [Discrepancy.SMALL, Discrepancy.LARGE], ids=["small", "large"]
)
@pytest.mark.parametrize("score", [(0.0, 0.0), (3.0, -1.0), (40.0, 10.0)])
def test_draws_are_those_of_the_mixture(score, sizes):
    evidence, mean, variance = exact_mixture(INFORMATION, np.array(score), sizes)
    rng = np.random.default_rng(1)
    drawn = discrepancy.sample_effects(INFORMATION, np.array(score), sizes, rng, COUNT)
    error = np.sqrt(variance / COUNT)
    assert np.abs((drawn.coefficients.mean(axis=0) - mean) / error).max() < 5.0
    # fourth moments of tails are large: the variance is known to some 10 %
    assert drawn.coefficients.var(axis=0) == pytest.approx(variance, rel=0.35)
    assert drawn.log_evidence == pytest.approx(evidence, abs=1e-9)


def test_effects_without_readings_keep_their_prior():
    rng = np.random.default_rng(2)
    drawn = discrepancy.sample_effects(
        np.zeros((1, 1)), np.zeros(1), Discrepancy.SMALL, rng, COUNT
    )
    shares = (drawn.size[:, None] == Discrepancy.SMALL).mean(axis=0)
    assert np.abs(shares - 1.0 / len(Discrepancy.SMALL)).max() < 5.0 * np.sqrt(
        0.25 / COUNT
    )
    assert drawn.log_evidence == pytest.approx(0.0, abs=1e-9)


def test_the_same_draws_whatever_the_rounding_of_the_readings():
    """Of 12 coefficients 5 readings show 5 directions; no draw may depend on rounding."""
    rng, size = np.random.default_rng(2), np.array([0.7])
    columns = rng.standard_normal((5, 12))
    information, score = columns.T @ columns, columns.T @ np.ones(5)
    rounding = rng.standard_normal((12, 12)) * 1e-14
    drawn = [
        discrepancy.sample_effects(
            each, score, size, np.random.default_rng(3), COUNT
        ).coefficients
        for each in (information, information + rounding + rounding.T)
    ]
    assert np.abs(drawn[0] - drawn[1]).max() < 1e-9
    covariance = np.linalg.inv(information + np.eye(12) / size**2)
    error = np.cov(drawn[0], rowvar=False) - covariance
    assert np.abs(error).max() < 6.0 * covariance.max() / np.sqrt(COUNT)
