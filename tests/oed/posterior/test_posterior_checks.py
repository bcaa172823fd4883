"""Posterior predictive checks of white noise, whose law is known."""

import functools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from kernel.delta_probe import problem
from oed.measurement import reading_structure
from oed.posterior import predictive_checks
from oed.posterior.posterior import DISCREPANCIES

problem_once = functools.cache(functools.partial(problem, distances=False))


def checks_of(residual: np.ndarray, seed: int = 1) -> dict[str, Any]:
    """Checks where the posterior is one point, off the readings by residuals (N,)."""
    m, series, _, estimate = problem_once()
    y = m.readings(series, estimate.theta) + residual * m.sigma(series)
    posterior: Any = SimpleNamespace(pooled=np.tile(estimate.theta, (2000, 1)))
    rng = np.random.default_rng(seed)
    return predictive_checks(m, series, y, estimate, posterior, rng)


@pytest.mark.parametrize("size", [0.8, 1.0, 1.2])
def test_shares_of_rms_and_largest_are_those_of_normal_noise(size):
    """Chi-squared, and the largest of independent normal errors; 400 draws."""
    n = len(problem_once()[2])
    residual = size * np.where(np.arange(n) % 2, 1.0, -1.0)
    checks = checks_of(residual)
    rms, largest = checks["rms"], checks["largest"]
    assert (rms.observed, largest.observed) == pytest.approx((size, size), rel=1e-5)
    chi2 = stats.chi2(n)
    assert rms.p_high == pytest.approx(chi2.sf(n * size**2), abs=0.08)
    assert rms.low == pytest.approx(np.sqrt(chi2.ppf(0.025) / n), rel=0.08)
    assert rms.high == pytest.approx(np.sqrt(chi2.ppf(0.975) / n), rel=0.08)
    within = (2.0 * stats.norm.cdf(size) - 1.0) ** n
    assert largest.p_high == pytest.approx(1.0 - within, abs=0.05)
    assert not rms.alarming
    assert checks_of(5.0 * residual)["rms"].alarming


def test_discrepancies_are_their_formulas():
    m, series, _, estimate = problem_once()
    structure = reading_structure(m, series, estimate.theta)
    n = len(structure)
    errors = np.random.default_rng(2).standard_normal((3, n))
    values = {name: one(structure, errors) for name, one in DISCREPANCIES.items()}
    assert values["rms"] == pytest.approx(np.sqrt((errors**2).mean(axis=1)))
    assert values["largest"] == pytest.approx(np.abs(errors).max(axis=1))
    chains = [np.flatnonzero(structure.chain == c) for c in range(len(structure.run))]
    products = []
    for chain in chains:
        ordered = errors[:, chain[np.argsort(structure.position[chain])]]
        products.append(ordered[:, 1:] * ordered[:, :-1])
    joined = np.hstack(products)
    if joined.size:
        expected = joined.mean(axis=1) / (errors**2).mean(axis=1)
        assert values["neighbours"] == pytest.approx(expected)
    if len(chains) > 1:
        means = np.array([errors[:, c].mean(axis=1) for c in chains])
        expected = np.sqrt((means**2).mean(axis=0))
        assert values["run_means"] == pytest.approx(expected)
