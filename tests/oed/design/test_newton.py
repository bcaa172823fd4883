"""Newton steps over weights against SciPy's constrained solver."""

import numpy as np
import pytest
from scipy import optimize

from oed.design.relaxation import project_to_sum, scale_to_size


def test_weights_scaled_to_a_size_keep_their_ratios_within_caps():
    scaled = scale_to_size(np.array([1.0, 2.0, 9.0]), 6.0, np.full(3, 3.0))
    assert scaled == pytest.approx([1.0, 2.0, 3.0])
    assert scale_to_size(np.ones(4), 2.0, np.full(4, 3.0)) == pytest.approx([0.5] * 4)


def test_weights_beyond_the_size_at_their_caps_are_scaled_down():
    for weights in (np.array([1.2, 1.2, 0.03]), np.ones(3)):
        scaled = scale_to_size(weights, 1.5, np.ones(3))
        assert scaled.sum() == pytest.approx(1.5)
        assert ((scaled > 0.0) & (scaled <= 1.0)).all()


@pytest.mark.parametrize("seed", range(6))
def test_the_projection_is_the_root_that_brentq_finds(seed):
    """Caps that are equal or not, and sums from almost nothing to almost all of them."""
    rng = np.random.default_rng(seed)
    caps = np.full(9, 0.7) if seed % 2 else rng.uniform(0.1, 2.0, 9)
    wanted = np.round(rng.standard_normal(9), 1)  # some are equal
    for share in (1e-6, 0.2, 0.5, 0.8, 1.0 - 1e-6):
        total = share * float(caps.sum())

        def excess(shift: float, total: float = total) -> float:
            return float(np.clip(wanted - shift, 0.0, caps).sum()) - total

        root = optimize.brentq(excess, -4.0, 4.0, xtol=1e-14)
        projected = project_to_sum(wanted, total, caps)
        assert projected == pytest.approx(np.clip(wanted - root, 0.0, caps), abs=1e-12)
        assert projected.sum() == pytest.approx(total, rel=1e-14)


def test_a_projection_onto_the_sum_of_the_caps_is_the_caps():
    caps = np.array([0.3, 1.0, 2.0])
    assert project_to_sum(np.array([5.0, -1.0, 0.0]), 3.3, caps) == pytest.approx(caps)
    assert project_to_sum(np.array([5.0, -1.0, 0.0]), 0.0, caps) == pytest.approx(
        np.zeros(3)
    )
