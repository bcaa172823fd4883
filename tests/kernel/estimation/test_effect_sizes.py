"""Draws of effects' coefficients and sizes, against the exact mixture of normals."""

import itertools

import numpy as np
import pytest
from scipy import special

from oed.estimation import effect_sizes
from oed.estimation.effect_sizes import COMMON, SIZES, log_prior

#: draws; the standard error of a mean is 1.6 % of the standard deviation
COUNT = 4000


def exact_mixture(
    information: np.ndarray, score: np.ndarray, unknown: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray, float]:
    """Log evidence, mean and variance of one coefficient a group, P(faulty).

    Sums over all states and sizes; given these, coefficients are normal.
    """
    prior = log_prior(unknown)
    groups, states, sizes = prior.shape
    weights, means, squares, faulty = [], [], [], []
    for state in range(states):
        for chosen in itertools.product(range(sizes), repeat=groups):
            log_weight = sum(prior[g, state, s] for g, s in enumerate(chosen))
            if not np.isfinite(log_weight):
                continue
            precision = information + np.diag(SIZES[list(chosen)] ** -2.0)
            covariance = np.linalg.inv(precision)
            mean = covariance @ score
            log_weight += 0.5 * score @ mean - 0.5 * np.linalg.slogdet(precision)[1]
            log_weight -= float(np.log(SIZES[list(chosen)]).sum())
            weights.append(log_weight - np.log(states))
            means.append(mean)
            squares.append(np.diag(covariance) + mean**2)
            faulty.append(float(state >= len(COMMON)))
    share = special.softmax(weights)
    mean = share @ np.array(means)
    variance = share @ np.array(squares) - mean**2
    evidence = float(special.logsumexp(weights))
    return evidence, mean, variance, float(share @ np.array(faulty))


@pytest.mark.parametrize("score", [(0.0, 0.0), (3.0, -1.0), (40.0, 10.0)])
def test_draws_are_those_of_the_mixture(score: tuple[float, float]) -> None:
    information = np.array([[4.0, 1.5], [1.5, 2.0]])
    unknown = np.array([False, True])
    evidence, mean, variance, faulty = exact_mixture(
        information, np.array(score), unknown
    )
    drawn = effect_sizes.sample(
        information,
        np.array(score),
        [np.array([0]), np.array([1])],
        unknown,
        np.random.default_rng(1),
        COUNT,
    )
    error = np.sqrt(variance / COUNT)
    found = drawn.coefficients.mean(axis=0)
    assert np.abs((found - mean) / error).max() < 5.0
    # fourth moments of tails are large: the variance is known to some 10 %
    assert drawn.coefficients.var(axis=0) == pytest.approx(variance, rel=0.35)
    assert drawn.log_evidence == pytest.approx(evidence, abs=0.15)
    assert drawn.faulty.mean() == pytest.approx(faulty, abs=0.05)


def test_an_effect_without_readings_keeps_its_prior() -> None:
    unknown = np.array([False])
    drawn = effect_sizes.sample(
        np.zeros((1, 1)),
        np.zeros(1),
        [np.array([0])],
        unknown,
        np.random.default_rng(2),
        COUNT,
    )
    table = np.exp(log_prior(unknown)[0]).mean(axis=0)
    shares = (drawn.sizes[:, 0, None] == SIZES).mean(axis=0)
    assert np.abs(shares - table).max() < 5.0 * np.sqrt(0.25 / COUNT)
    assert drawn.log_evidence == pytest.approx(0.0, abs=1e-9)


def test_every_state_is_a_distribution() -> None:
    table = np.exp(log_prior(np.array([False, True])))
    assert table.sum(axis=2) == pytest.approx(1.0)


def test_the_same_generator_gives_the_same_draws() -> None:
    def drawn() -> np.ndarray:
        return effect_sizes.sample(
            np.eye(2),
            np.array([5.0, 0.0]),
            [np.array([0, 1])],
            np.array([False]),
            np.random.default_rng(3),
            50,
        ).coefficients

    assert (drawn() == drawn()).all()
