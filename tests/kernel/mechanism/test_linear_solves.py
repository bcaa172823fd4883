"""Linear equations of many poses at once, some of them singular, worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from oed.mechanism.newton import solve_linear

#: x + y, x - y; its inverse by hand is half of itself
REGULAR = np.array([[1.0, 1.0], [1.0, -1.0]])
SINGULAR = np.array([[1.0, 2.0], [2.0, 4.0]])
RIGHT = np.array([[3.0, 0.0], [1.0, 2.0]])


def test_a_singular_pose_leaves_the_solutions_of_the_others() -> None:
    """Wherever it stands among them."""
    by_hand = np.array([[2.0, 1.0], [1.0, -1.0]])
    for place in range(3):
        matrices = np.stack([REGULAR] * 3)
        matrices[place] = SINGULAR
        solutions = solve_linear(matrices, np.stack([RIGHT] * 3))
        assert np.isnan(solutions[place]).all()
        for other in {0, 1, 2} - {place}:
            assert solutions[other] == pytest.approx(by_hand)


def test_a_pose_without_numbers_beside_a_singular_one_has_none() -> None:
    matrices = np.stack([REGULAR, SINGULAR, np.full((2, 2), np.nan)])
    solutions = solve_linear(matrices, np.stack([RIGHT] * 3))
    assert np.isfinite(solutions[0]).all()
    assert np.isnan(solutions[1:]).all()
