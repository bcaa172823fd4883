"""Newton's method entry by entry: against closed forms, LAPACK and the careful steps."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from shipped_models import a3_head, hexapod, linear_delta

from oed.mechanism import Kinematics, batch, newton
from oed.mechanism.graph import read_graph
from oed.mechanism.tape import ArrayNewton, Elimination
from oed.model import Machine

Z, A = ca.SX.sym("z", 2), ca.SX.sym("a", 2)
TOLERANCE, LONGEST, SIZE = newton.STEP_TOLERANCE, 0.2, 8


def newton_of(equations: ca.SX, size: int = SIZE) -> ArrayNewton:
    outputs = [ca.densify(equations), ca.densify(ca.jacobian(equations, Z))]
    function = ca.Function("f", [Z, A], outputs, {"cse": True})
    graph = read_graph(function)
    assert graph is not None
    return ArrayNewton(graph, size, 1)


#: z0^2 = a0 and z0 z1 = a1, which has a closed form
SQUARES = ca.vertcat(Z[0] ** 2 - A[0], Z[0] * Z[1] - A[1])


def test_solutions_are_the_closed_form(rng: np.random.Generator) -> None:
    a = rng.uniform(1.0, 1.2, (SIZE - 2, 2))  # fewer systems than the size
    z = np.column_stack([np.sqrt(a[:, 0]), a[:, 1] / np.sqrt(a[:, 0])])
    start = z + rng.uniform(-0.05, 0.05, z.shape)
    solver = newton_of(SQUARES)
    for _ in range(2):
        (found,), solved, _ = solver.solve([start, a], TOLERANCE, LONGEST)
        assert solved.all()
        np.testing.assert_allclose(found, z, rtol=1e-15, atol=0.0)


def test_what_has_no_solution_is_not_solved_and_disturbs_no_other() -> None:
    a = np.array([[1.0, 1.0], [-1.0, 1.0], [np.nan, 1.0], [1.21, 1.1]])
    start = np.full((4, 2), 1.05)
    (found,), solved, _ = newton_of(SQUARES).solve([start, a], TOLERANCE, LONGEST)
    assert solved.tolist() == [True, False, False, True]
    np.testing.assert_allclose(found[[0, 3]], [[1.0, 1.0], [1.1, 1.0]], rtol=1e-15)


def test_a_double_root_is_not_solved() -> None:
    """Steps halve there: a short one does not show that the error is short."""
    equations = ca.vertcat((Z[0] - A[0]) ** 2, Z[1] - A[1])
    a = np.ones((3, 2))
    start = a + np.array([[1e-8, 0.0], [1e-9, 0.0], [1e-3, 0.0]])
    _, solved, _ = newton_of(equations).solve([start, a], TOLERANCE, LONGEST)
    assert not solved.any()


def test_a_step_longer_than_the_longest_is_left_to_careful_steps() -> None:
    a, start = np.ones((2, 2)), np.array([[1.3, 1.0], [1.01, 1.0]])
    _, solved, _ = newton_of(SQUARES).solve([start, a], TOLERANCE, LONGEST)
    assert solved.tolist() == [False, True]


def test_an_order_of_rows_that_fails_elsewhere_is_noticed() -> None:
    """The pivot of the first system is 0 in the second: no order serves both."""
    turned = ca.vertcat(
        ca.cos(A[0]) * Z[0] + ca.sin(A[0]) * Z[1], -ca.sin(A[0]) * Z[0] + Z[1]
    )
    a = np.array([[0.0, 0.0], [np.pi / 2.0, 0.0]])
    start = np.full((2, 2), 0.01)
    (found,), solved, _ = newton_of(turned).solve([start, a], TOLERANCE, LONGEST)
    assert solved[0]
    assert np.abs(found[solved]).max() < 1e-15


def test_elimination_is_that_of_lapack(rng: np.random.Generator) -> None:
    matrices = np.eye(5) + 0.3 * rng.standard_normal((SIZE, 5, 5))
    matrices = matrices[:, [3, 0, 4, 1, 2]]  # needs another order of rows
    right = rng.standard_normal((SIZE, 5))
    entries = np.ascontiguousarray(matrices.transpose(1, 2, 0))
    elimination = Elimination(5, SIZE)
    elimination.choose_order(entries)
    elimination.factorise(entries)
    wanted = np.linalg.solve(matrices, right[:, :, None])[:, :, 0]
    np.testing.assert_allclose(
        elimination.solve(right.T.copy()).T, wanted, rtol=1e-9, atol=1e-11
    )


@pytest.mark.parametrize(
    "machine",
    [a3_head.machine, hexapod.machine, linear_delta.machine],
    ids=lambda m: m.name,
)
def test_poses_are_those_of_careful_steps(
    machine: Machine, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where some poses cannot be assembled, and for starts that vectors share."""
    kinematics, count = Kinematics(machine), batch.MIN_ARRAY_POINTS + 5
    lower = np.array([c.lower for c in machine.command])
    upper = np.array([c.upper for c in machine.command])
    command = machine.home_command + 0.3 * (
        rng.uniform(lower, upper, (count, len(lower))) - machine.home_command
    )
    x, q = kinematics.inverse(command)
    tolerance = np.array([p.tolerance for p in machine.parameters])
    p = machine.nominal + 3.0 * tolerance * rng.standard_normal((count, len(tolerance)))
    q[7] += 10.0
    few = slice(0, 8), slice(0, 40)
    together = kinematics.try_forward_per_pose(q, p, x)
    shared = kinematics.try_forward(q[few[0]], p[few[1]], x[few[0]])
    monkeypatch.setattr(batch, "MIN_ARRAY_POINTS", 10**9)
    careful = kinematics.try_forward_per_pose(q, p, x)
    assert np.flatnonzero(careful[1]).tolist() == [7]
    assert np.array_equal(together[1], careful[1])
    closed = ~careful[1]
    assert np.abs(together[0] - careful[0])[closed].max() < 1e-13
    one_by_one = [kinematics.try_forward(q[:8], row, x[:8])[0] for row in p[:40]]
    assert np.array_equal(shared[1], np.tile(np.arange(8) == 7, (40, 1)))
    assert np.abs(shared[0] - one_by_one)[:, :7].max() < 1e-13
