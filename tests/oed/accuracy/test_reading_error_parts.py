"""Errors of readings that add up, each with a factor, against dense matrices."""

import numpy as np
import pytest

from kernel import bar_circles
from oed.accuracy import budget
from oed.noise import ReadingStructure
from oed.noise_law import NoisePrior

FACTORS = (
    {}, {budget.CARRIED: 0.0}, {budget.LEVELS: 0.5, budget.SEAT: 0.0},
    {budget.COURSE: 0.5},
    {budget.instrument_source("bar"): 0.1, budget.BEYOND: 0.0},
)  # fmt: skip


@pytest.fixture(scope="module")
def circles() -> ReadingStructure:
    """Three circles of 40 readings, whose cup is seated at each."""
    return bar_circles.circles(40)


def covariance(structure, laws, factors):
    """The sum of the module's docstring, matrix by matrix, of one instrument."""
    share, scale = laws.correlated[0], laws.scale[0, structure.group]
    same_chain = structure.chain[:, None] == structure.chain
    distance = np.abs(structure.position[:, None] - structure.position)
    single = (1.0 - share) * scale**2
    stated = np.minimum(single, 1.0)
    of = {
        budget.instrument_source("bar"): np.diag(stated),
        budget.BEYOND: np.diag(single - stated),
        budget.CARRIED: share
        * np.exp(-distance / laws.reach[0])
        * same_chain
        * np.outer(scale, scale),
    }
    columns = structure.columns * laws.sizes[0, structure.kinds] * scale[:, None]
    for name, kinds in budget.SHARED_KINDS.items():
        some = columns[:, np.isin(structure.kinds, kinds)]
        of[name] = some @ some.T * same_chain
    course = structure.course * laws.course[0] * scale[:, None]
    of[budget.COURSE] = course @ course.T
    return sum(factors.get(name, 1.0) ** 2 * part for name, part in of.items())


@pytest.mark.parametrize("factors", FACTORS)
def test_errors_with_factors_are_those_of_dense_matrices(circles, factors):
    rng = np.random.default_rng(2)
    prior = NoisePrior.of(circles)
    laws = prior.laws(rng.standard_normal((1, prior.dimensions)))
    errors = budget.errors_of_readings(circles, laws, ["bar"] * len(circles))
    dense = covariance(circles, laws, factors)
    y = rng.standard_normal((len(circles), 3))
    exact = np.linalg.solve(dense, y)
    white = errors.whiten(y, factors)
    assert errors.weigh(y, factors) == pytest.approx(exact, rel=1e-8, abs=1e-8)
    assert white.T @ white == pytest.approx(y.T @ exact, rel=1e-9)
    name = budget.instrument_source("bar")
    stated = np.minimum((1.0 - laws.correlated[0]) * laws.scale[0, 0] ** 2, 1.0)
    assert errors.between(name, y) == pytest.approx(stated * y.T @ y)
