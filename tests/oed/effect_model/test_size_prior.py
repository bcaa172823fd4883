"""Sizes over decades: what is far beyond the expected size costs little and stays."""

import numpy as np
import pytest
from scipy import integrate, stats

from oed.effect_model import Effect
from oed.effect_model.size_prior import EFFECT_SIZES, UNKNOWN_SIZES


@pytest.mark.parametrize("prior", [EFFECT_SIZES, UNKNOWN_SIZES])
def test_the_prior_is_proper_and_ascends(prior):
    assert np.exp(prior.log_shares).sum() == pytest.approx(1.0)
    assert (np.diff(prior.values) > 0.0).all()
    assert np.diff(np.log10(prior.values)) == pytest.approx(0.5, abs=0.03)


def _density(beta: float) -> float:
    """Prior density of a coefficient, in expected sizes."""
    of_sizes = stats.norm.pdf(beta, scale=EFFECT_SIZES.values)
    return float(np.exp(EFFECT_SIZES.log_shares) @ of_sizes)


def test_a_decade_more_costs_a_decade_of_density_and_no_square():
    """About 1 / |beta| from 100 to 30 000 expected sizes; a normal one falls by e^-50."""
    for beta in (100.0, 300.0, 1000.0, 3000.0):
        assert _density(10.0 * beta) / _density(beta) == pytest.approx(0.1, rel=0.5)
    whole = integrate.quad(lambda u: np.exp(u) * _density(np.exp(u)), -20.0, 14.0)
    assert 2.0 * whole[0] == pytest.approx(1.0, abs=1e-3)


def test_sizes_that_nothing_shows_are_no_hypotheses():
    """But for the largest usual one; what is far keeps its share among those that show."""
    seen, weak = np.exp(EFFECT_SIZES.log_visible_shares(np.array([1.0, 1e-6])))
    usual = len(EFFECT_SIZES.usual)
    assert np.flatnonzero(seen[:usual]).tolist() == [5, 6]  # 10 and 30
    assert seen[:usual].sum() == pytest.approx(0.9)
    assert weak[:usual].tolist() == [0.0] * (usual - 1) + [pytest.approx(0.9)]
    assert EFFECT_SIZES.values[np.flatnonzero(weak)[1]] == 10_000.0
    assert weak.sum() == pytest.approx(1.0)


@pytest.mark.parametrize(("scale", "unit", "limit"), [
    (3.0, "K", 100.0 / 3.0), (4e-6, "m", 1e4), (1e-3, "m", 1e3), (50e-6, "1", 1e4),
])  # fmt: skip
def test_no_machine_has_a_hundred_kelvin_a_metre_or_ten_thousand_expected_sizes(
    scale, unit, limit
):
    effect = Effect(
        name="any", source="", about="", columns=lambda state: (), units={"*": unit}
    )
    assert effect.size_limit("size", scale) == pytest.approx(limit)
