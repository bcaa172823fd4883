"""Errors that add up to the noise of readings against dense covariances."""

import numpy as np
import pytest

from oed.accuracy.budget import (
    BEYOND,
    CARRIED,
    LEVELS,
    SEAT,
    errors_of_readings,
    instrument_source,
)
from oed.noise import Laws, ReadingStructure, SharedError

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
