"""The prior from other machines, against integrals and on drawn fleets."""

import numpy as np
import pytest
from scipy import integrate, stats

from oed.base import Array
from oed.history import FleetPrior, MachineInformation, fleet_prior


def exact(values: list[float], sd: float) -> tuple[float, float]:
    """Mean and variance of a further machine of one parameter, by quadrature."""
    y, n = np.array(values), len(values)

    def moments(s: float) -> Array:
        covariance = (1 - s**2) * np.ones((n, n)) + (s**2 + sd**2) * np.eye(n)
        weight = stats.multivariate_normal(np.zeros(n), covariance).pdf(y)
        gain = (1 - s**2) * np.linalg.solve(covariance, np.ones(n))
        mean = gain @ y
        variance = 1.0 - gain.sum() * (1 - s**2)
        return weight * np.array([1.0, mean, variance + mean**2])

    parts = [integrate.quad(lambda s, k=k: moments(s)[k], 0, 1)[0] for k in range(3)]
    mean = parts[1] / parts[0]
    return mean, parts[2] / parts[0] - mean**2


@pytest.mark.parametrize(
    "values", [[1.5], [1.0, 1.1], [1.0, -1.0], [0.5, 0.7, 0.6, 0.55], [2.0, 2.1, -0.5]]
)
def test_one_parameter_against_quadrature(values):
    sd = 0.1
    machines = [
        MachineInformation(np.eye(1) / sd**2, np.array([v / sd**2])) for v in values
    ]
    prior = fleet_prior(machines)
    mean, variance = exact(values, sd)
    assert prior.mean[0] == pytest.approx(mean, abs=0.01)
    assert prior.covariance[0, 0] == pytest.approx(variance, rel=0.03, abs=0.002)


def test_machines_that_say_nothing_leave_the_tolerances():
    blank = MachineInformation(np.zeros((3, 3)), np.zeros(3))
    prior = fleet_prior([blank, blank])
    np.testing.assert_allclose(prior.mean, 0.0, atol=1e-12)
    np.testing.assert_allclose(prior.covariance, np.eye(3), atol=1e-12)
    with pytest.raises(ValueError, match="at least one"):
        fleet_prior([])


def test_what_readings_say_is_the_posterior_without_its_prior(rng):
    slopes = rng.standard_normal((2, 3))  # fewer readings than parameters
    truth, nominal = rng.standard_normal(3), np.array([4.0, 5.0, 6.0])
    tolerance = np.array([0.5, 2.0, 1.0])
    y = slopes @ truth + 0.1 * rng.standard_normal(2)
    covariance = np.linalg.inv(100.0 * slopes.T @ slopes + np.diag(tolerance**-2))
    value = covariance @ (100.0 * slopes.T @ y + nominal / tolerance**2)
    own = MachineInformation.from_posterior(value, covariance, nominal, tolerance)
    other, wide = nominal + 0.3, 1.5 * tolerance
    moved = own.rescaled(wide / tolerance, (nominal - other) / wide)
    scaled = slopes * wide
    np.testing.assert_allclose(moved.matrix, 100.0 * scaled.T @ scaled, atol=1e-6)
    expected = 100.0 * scaled.T @ (y - slopes @ other)
    np.testing.assert_allclose(moved.vector, expected, atol=1e-6)


def drawn(count, rng, slopes):
    """Parameters (count + 1, p) of a fleet, and what is read of all but the last."""
    p = slopes.shape[1]
    spread = rng.uniform(0.05, 0.6, p)
    x = np.sqrt(1 - spread**2) * rng.standard_normal(p)
    x = x + spread * rng.standard_normal((count + 1, p))
    matrix = slopes.T @ slopes
    noise = rng.standard_normal((count, len(slopes)))
    machines = [
        MachineInformation(matrix, matrix @ x[j] + slopes.T @ noise[j])
        for j in range(count)
    ]
    return x, machines


def within(prior: FleetPrior, x: Array) -> Array:
    return np.abs(x - prior.mean) < 1.96 * np.sqrt(np.diag(prior.covariance))


@pytest.mark.parametrize("count", [2, 10])
def test_bands_of_a_further_machine_hold(count, rng):
    """Fifty fleets of machines of which readings see two thirds of the directions."""
    slopes = 20.0 * rng.standard_normal((4, 6))
    inside, squares = [], []
    for _ in range(50):
        x, machines = drawn(count, rng, slopes)
        prior = fleet_prior(machines)
        inside.append(within(prior, x[-1]))
        root = np.linalg.cholesky(prior.covariance)
        squares.append(np.sum(np.linalg.solve(root, x[-1] - prior.mean) ** 2))
        assert (np.diag(prior.covariance) < 1.2).all()
    assert 0.9 <= np.mean(inside) <= 1.0
    assert 0.5 <= np.mean(squares) / 6 <= 1.25
