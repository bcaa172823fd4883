"""Smoothed importance weights against ArviZ, and the fitted tail against its truth."""

import math

import numpy as np
import pytest
from arviz_stats import base

from oed.posterior.importance import fit_pareto, smoothed_weights


@pytest.mark.parametrize("count", [200, 1000, 5000])
@pytest.mark.parametrize("freedom", [2.0, 5.0, 30.0])
def test_weights_are_smoothed_as_by_arviz(count, freedom):
    rng = np.random.default_rng([count, int(freedom)])
    log_weights = rng.standard_t(freedom, count)
    weights, k = smoothed_weights(log_weights)
    wanted, wanted_k = base.array_stats.psislw(-log_weights)
    assert weights == pytest.approx(np.exp(wanted), rel=1e-9)
    assert k == pytest.approx(float(wanted_k), rel=1e-9)


@pytest.mark.parametrize("shape", [-0.3, 0.2, 0.7])
def test_the_shape_of_a_pareto_tail_is_found(shape):
    """Quantiles of the distribution itself: F^-1(p) = scale ((1 - p)^-k - 1) / k."""
    levels = np.arange(0.5, 5000) / 5000
    excess = 2.0 * ((1.0 - levels) ** -shape - 1.0) / shape
    found, scale = fit_pareto(excess)
    assert found == pytest.approx(shape, abs=0.01)
    assert scale == pytest.approx(2.0, rel=0.02)


def test_equal_weights_have_no_tail_and_few_have_no_shape():
    assert smoothed_weights(np.zeros(1000))[1] == 0.0
    weights, k = smoothed_weights(np.log([1.0, 3.0]))
    assert k == math.inf
    assert weights == pytest.approx([0.25, 0.75])
