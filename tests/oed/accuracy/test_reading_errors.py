"""Errors that add up to the noise of readings against dense covariances."""

import dataclasses

import numpy as np
import pytest

from kernel.dense_noise import dense_covariance
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
LAWS = Laws(
    np.array([[1.5, 0.8]]),
    np.array([0.4]),
    np.array([3.0]),
    np.array([0.7]),
    np.array([0.5]),
)
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


def with_errors(structure: ReadingStructure, laws: Laws) -> np.ndarray:
    return dense_covariance(structure, laws)


def test_an_error_is_taken_out_by_a_factor_of_nothing(
    structure: ReadingStructure, rng: np.random.Generator
) -> None:
    errors = errors_of_readings(structure, LAWS, ["bar"] * 6 + ["cup"] * 6)
    values = rng.standard_normal((N, 2))
    single = np.diag((1.0 - 0.4) * LAWS.scale[0, structure.group] ** 2)
    no_share = dataclasses.replace(LAWS, correlated=np.zeros(1))
    without = {
        SEAT: with_errors(structure, dataclasses.replace(LAWS, seat=np.zeros(1))),
        LEVELS: with_errors(structure, dataclasses.replace(LAWS, level=np.zeros(1))),
        CARRIED: with_errors(structure, no_share)
        - np.diag(LAWS.scale[0, structure.group] ** 2)
        + single,
    }
    for name, dense in without.items():
        exact = np.linalg.solve(dense, values)
        assert errors.weigh(values, {name: 0.0}) == pytest.approx(exact), name
    twice = with_errors(structure, LAWS) + 3.0 * np.diag(errors.variances[CUP])
    exact = np.linalg.solve(twice, values)
    assert errors.weigh(values, {CUP: 2.0}) == pytest.approx(exact)


def test_noise_above_the_stated_one_is_its_own_source(
    structure: ReadingStructure, rng: np.random.Generator
) -> None:
    errors = errors_of_readings(structure, LAWS, ["bar"] * 6 + ["cup"] * 6)
    assert set(errors.names) == {BAR, CUP, BEYOND, LEVELS, SEAT, CARRIED}
    first = np.repeat([1.0, 0.0], 6)
    assert errors.variances[BAR] == pytest.approx(first)
    assert errors.variances[BEYOND] == pytest.approx((0.6 * 2.25 - 1.0) * first)
    assert errors.variances[CUP] == pytest.approx((0.6 * 0.64) * (1.0 - first))
    gain = rng.standard_normal((N, 3))
    between = sum(0.384 * np.outer(row, row) for row in gain[6:])
    assert errors.between(CUP, gain) == pytest.approx(between)
