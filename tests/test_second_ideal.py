"""The ideal observer of the second generator: noise laws against brute force."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import integrate, stats

from benchmarks.second import noise_laws, observers
from benchmarks.second.noise_laws import Law, LawModel
from benchmarks.second.replay import Replay


def replay(readings: int, parameters: int) -> Replay:
    """Two runs of readings, one parameter or two, and a change of the readings."""
    rng = np.random.default_rng(3)
    return Replay(
        case=SimpleNamespace(),
        label={},
        sigma=np.ones(readings),
        run=np.repeat([0, 1], readings // 2),
        slopes=rng.normal(size=(readings, parameters)),
        reference=np.zeros((readings, 0)),
        change=np.linspace(-1.0, 1.0, readings) ** 2,
        readings=np.zeros(readings),
    )


def test_laws_are_a_distribution() -> None:
    priors = np.exp([law.log_prior for law in noise_laws.laws()])
    assert priors.sum() == pytest.approx(1.0)
    shared = [law.run_sd for law in noise_laws.laws() if law.run_sd]
    assert min(shared) > 0.6
    assert max(shared) < 1.5


@pytest.mark.parametrize("law", [Law("white"), Law("white", 0.9, 0.6, 0.85)])
def test_gaussian_density_is_that_of_its_covariance(law: Law) -> None:
    case, rng = replay(12, 2), np.random.default_rng(1)
    data = noise_laws.draw_noise(case, law, 3, rng)
    covariance = noise_laws.noise_covariance(case, law) + case.slopes @ case.slopes.T
    model = LawModel(case, law)
    norm = np.sqrt(case.change @ np.linalg.solve(covariance, case.change))
    wanted = [
        stats.multivariate_normal(s * case.change / norm, covariance).logpdf(data.T)
        for s in (0.0, 5.0)
    ]
    along = model.along(data, case.change, np.array([0.0, 5.0]))
    np.testing.assert_allclose(along, wanted)
    np.testing.assert_allclose(model.scores(data)[0], wanted[0])


@pytest.mark.parametrize("shape", ["student", "outlier"])
def test_robust_density_is_the_integral_over_the_parameter(shape: str) -> None:
    """By quadrature over one parameter; Laplace's method is good to some per cent."""
    case, rng = replay(60, 1), np.random.default_rng(2)
    data = noise_laws.draw_noise(case, Law(shape), 3, rng)

    def single(residual: np.ndarray) -> np.ndarray:
        if shape == "student":
            return stats.t(3).pdf(residual)
        far = stats.norm.cdf(np.abs(residual) - 8) - stats.norm.cdf(
            np.abs(residual) - 20
        )
        return 0.99 * stats.norm.pdf(residual) + 0.01 * far / 24.0

    log_densities = LawModel(case, Law(shape)).scores(data)[0]
    theta = np.linspace(-4.0, 4.0, 4001)
    for column, value in zip(data.T, log_densities, strict=True):
        residual = column[:, None] - case.slopes * theta
        logs = np.log(single(residual)).sum(axis=0) + stats.norm.logpdf(theta)
        wanted = logs.max() + np.log(
            integrate.trapezoid(np.exp(logs - logs.max()), theta)
        )
        assert value == pytest.approx(wanted, abs=0.05)


def test_noise_has_the_covariance_of_its_law() -> None:
    case, law = replay(8, 1), Law("white", 1.2, 0.7, 0.9)
    drawn = noise_laws.draw_noise(case, law, 40_000, np.random.default_rng(4))
    wanted = noise_laws.noise_covariance(case, law) + case.slopes @ case.slopes.T
    np.testing.assert_allclose(np.cov(drawn), wanted, atol=0.15)


def test_gaussian_effects_have_the_ratio_of_two_normal_densities() -> None:
    rng = np.random.default_rng(5)
    columns = rng.normal(size=(7, 3))
    columns /= np.linalg.norm(columns, axis=0)
    data, size = rng.normal(size=(7, 2)), 4.0
    both = np.eye(7) + size**2 * columns @ columns.T / 3.0
    wanted = stats.multivariate_normal(np.zeros(7), both).logpdf(data.T)
    wanted = wanted - stats.multivariate_normal(np.zeros(7), np.eye(7)).logpdf(data.T)
    ratio = observers._gaussian_ratio(columns, columns.T @ data, np.array([size]))
    np.testing.assert_allclose(ratio[0], wanted)


def test_an_observer_prefers_an_effect_that_acts() -> None:
    """Over all laws, and only where it acts."""
    case = replay(40, 1)
    rng = np.random.default_rng(6)
    noise = noise_laws.draw_noise(case, Law("white"), 20, rng)
    norm = np.linalg.norm(LawModel(case, Law("white")).whiten(case.change[:, None]))
    acting = dataclasses.replace(case, change=8.0 / norm * case.change)
    data = np.hstack([noise, noise + acting.change[:, None]])
    factors = observers.log_factors(acting, data, None, [], np.array([8.0]))
    exact = factors[observers.EXACT][0]
    assert (exact[:20] < 0.0).mean() > 0.9
    assert (exact[20:] > 0.0).mean() > 0.9
