"""Batches and linear equations of many poses against plain NumPy."""

import casadi as ca
import numpy as np
import pytest

from oed.base import Array, Index
from oed.mechanism import BatchedFunction, newton
from oed.mechanism.batch import MIN_ARRAY_POINTS
from oed.mechanism.newton import solve_linear
from oed.mechanism.tape import CHUNK_SIZES, TAPE_SIZES

A, B = ca.SX.sym("a", 3), ca.SX.sym("b", 2)
SIZES = sorted(
    {3, 100, MIN_ARRAY_POINTS - 1, MIN_ARRAY_POINTS, 5000}
    | {size + more for size in (*CHUNK_SIZES, *TAPE_SIZES) for more in (0, 1)}
)


@pytest.fixture(scope="module")
def function() -> BatchedFunction:
    return BatchedFunction(
        "f", [A, B], [A * ca.sum1(B), A @ B.T + 1.0, ca.sum1(A) / A[0]]
    )


def expected(a: np.ndarray, b: np.ndarray) -> list[np.ndarray]:
    return [
        a * b.sum(1)[:, None],
        a[:, :, None] * b[:, None, :] + 1.0,
        (a.sum(1) / a[:, 0])[:, None],
    ]


def same(got: list[np.ndarray], want: list[np.ndarray]) -> bool:
    return all(
        g.shape == w.shape and np.allclose(g, w, rtol=1e-14, atol=0)
        for g, w in zip(got, want, strict=True)
    )


@pytest.mark.parametrize("n", SIZES)
def test_batches_of_any_size_equal_numpy(function, rng, n):
    a, b = rng.uniform(1, 2, (n, 3)), rng.uniform(1, 2, (n, 2))
    assert same(function(a, b), expected(a, b))


def test_one_row_serves_all(function, rng):
    a, b = rng.uniform(1, 2, (70, 3)), rng.uniform(1, 2, 2)
    wide = np.tile(b, (70, 1))
    assert same(function(a, b), expected(a, wide))
    assert same(function(a, b[None]), expected(a, wide))
    assert same(function(a[0], b), expected(a[:1], wide[:1]))


def test_results_are_not_overwritten_by_the_next_call(function, rng):
    a, b = rng.uniform(1, 2, (10, 3)), rng.uniform(1, 2, (10, 2))
    first = function(a, b)
    kept = [r.copy() for r in first]
    function(a + 5.0, b - 5.0)
    assert all((r == k).all() for r, k in zip(first, kept, strict=True))


def test_inputs_may_be_views_and_are_left_alone(function, rng):
    a, b = rng.uniform(1, 2, (3, 12)).T[::2], rng.uniform(1, 2, (6, 4))[:, ::2]
    before = a.copy(), b.copy()
    assert same(function(a, b), expected(*before))
    assert (a == before[0]).all()
    assert (b == before[1]).all()


def test_an_empty_input_and_an_empty_batch():
    none = ca.SX.sym("none", 0)
    square = BatchedFunction("g", [A, none], [A**2, ca.jacobian(A, none)])
    value, slope = square(np.full((5, 3), 2.0), np.zeros((5, 0)))
    assert (value == 4.0).all()
    assert slope.size == 0
    assert square(np.zeros((0, 3)), np.zeros((0, 0)))[0].shape == (0, 3)


def test_a_batch_of_the_wrong_length_is_refused(function):
    with pytest.raises(ValueError, match="broadcast"):
        function(np.ones((4, 3)), np.ones((3, 2)))


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
