"""Noise laws: how well a stated one is known; the mode does not hang on rounding."""

import numpy as np
import pytest

from oed.noise import NoiseStatement
from oed.noise_law import NoisePrior, marginal


def test_the_mode_of_a_law_does_not_hang_on_rounding():
    """A cost of some hundreds, whose search alone ends a few hundredths away."""
    turned, _ = np.linalg.qr(np.random.default_rng(2).standard_normal((4, 4)))
    curvature = turned @ np.diag([0.7, 1.0, 4.0, 30.0]) @ turned.T
    wanted = np.array([0.3, -1.2, 0.8, 0.1])

    def cost(u: np.ndarray) -> np.ndarray:
        offset = u - wanted
        bent = np.sqrt(1.0 + np.einsum("li,ij,lj->l", offset, curvature, offset))
        return 900.0 + bent + 0.02 * offset[:, 0] ** 4

    starts = np.zeros((2, 4))
    starts[1, 0] = 2.0
    mode = marginal.polish(cost, marginal.find_mode(cost, starts, 4.5), 4.5)
    np.testing.assert_allclose(mode, wanted, atol=1e-3)
    root = marginal._signed(marginal.root_about(cost, mode))
    largest = np.argmax(np.abs(root), axis=0)
    assert (root[largest, range(4)] > 0.0).all()


def test_a_stated_law_is_known_to_a_third_or_a_half():
    """A deviation on is a reach of 1.35, sizes of 1.5, and a share of odds twice those stated."""
    names = ("scale", NoisePrior.CORRELATED, NoisePrior.REACH)
    names = (*names, NoisePrior.STATED_RUN, NoisePrior.STATED_SEATING)
    prior = NoisePrior(names, 1, NoiseStatement(correlated=0.4, reach=6.0))
    middle, ahead = (prior.laws(np.full((1, 5), u)) for u in (0.0, 1.0))
    assert middle.reach == pytest.approx([6.0])
    assert ahead.reach == pytest.approx([6.0 * 1.35], rel=0.01)
    for size in (ahead.stated_level, ahead.stated_seat):
        assert size == pytest.approx([1.5], rel=0.01)
    assert ahead.correlated == pytest.approx([4.0 / 7.0], rel=0.01)
