"""Linear equations of many poses at once, some of them singular, worked by hand."""

import numpy as np
import pytest

from oed.base import Array, Index
from oed.mechanism import newton
from oed.mechanism.newton import solve_linear

#: x + y, x - y; its inverse by hand is half of itself
REGULAR = np.array([[1.0, 1.0], [1.0, -1.0]])
SINGULAR = np.array([[1.0, 2.0], [2.0, 4.0]])
RIGHT = np.array([[3.0, 0.0], [1.0, 2.0]])


def test_a_singular_pose_leaves_the_solutions_of_the_others():
    """Wherever it stands among them."""
    by_hand = np.array([[2.0, 1.0], [1.0, -1.0]])
    for place in range(3):
        matrices = np.stack([REGULAR] * 3)
        matrices[place] = SINGULAR
        solutions = solve_linear(matrices, np.stack([RIGHT] * 3))
        assert np.isnan(solutions[place]).all()
        for other in {0, 1, 2} - {place}:
            assert solutions[other] == pytest.approx(by_hand)


def test_a_pose_without_numbers_beside_a_singular_one_has_none():
    matrices = np.stack([REGULAR, SINGULAR, np.full((2, 2), np.nan)])
    solutions = solve_linear(matrices, np.stack([RIGHT] * 3))
    assert np.isfinite(solutions[0]).all()
    assert np.isnan(solutions[1:]).all()


def test_blocks_of_systems_are_solved_as_one(monkeypatch):
    """Square roots, of which one fails, in blocks of two."""
    goal = np.array([0.01, 0.04, -1.0, 0.09, 0.16])

    def equations(z: Array, rows: Index) -> list[Array]:
        return [z**2 - goal[rows, None], 2.0 * z[..., None]]

    monkeypatch.setattr(newton, "BLOCK_ROWS", 2)
    roots, failed = newton.solve(equations, np.full((5, 1), 0.3))
    assert failed.tolist() == [False, False, True, False, False]
    assert roots[~failed, 0] == pytest.approx([0.1, 0.2, 0.3, 0.4])
