"""Forms and sizes of effects, where dense covariances or closed forms say what they must be."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from shipped_models import backlash

from kernel import gap_problem
from oed.corrected.forms import (
    SIZES,
    FormEvidence,
    choose_forms,
    groups_by_effect,
    updated_sizes,
)
from oed.effect_model import EFFECT_SIZES
from oed.gap import GapProblem

PLAY = np.array([3.0, -2.0, 4.0])


def dense_evidence(problem, columns, residual):
    """-1/2 log(|C + U U^T| / |C|) - N/2 log r^T (C + U U^T)^-1 r, C = 1 + H H^T."""
    n = len(problem)
    without = np.eye(n) + problem.slopes @ problem.slopes.T
    total = without + columns @ columns.T
    log_det = np.linalg.slogdet(total)[1] - np.linalg.slogdet(without)[1]
    square = residual @ np.linalg.solve(total, residual)
    return float(-0.5 * log_det - 0.5 * n * np.log(square))


@pytest.fixture(scope="module")
def problem() -> GapProblem:
    """Circles with play of some sizes in the three drives."""
    circles = gap_problem.circles()
    signature = circles.signature(
        backlash.effect, {"distance": backlash.TAKEN_UP[0]}, textbook=True
    )
    change = circles.noise_units(signature.columns @ PLAY)
    noise = np.random.default_rng(1).standard_normal(len(circles))
    return circles.with_residual(change + noise)


def test_evidence_is_that_of_dense_covariances(problem, rng):
    evidence = FormEvidence(problem)
    columns = rng.standard_normal((len(problem), 4))
    expected = dense_evidence(problem, columns, problem.residual)
    assert evidence.log_evidence(columns) == pytest.approx(expected)
    fixed, sized = columns[:, :1], columns[:, 1:]
    by_size = [
        dense_evidence(problem, np.hstack([fixed, size * sized]), problem.residual)
        for size in EFFECT_SIZES.values
    ]
    assert evidence.of_sizes(fixed, sized) == pytest.approx(
        np.array(by_size) + EFFECT_SIZES.log_shares, rel=1e-6
    )
    total = np.eye(len(problem)) + problem.slopes @ problem.slopes.T
    total += columns @ columns.T
    square = problem.residual @ np.linalg.solve(total, problem.residual)
    assert evidence.unexplained(columns) == pytest.approx(square)


def test_the_form_of_highest_evidence_is_chosen(problem):
    """Distances at which play is taken up are alike where circles are far between."""
    (form,) = choose_forms(problem, [backlash.effect])

    def values(constants: Mapping[str, float]) -> np.ndarray:
        signature = problem.signature(backlash.effect, constants)
        columns = problem.noise_units(signature.columns)
        by_size = [
            dense_evidence(problem, size * columns, problem.residual)
            for size in EFFECT_SIZES.values
        ]
        return np.array(by_size) + EFFECT_SIZES.log_shares

    tried = np.array([values(c) for c in backlash.effect.constant_grid()])
    chosen = values(form.constants)
    assert chosen.max() == pytest.approx(tried.max(), abs=1e-5)
    assert form.size == EFFECT_SIZES.values[np.argmax(chosen)] == 3.0


def form(*labels: str) -> Any:
    return SimpleNamespace(signature=SimpleNamespace(labels=labels))


def estimated(read: np.ndarray, sd: float, prior: float) -> tuple[Any, Any]:
    """Mean and covariance under N(0, prior^2) of values read with sd."""
    variance = 1.0 / (sd**-2 + prior**-2)
    return read * variance / sd**2, variance * np.eye(len(read))


def test_coefficients_of_a_label_are_a_group():
    effects = groups_by_effect([form("leg 1", "leg 2", "leg 1"), form("bar")])
    numbers = [[group.tolist() for group in groups] for groups in effects]
    assert numbers == [[[0, 2], [1]], [[3]]]


def test_an_unfinished_fit_says_nothing_of_what_no_reading_sees():
    """A fit ends within hundredths of a deviation: eighteen of what the readings add."""
    read, group = np.array([0.8, -1.1, 0.4]), np.arange(4)
    mean, covariance = np.zeros(4), 900.0 * (1.0 - 1e-6) * np.eye(4)
    mean[:3], covariance[:3, :3] = estimated(read, 0.3, 30.0)
    mean[3] = 0.02 * 30.0
    updated = updated_sizes([[group]], np.full(4, 30.0), mean, covariance)
    assert (updated <= 3.0).all()


@pytest.mark.parametrize("read", [0.5, 8.0, 90.0])
def test_a_groups_size_is_the_posterior_median(read):
    """Of one group: among all sizes, at the median of the size that groups share."""
    group, sd, prior = np.arange(2), 0.5, 10.0
    values = np.array([read, -0.6 * read])
    mean, covariance = estimated(values, sd, prior)
    (size, same) = updated_sizes([[group]], np.full(2, prior), mean, covariance)
    assert size == same
    likelihood = np.array(
        [
            multivariate_normal(np.zeros(2), (sd**2 + s**2) * np.eye(2)).pdf(values)
            for s in SIZES
        ]
    )
    shares = np.exp(EFFECT_SIZES.log_shares)
    below = len(shares) - len(SIZES)
    prior_shares = np.append(shares[: below + 1].sum(), shares[below + 1 :])
    count = len(SIZES)
    given = np.zeros((count, count))
    for common in range(count):
        beyond = count - common - 1
        given[common, common] = 0.9 if beyond else 1.0
        given[common, common + 1 :] = 0.1 / max(beyond, 1)
    # a common size that is the largest has no chance beyond it
    weights = prior_shares * (given @ likelihood)
    if count:
        weights[-1] = prior_shares[-1] * likelihood[-1]
    common = int(np.searchsorted(np.cumsum(weights / weights.sum()), 0.5))
    own = given[common] * likelihood
    median = int(np.searchsorted(np.cumsum(own / own.sum()), 0.5))
    assert size == SIZES[median]


def _updated(values: np.ndarray, sd: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Sizes of one effect, each coefficient a group, known by readings to +- sd (k,)."""
    precision = sd**-2.0 + prior**-2.0
    estimate = values * sd**-2.0 / precision
    groups = [[np.array([k]) for k in range(len(values))]]
    return updated_sizes(groups, prior, estimate, np.diag(1.0 / precision))


def test_where_readings_tell_nothing_the_expected_size_stays():
    sd = np.full(6, 1e3)
    assert _updated(np.zeros(6), sd, np.ones(6)).tolist() == [1.0] * 6


def test_one_leg_far_off_is_free_and_the_others_are_not():
    values = np.array([-1200.0, 0.3, -1.1, 0.8, 0.1, -0.6])
    sd = np.full(6, 1.4)
    size = np.ones(6)
    for _ in range(4):
        size = _updated(values, sd, size)
    assert size[0] >= 1000.0
    assert size[1:].tolist() == [1.0] * 5
    # within a hundredth of a standard deviation of what the readings say
    pull = values[0] * (1.0 - size[0] ** 2 / (size[0] ** 2 + sd[0] ** 2))
    assert abs(pull) < 0.01 * sd[0]


def test_all_legs_of_a_coarse_machine_share_their_size():
    """Ten times what is expected; one leg alone would hardly show it."""
    values = np.array([9.0, -14.0, 6.0, 11.0, -8.0, -12.0])
    size = _updated(values, np.full(6, 4.0), np.ones(6))
    assert set(size.tolist()) == {10.0}
