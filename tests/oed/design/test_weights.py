"""Weights by each solver: the same optimum, and a plan of the largest."""

import numpy as np
import pytest

from oed.design import CRITERIA
from oed.design.design_problem import choose_by_weights


@pytest.mark.parametrize("criterion", CRITERIA.weighed)
def test_solvers_agree(criterion, rng):
    rows = rng.standard_normal((40, 2, 4)) @ np.diag([0.1, 1.0, 3.0, 10.0])
    prior = np.diag([1.0, 0.1, 0.1, 1.0])
    built_in = choose_by_weights(rows, 6, criterion, prior)
    conic = choose_by_weights(rows, 6, criterion, prior, "clarabel")
    assert built_in.value == pytest.approx(conic.value, rel=3e-4)
    assert built_in.bound == pytest.approx(conic.bound, rel=3e-4)
    assert built_in.weights.sum() == pytest.approx(6.0)
    heaviest = np.argsort(-built_in.weights)[:6]
    assert set(built_in.choice.indices) == set(heaviest)
    efficiency = built_in.choice.efficiency
    assert efficiency is not None
    assert 0.0 < efficiency <= 1.0


def test_too_few_readings_are_refused():
    """Too few readings are refused; three take the two that nothing replaces."""
    rows = np.vstack([np.eye(3)[[0, 1]], np.tile(np.eye(3)[2], (6, 1))])
    rows[:2] *= 1e-3
    with pytest.raises(ValueError, match="3 directions"):
        choose_by_weights(rows[:, [2, 0, 1]], 2)
    plan = choose_by_weights(rows, 3).choice
    assert {0, 1} < set(plan.indices)
