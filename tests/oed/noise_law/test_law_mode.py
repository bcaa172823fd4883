"""The most probable noise law: where it is does not hang on rounding."""

import numpy as np

from oed.noise_law import marginal


def test_the_mode_of_a_law_does_not_hang_on_rounding() -> None:
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
