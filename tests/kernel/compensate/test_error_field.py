"""Fields of errors against Bessel functions, dense conditioning and a grid of kernels."""

import itertools

import numpy as np
import pytest
from scipy import special
from scipy.stats import multivariate_normal

from oed.compensate.error_field import (
    TREND_SIZE,
    Box,
    ErrorField,
    Kernel,
    fit_error_field,
)

BOX = Box(("y", "z"), np.array([-1.0, 2.0]), np.array([3.0, 3.0]))


def matern(nu: float, distance: np.ndarray) -> np.ndarray:
    """Matern's correlation of any order, by the modified Bessel function."""
    scaled = np.sqrt(2.0 * nu) * distance
    return 2 ** (1 - nu) / special.gamma(nu) * scaled**nu * special.kv(nu, scaled)


def bent(places: np.ndarray) -> np.ndarray:
    """Motion (n, 2, 2) that depends on the place."""
    y, z = places.T
    rows = [[1.0 + 0.1 * y, 0.3 * z], [0.2 * y, 2.0 - 0.1 * z]]
    return np.moveaxis(np.array(rows), -1, 0)


def test_a_box_goes_from_minus_one_to_one() -> None:
    y, z = BOX.lattice([5, 3])
    assert y == pytest.approx([-1, 0, 1, 2, 3])
    assert z == pytest.approx([2, 2.5, 3])
    corners = np.array([[-1.0, 2.0], [1.0, 2.5], [3.0, 3.0]])
    expected = np.array([[-1.0, -1.0], [0.0, 0.0], [1.0, 1.0]])
    assert BOX.scaled(corners) == pytest.approx(expected)


@pytest.mark.parametrize(("order", "nu"), [("3/2", 1.5), ("5/2", 2.5)])
def test_a_kernel_is_materns(order: str, nu: float, rng: np.random.Generator) -> None:
    length = np.array([0.5, 2.0])
    first, second = rng.uniform(-1, 1, (4, 2)), rng.uniform(-1, 1, (6, 2))
    distance = np.array(
        [[np.linalg.norm((a - b) / length) for b in second] for a in first]
    )
    covariance = Kernel(order, 3.0, length).covariance(first, second)
    assert covariance == pytest.approx(9.0 * matern(nu, distance), rel=1e-12)


def test_a_field_is_conditioned_on_its_readings(rng: np.random.Generator) -> None:
    """Mean and spread are those of the joint normal distribution of all errors."""
    kernels = (
        Kernel("3/2", 1.0, np.array([0.8, 1.2])),
        Kernel("5/2", 0.5, np.array([2.0, 0.6])),
    )
    read = rng.uniform(BOX.lower, BOX.upper, (7, 2))
    places = rng.uniform(BOX.lower, BOX.upper, (4, 2))
    struts, noise = rng.standard_normal((7, 2)), rng.uniform(0.05, 0.2, (7, 2))
    field = ErrorField(BOX, bent, read, struts, noise, kernels)
    every = BOX.scaled(np.vstack([read, places]))
    mean, covariance = np.zeros((4, 2)), np.zeros((2, 4, 4))
    for k, kernel in enumerate(kernels):
        trend = (TREND_SIZE * np.abs(struts[:, k]).max()) ** 2
        joint = kernel.covariance(every, every) + trend * (1.0 + every @ every.T)
        joint[:7, :7] += np.diag(noise[:, k] ** 2)
        gain = joint[7:, :7] @ np.linalg.inv(joint[:7, :7])
        mean[:, k] = gain @ struts[:, k]
        covariance[k] = joint[7:, 7:] - gain @ joint[:7, 7:]
    motion = bent(places)
    expected = np.array([motion[i] @ mean[i] for i in range(4)])
    assert field.mean(places) == pytest.approx(expected, rel=1e-6)
    difference = np.hstack([motion[0], -motion[3]])
    of_both = np.zeros((4, 4))
    for a, b in itertools.product((0, 1), repeat=2):
        blocks = covariance[:, (0, 3)[a], (0, 3)[b]]
        of_both[2 * a : 2 * a + 2, 2 * b : 2 * b + 2] = np.diag(blocks)
    variance = np.diag(difference @ of_both @ difference.T)
    sd = field.sd(places, places[3])
    assert sd[0] == pytest.approx(np.sqrt(variance), rel=1e-5)
    assert sd[3] == pytest.approx(0.0, abs=1e-5)


def test_no_kernel_of_a_grid_is_more_probable_than_the_fitted_one() -> None:
    box = Box(("y",), np.array([-1.0]), np.array([1.0]))
    places = np.linspace(-1, 1, 9)[:, None]
    errors, sigma = np.sin(4.0 * places), np.array([0.02])

    def motion(at: np.ndarray) -> np.ndarray:
        return np.ones((len(at), 1, 1))

    def log_posterior(kernel: Kernel) -> float:
        trend = (TREND_SIZE * np.abs(errors).max()) ** 2 * (1 + places @ places.T)
        noise = (sigma[0] ** 2 + 1e-9 * kernel.size**2) * np.eye(9)
        covariance = kernel.covariance(places, places) + trend + noise
        likelihood = multivariate_normal(np.zeros(9), covariance).logpdf(errors[:, 0])
        return float(likelihood - 0.5 * np.log(kernel.length[0]) ** 2)

    (fitted,) = fit_error_field(box, motion, places, errors, sigma).kernels
    grid = itertools.product(
        ("3/2", "5/2"), np.geomspace(0.1, 30, 25), np.geomspace(0.06, 15, 25)
    )
    best = max(log_posterior(Kernel(o, s, np.array([x]))) for o, s, x in grid)
    assert best - 1e-6 <= log_posterior(fitted) < best + 0.2
    with pytest.raises(ValueError, match="too few: take 3 or more"):
        fit_error_field(box, motion, places[:2], errors[:2], sigma)
