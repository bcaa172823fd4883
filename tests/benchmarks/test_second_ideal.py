"""The ideal observer of the second generator: noise laws against brute force."""

from __future__ import annotations

import dataclasses
import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import integrate, stats

from benchmarks.second import names, naming, noise_laws, observers
from benchmarks.second.noise_laws import Law, LawModel
from benchmarks.second.replay import Replay
from benchmarks.second.score import Scored


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


USUAL = Law("white", 0.5, 0.4, 0.8, single_sd=0.9, level_is_free=True)


def test_usual_laws_are_a_distribution_of_variance_one() -> None:
    """What a reading has alone and what is carried along are all of it."""
    grid = noise_laws.usual_laws()
    assert np.exp([law.log_prior for law in grid]).sum() == pytest.approx(1.0)
    whole = [law.single_sd**2 + law.ar_sd**2 for law in grid]
    np.testing.assert_allclose(whole, 1.0)
    runs = [law.run_sd for law in grid]
    assert np.median(runs) == pytest.approx(0.15, rel=0.05)


def test_density_of_a_free_level_is_the_integral_over_it() -> None:
    """By quadrature over the inverse gamma prior of the squared level.

    The change is as large whatever the level is.
    """
    case, rng = replay(12, 2), np.random.default_rng(8)
    data = noise_laws.draw_noise(case, USUAL, 2, rng)
    covariance = noise_laws.noise_covariance(case, USUAL)
    covariance = covariance + case.slopes @ case.slopes.T
    norm = np.sqrt(case.change @ np.linalg.solve(covariance, case.change))
    along = LawModel(case, USUAL).along(data, case.change, np.array([0.0, 5.0]))

    def density(log_level: float, residual: np.ndarray) -> float:
        square = np.exp(2.0 * log_level)
        normal = stats.multivariate_normal(np.zeros(12), square * covariance)
        prior = stats.invgamma(2.0, scale=2.0).pdf(square) * 2.0 * square
        return float(normal.pdf(residual) * prior)

    for size, row in zip((0.0, 5.0), along, strict=True):
        for column, value in zip(data.T, row, strict=True):
            residual = column - size * case.change / norm
            wanted = integrate.quad(density, -4.0, 4.0, (residual,), epsabs=0.0)[0]
            assert value == pytest.approx(np.log(wanted), abs=1e-6)


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
    sizes = np.array([size])
    gain, log_det = observers._gaussian_ratio(columns, columns.T @ data, sizes)
    np.testing.assert_allclose((gain - 0.5 * log_det)[0], wanted)


def test_an_observer_prefers_an_effect_that_acts() -> None:
    """Over all laws, and only where it acts."""
    case = replay(40, 1)
    rng = np.random.default_rng(6)
    noise = noise_laws.draw_noise(case, Law("white"), 20, rng)
    norm = np.linalg.norm(LawModel(case, Law("white")).whiten(case.change[:, None]))
    acting = dataclasses.replace(case, change=8.0 / norm * case.change)
    data = np.hstack([noise, noise + acting.change[:, None]])
    sizes, grid = np.array([8.0]), noise_laws.laws()
    factors = observers.log_factors(acting, data, None, [], sizes, grid)
    exact = factors[observers.EXACT][0]
    assert (exact[:20] < 0.0).mean() > 0.9
    assert (exact[20:] > 0.0).mean() > 0.9


def drawn_effects(columns: np.ndarray) -> observers.DrawnEffects:
    """Two listed effects and one that is not, of two draws each."""
    members = np.arange(6).reshape(3, 2)
    groups = {name: [(members[k], 1.0)] for k, name in enumerate("abc")}
    return observers.DrawnEffects(columns, groups, dict.fromkeys("abc", 1.0 / 3.0))


def test_names_have_the_posterior_of_dense_normal_densities() -> None:
    """None, single effects and the pair of listed ones, of two sizes under two laws."""
    case, rng = replay(14, 2), np.random.default_rng(9)
    drawn = drawn_effects(rng.normal(size=(14, 6)))
    often = names.Frequencies(0.4, {"a": 0.2, "b": 0.1, "c": 0.1}, 0.2, ("a", "b"))
    laws = [
        Law("white", log_prior=np.log(0.3)),
        Law("white", 0.9, log_prior=np.log(0.7)),
    ]
    sizes, data = np.array([2.0, 6.0]), 2.0 * rng.normal(size=(14, 2))
    found = names.log_posterior(case, data, drawn, often, sizes, laws)

    prior = {"": 0.4, "a": 0.2, "b": 0.1, "c": 0.1, "ab": 0.2}
    for column, posterior in zip(data.T, found, strict=True):
        for acting, share in prior.items():
            wanted = 0.0
            for law in laws:
                noise = noise_laws.noise_covariance(case, law)
                noise = noise + case.slopes @ case.slopes.T
                for chosen in itertools.product(sizes, repeat=len(acting)):
                    covariance = noise.copy()
                    for name, size in zip(acting, chosen, strict=True):
                        part = drawn.columns[:, drawn.groups[name][0][0]]
                        scaled = part / np.sqrt(
                            np.einsum("nk,nk->k", part, np.linalg.solve(noise, part))
                        )
                        covariance += size**2 * scaled @ scaled.T / 2.0
                    density = stats.multivariate_normal(np.zeros(14), covariance)
                    weight = share * np.exp(law.log_prior) / len(sizes) ** len(acting)
                    wanted += weight * density.pdf(column)
            value = posterior[frozenset(acting)]
            assert value == pytest.approx(np.log(wanted), abs=2e-3)
        assert len(posterior) == len(prior)


def test_right_names_are_those_of_the_label() -> None:
    effects = [
        {"effect": "gravity", "classes": ["gravity"], "outside": 9.0},
        {"effect": "step", "classes": ["mount_drift", "step"], "outside": 9.0},
    ]
    pair = Scored({"kind": "pair", "effects": effects}, {})
    assert naming.is_right(pair, frozenset({"gravity", "mount_drift"}))
    assert not naming.is_right(pair, frozenset({"gravity"}))
    single = Scored({"kind": "single", "effects": effects[1:]}, {})
    assert naming.is_right(single, frozenset({"mount_drift"}))
    assert not naming.is_right(single, frozenset({"gravity"}))
    assert not naming.is_right(single, frozenset())
    assert single.names_count
    never = Scored(
        {"kind": "unknown", "effects": [{"effect": "hose", "out_of_span": 7.0}]}, {}
    )
    assert naming.is_right(never, frozenset({"unknown"}))
    assert never.names_count
    assert not pair.names_count
