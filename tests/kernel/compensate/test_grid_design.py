"""Readings of a forecast grid against brute force over all choices."""

import numpy as np
import pytest

from oed.compensate.error_field import (
    CANDIDATES,
    TREND,
    Box,
    Kernel,
    design_grid,
    expected_kernel,
)

BOX = Box(("y",), np.array([0.0]), np.array([2.0]))
REFERENCE, SIGMA, SIZE = np.array([1.0]), 0.1, 2.0


def motion(places: np.ndarray) -> np.ndarray:
    return np.ones((len(places), 1, 1))


def left(kernel: Kernel, read: np.ndarray) -> float:
    """Rms error against the reference, conditioned on readings of the whole field."""
    every = np.linspace(-1.0, 1.0, CANDIDATES[0])
    places = np.r_[every, 0.0, BOX.scaled(read[:, None])[:, 0]][:, None]
    trend = (TREND * kernel.size) ** 2 * (1.0 + places @ places.T)
    covariance = kernel.covariance(places, places) + trend
    n = len(every) + 1
    among = covariance[n:, n:] + SIGMA**2 * np.eye(len(read))
    gain = np.linalg.solve(among, covariance[n:, :n]).T
    posterior = covariance[:n, :n] - gain @ covariance[n:, :n]
    here, there = np.diag(posterior)[:-1], posterior[-1, -1]
    return float(np.sqrt(np.mean(here + there - 2.0 * posterior[:-1, -1])))


def test_the_expected_kernel_is_of_the_stated_size() -> None:
    kernel = expected_kernel(3e-6, 2)
    assert kernel.size == 3e-6
    at_a_place = kernel.covariance(np.zeros((1, 2)), np.zeros((1, 2)))
    assert at_a_place == pytest.approx(9e-12)


def test_no_other_pair_of_places_leaves_less(rng: np.random.Generator) -> None:
    """The modes hold 99.9 % of the field, so pairs that near are as good."""
    kernel = expected_kernel(SIZE, 1)
    design = design_grid(
        BOX, motion, 2, (kernel,), np.array([SIGMA]), rng, reference=REFERENCE
    )
    chosen = design.places[:, 0]
    grid = np.linspace(0.0, 2.0, CANDIDATES[0])
    pairs = [(a, b) for k, a in enumerate(grid) for b in grid[k:]]
    values = [left(kernel, np.array(pair)) for pair in pairs]
    assert left(kernel, chosen) < 1.01 * min(values)
    assert design.predicted[0] == pytest.approx(left(kernel, chosen), rel=0.02)


def test_a_budget_of_nothing_is_refused(rng: np.random.Generator) -> None:
    with pytest.raises(ValueError, match="budget of 0 is not between 1 and 41"):
        design_grid(
            BOX,
            motion,
            0,
            (expected_kernel(SIZE, 1),),
            np.array([SIGMA]),
            rng,
            reference=REFERENCE,
        )
