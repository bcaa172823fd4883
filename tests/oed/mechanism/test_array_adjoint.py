"""Adjoints entry by entry, against LAPACK."""

from __future__ import annotations

import casadi as ca
import numpy as np
from shipped_models import hexapod

from oed.mechanism import Kinematics
from oed.mechanism.batch import MIN_ARRAY_POINTS
from oed.mechanism.graph import read_graph
from oed.mechanism.tape import AdjointRows, ArrayAdjoint

ROWS, COLUMNS, SIZE = 4, 3, 8
SCALE = np.array([1.0, 0.5, 2.0, 1.0])


def _adjoint() -> ArrayAdjoint:
    a, b = ca.SX.sym("a", ROWS, ROWS), ca.SX.sym("b", ROWS, COLUMNS)
    factors = ca.SX.sym("factors", ROWS)
    inputs = [ca.vec(a), ca.vec(b), factors]
    function = ca.Function("f", inputs, [a, (factors.T @ b)], {"cse": True})
    graph = read_graph(function)
    assert graph is not None
    return ArrayAdjoint(graph, SIZE, SCALE)


def _rows(a: np.ndarray, b: np.ndarray, right: np.ndarray) -> AdjointRows:
    count, channels, _ = right.shape
    rows = AdjointRows(
        np.empty((count, channels, COLUMNS)), np.empty(count), np.empty(count, bool)
    )
    inputs = [values.transpose(0, 2, 1).reshape(count, -1) for values in (a, b)]
    _adjoint().run(inputs, right, rows)
    return rows


def test_rows_and_condition(rng: np.random.Generator) -> None:
    count = SIZE - 3  # fewer points than the size
    a = rng.standard_normal((count, ROWS, ROWS)) + 3.0 * np.eye(ROWS)[[2, 0, 3, 1]]
    b, right = (rng.standard_normal((count, n, m)) for n, m in ((ROWS, 3), (2, ROWS)))
    rows = _rows(a, b, right)
    assert rows.accurate.all()
    np.testing.assert_allclose(rows.values, right @ np.linalg.inv(a) @ b, rtol=1e-11)
    condition = np.linalg.cond(a * SCALE)
    assert np.all(rows.condition >= condition)


def test_rows_of_several_channels_of_a_machine(rng: np.random.Generator) -> None:
    """Each channel's row, where rows share values with the matrices."""
    kinematics, count = Kinematics(hexapod.machine), MIN_ARRAY_POINTS + 3
    x, q = kinematics.inverse(np.tile(hexapod.machine.home_command, (count, 1)))
    tolerance = np.array([p.tolerance for p in hexapod.machine.parameters])
    p = tolerance * rng.standard_normal((count, len(tolerance)))
    x = x + 0.1 * rng.standard_normal(x.shape)
    slopes = rng.standard_normal((count, 3, 6))
    rows, condition = kinematics.slopes.pull_back(x, q, p, slopes)
    sensitivity, by_inverse = kinematics.slopes.over_parameters_with_condition(x, q, p)
    np.testing.assert_allclose(rows, slopes @ sensitivity, rtol=1e-9, atol=1e-11)
    assert np.all(condition > by_inverse / 6.0)


def test_the_bound_is_reached_where_the_other_singular_values_are_equal() -> None:
    """Of diag(s, 1, 1, 1) it is the condition number, 1 / s, up to s^2."""
    a = np.diag([1e-4, 1.0, 1.0, 1.0])[None] / SCALE
    rows = _rows(a, np.ones((1, ROWS, COLUMNS)), np.ones((1, 1, ROWS)))
    # the norm is that of three singular values, not the largest alone
    np.testing.assert_allclose(rows.condition, np.sqrt(3.0) * 1e4, rtol=1e-6)


def test_an_order_of_rows_that_fails_elsewhere_is_noticed() -> None:
    """The pivot of the first matrix is 0 in the second, and nearly so in the third."""
    turned = np.eye(ROWS)[[1, 0, 2, 3]]
    a = np.stack([np.eye(ROWS), turned, turned + 1e-9 * np.eye(ROWS)])
    rows = _rows(a, np.ones((3, ROWS, COLUMNS)), np.full((3, 1, ROWS), 0.7))
    assert rows.accurate.tolist() == [True, False, False]
    np.testing.assert_allclose(rows.values[0], 0.7 * ROWS, rtol=1e-14)


def test_a_singular_matrix_has_no_finite_condition() -> None:
    a = np.stack([np.eye(ROWS), np.zeros((ROWS, ROWS))])
    rows = _rows(a, np.ones((2, ROWS, COLUMNS)), np.ones((2, 1, ROWS)))
    assert rows.accurate.tolist() == [True, False]
    assert not rows.condition[1] < 1e300
