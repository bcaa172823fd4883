"""Errors of readings that add up to their noise, each with a factor, against dense covariances."""

import numpy as np
import pytest

from kernel import bar_circles
from oed.accuracy import budget
from oed.accuracy.budget import (
    BEYOND,
    CARRIED,
    LEVELS,
    SEAT,
    errors_of_readings,
    instrument_source,
)
from oed.noise import Laws, ReadingStructure, SharedError
from oed.noise_law import NoisePrior

N = 12
#: scales above and below the stated noise, a share carried along, a level, a seat
ONE = [np.array([x]) for x in (0.4, 3.0, 0.7, 0.5)]  # correlated, reach, level, seat
LAWS = Laws(np.array([[1.5, 0.8]]), *ONE)
BAR, CUP = instrument_source("bar"), instrument_source("cup")


@pytest.fixture
def structure(rng: np.random.Generator) -> ReadingStructure:
    """Two runs of six readings, one with each of two instruments."""
    run = np.repeat([0, 1], 6)
    return ReadingStructure(
        names=("a.length", "b.length"),
        group=run,
        chain=run,
        run=np.array([0, 1]),
        position=np.tile(np.arange(6.0), 2),
        unit=np.ones(N),
        decouple=None,
        columns=np.column_stack([np.ones(N), rng.standard_normal(N)]),
        kinds=np.array([SharedError.LEVEL, SharedError.RENEWED]),
    )


def test_noise_above_the_stated_one_is_its_own_source(structure, rng):
    errors = errors_of_readings(structure, LAWS, ["bar"] * 6 + ["cup"] * 6)
    assert set(errors.names) == {BAR, CUP, BEYOND, LEVELS, SEAT, CARRIED}
    first = np.repeat([1.0, 0.0], 6)
    assert errors.variances[BAR] == pytest.approx(first)
    assert errors.variances[BEYOND] == pytest.approx((0.6 * 2.25 - 1.0) * first)
    assert errors.variances[CUP] == pytest.approx((0.6 * 0.64) * (1.0 - first))
    gain = rng.standard_normal((N, 3))
    between = sum(0.384 * np.outer(row, row) for row in gain[6:])
    assert errors.between(CUP, gain) == pytest.approx(between)


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
