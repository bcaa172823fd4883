"""Newton steps over weights against SciPy's constrained solver."""

import numpy as np
import pytest
from scipy import optimize

from oed.design.forms.determinant import Determinant
from oed.design.objective import CriterionObjective
from oed.design.relaxation import newton_steps, project_to_sum, scale_to_size


def test_weights_scaled_to_a_size_keep_their_ratios_within_caps() -> None:
    scaled = scale_to_size(np.array([1.0, 2.0, 9.0]), 6.0, np.full(3, 3.0))
    assert scaled == pytest.approx([1.0, 2.0, 3.0])
    assert scale_to_size(np.ones(4), 2.0, np.full(4, 3.0)) == pytest.approx([0.5] * 4)


def test_weights_beyond_the_size_at_their_caps_are_scaled_down() -> None:
    for weights in (np.array([1.2, 1.2, 0.03]), np.ones(3)):
        scaled = scale_to_size(weights, 1.5, np.ones(3))
        assert scaled.sum() == pytest.approx(1.5)
        assert ((scaled > 0.0) & (scaled <= 1.0)).all()


@pytest.mark.parametrize("seed", range(3))
def test_steps_end_at_the_constrained_maximum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    blocks, base = rng.standard_normal((8, 1, 3)), 0.1 * np.eye(3)
    objective = CriterionObjective(Determinant(3), blocks, base)
    active, caps = np.arange(8), np.full(8, 0.9)
    weights = np.full(8, 0.5)
    for _ in range(5):
        before = objective.value(active, weights)
        weights = newton_steps(objective, active, weights, caps)
        assert objective.value(active, weights) >= before - 1e-12
    assert weights.sum() == pytest.approx(4.0)
    assert (weights >= 0.0).all()
    assert (weights <= caps).all()

    def negative(w: np.ndarray) -> float:
        m = base + np.einsum("c,ckn,ckm->nm", w, blocks, blocks)
        return -float(np.linalg.slogdet(m)[1]) / 3.0

    other = optimize.minimize(
        negative,
        np.full(8, 0.5),
        method="SLSQP",
        bounds=[(0.0, 0.9)] * 8,
        constraints={"type": "eq", "fun": lambda w: w.sum() - 4.0},
        options={"ftol": 1e-12, "maxiter": 500},
    )
    assert objective.value(active, weights) == pytest.approx(-other.fun, abs=1e-7)


@pytest.mark.parametrize("seed", range(6))
def test_the_projection_is_the_root_that_brentq_finds(seed: int) -> None:
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


def test_a_projection_onto_the_sum_of_the_caps_is_the_caps() -> None:
    caps = np.array([0.3, 1.0, 2.0])
    assert project_to_sum(np.array([5.0, -1.0, 0.0]), 3.3, caps) == pytest.approx(caps)
    assert project_to_sum(np.array([5.0, -1.0, 0.0]), 0.0, caps) == pytest.approx(
        np.zeros(3)
    )
