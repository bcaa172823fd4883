"""Densities from which noise laws are drawn against SciPy's Student t and quadrature."""

import numpy as np
import pytest
from scipy import integrate, stats

from oed.noise_law.marginal import (
    STUDENT_DOF,
    KernelMixture,
    SplitStudent,
    kernels_at,
    split_student,
)

MODE, ROOT = np.array([1.0, -2.0]), np.array([[2.0, 0.0], [0.5, 0.3]])


def test_a_split_student_of_equal_widths_is_scipys(rng):
    split = SplitStudent(MODE, ROOT, np.full(2, 1.5), np.full(2, 1.5))
    points = MODE + rng.standard_normal((20, 2))
    exact = stats.multivariate_t(MODE, 2.25 * ROOT @ ROOT.T, df=STUDENT_DOF)
    assert split.log_density(points) == pytest.approx(exact.logpdf(points))


def test_a_split_student_has_the_mass_of_its_widths_on_either_side():
    split = SplitStudent(np.zeros(1), np.eye(1), np.array([1.0]), np.array([3.0]))

    def density(u: float) -> float:
        return float(np.exp(split.log_density(np.array([[u]]))[0]))

    below = integrate.quad(density, -np.inf, 0.0)[0]
    above = integrate.quad(density, 0.0, np.inf)[0]
    assert (below, above) == pytest.approx((0.25, 0.75))
    points = split.points(4095)[:, 0]
    assert np.mean(points < 0.0) == pytest.approx(0.25, abs=2e-3)
    ahead = stats.t(STUDENT_DOF).ppf(0.75) * 3.0
    assert np.median(points[points > 0.0]) == pytest.approx(ahead, rel=1e-2)


def test_widths_are_those_of_the_cost():
    """Of a normal density that is twice as wide ahead of the mode as behind it."""

    def cost(u: np.ndarray) -> np.ndarray:
        return 0.5 * np.where(u[:, 0] > 0.0, 0.5 * u[:, 0], u[:, 0]) ** 2

    split = split_student(cost, np.zeros(1), np.eye(1))
    assert split.behind == pytest.approx([1.0])
    assert split.ahead == pytest.approx([2.0])


def test_kernels_are_a_mixture_of_scipys(rng):
    centres, weights = np.array([[0.0, 0.0], [3.0, 1.0]]), np.array([0.2, 0.8])
    mixture = KernelMixture(centres, weights, ROOT)
    points = rng.standard_normal((15, 2))
    exact = sum(
        w * stats.multivariate_t(c, ROOT @ ROOT.T, df=STUDENT_DOF).pdf(points)
        for c, w in zip(centres, weights, strict=True)
    )
    assert mixture.log_density(points) == pytest.approx(np.log(exact))
    drawn = mixture.points(8191)
    assert drawn.mean(axis=0) == pytest.approx(weights @ centres, abs=0.05)


def test_kernels_of_equal_weights_follow_silvermans_rule(rng):
    draws = rng.standard_normal((200, 2)) @ ROOT.T
    mixture = kernels_at(draws, np.full(200, -7.0))
    assert mixture.weights == pytest.approx(np.full(200, 1.0 / 200.0))
    width = 200.0 ** (-1.0 / 6.0)  # (4 / (d + 2) n)^(1 / (d + 4)) for d = 2
    expected = width**2 * np.cov(draws.T, bias=True)
    assert mixture.root @ mixture.root.T == pytest.approx(expected)


def test_weights_count_by_their_square_root():
    mixture = kernels_at(np.array([[0.0], [1.0]]), np.log([0.2, 0.8]))
    assert mixture.weights == pytest.approx([1.0 / 3.0, 2.0 / 3.0])


def test_few_laws_of_ten_coordinates_are_wasted():
    """Of a normal density, whose integral is 1 whatever the number of coordinates."""

    def cost(u: np.ndarray) -> np.ndarray:
        return 0.5 * (u**2).sum(axis=1)

    split = split_student(cost, np.zeros(10), np.eye(10))
    points = split.points(320)
    weights = np.exp(-cost(points) - split.log_density(points)) / (2.0 * np.pi) ** 5
    assert weights.mean() == pytest.approx(1.0, abs=0.1)
    assert weights.sum() ** 2 / (weights @ weights) > 100.0
