"""A course through the session: its variance, and that a fit does not take it for geometry."""

import dataclasses

import numpy as np
import pytest

from kernel import bar_circles
from kernel.dense_noise import dense_covariance
from oed.accuracy.budget import COURSE, errors_of_readings
from oed.measurement.noise_structure import course_terms
from oed.noise import Laws, ReadingStructure
from oed.noise_law import NoisePrior


def test_the_variance_grows_with_the_session():
    """A Wiener process has variance t; four terms leave a little of it."""
    progress = np.linspace(0.0, 1.0, 41)
    terms = course_terms(np.zeros(41, dtype=np.intp), progress)
    variance = (terms**2).sum(axis=1)
    assert np.all(variance <= progress + 1e-12)
    assert np.abs(variance - progress).max() < 0.06
    covariance = terms @ terms.T
    wiener = np.minimum(progress[:, None], progress)
    assert np.abs(covariance - wiener).max() < 0.06


def test_a_group_has_a_term_for_each_five_readings():
    group = np.repeat([0, 1, 2], [20, 14, 4]).astype(np.intp)
    terms = course_terms(group, np.linspace(0.0, 1.0, len(group)))
    of_group = [np.count_nonzero(terms[group == k].any(axis=0)) for k in range(3)]
    assert of_group == [4, 2, 0]


@pytest.fixture(scope="module")
def structure() -> ReadingStructure:
    """Three runs of a ball bar."""
    return bar_circles.circles(8)


@pytest.fixture(scope="module")
def laws(structure: ReadingStructure) -> Laws:
    prior = NoisePrior.of(structure)
    draws = np.random.default_rng(2).standard_normal((3, prior.dimensions))
    return prior.laws(draws)


def test_few_degrees_of_freedom_have_none(structure):
    terms = structure.course.shape[1]
    assert NoisePrior.COURSE in NoisePrior.of(structure, 10.0 + terms).names
    assert NoisePrior.COURSE not in NoisePrior.of(structure, 9.9 + terms).names


def test_without_its_error_the_rest_is_that_of_a_law_without_one(structure, laws):
    law = laws.take([0])
    still = dataclasses.replace(law, course=np.zeros(1))
    y = np.random.default_rng(4).standard_normal((len(structure), 3))
    errors = errors_of_readings(structure, law, ["bar"] * len(structure))
    assert COURSE in errors.names
    white = errors.whiten(y, {COURSE: 0.0})
    exact = y.T @ np.linalg.solve(dense_covariance(structure, still), y)
    assert white.T @ white == pytest.approx(exact, rel=1e-9)
    assert COURSE not in errors_of_readings(structure, still, ["bar"] * 24).names
