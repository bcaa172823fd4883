"""Compiled functions: against NumPy, the array code, closed forms and LAPACK."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from kernel.mechanism.compiling import compiled, compiled_files, needs_compiler
from oed.mechanism import BatchedFunction, batch, begin_job, newton
from oed.mechanism import compiled as lanes
from oed.mechanism.batch import CompileSettingError, CompileSwitch
from oed.mechanism.tape import SolvedSystems

__all__ = ["compiled_files"]
pytestmark = [needs_compiler, pytest.mark.usefixtures("compiled_files")]

X, Y = ca.SX.sym("x"), ca.SX.sym("y")
Z, A = ca.SX.sym("z", 2), ca.SX.sym("a", 2)
TOLERANCE, LONGEST = newton.STEP_TOLERANCE, 0.2
COUNTS = (1, 7, 8, 9, 200)
SPECIAL = np.array([0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 1e-310, 1e300])


def batched(inputs: list[ca.SX], outputs: list[ca.SX]) -> BatchedFunction:
    return compiled(lambda: BatchedFunction("f", inputs, outputs))


ONE = {
    "neg": (-X, np.negative),
    "square": (X * X, np.square),
    "twice": (X + X, lambda x: 2.0 * x),
    "inverse": (1.0 / X, np.reciprocal),
    "sqrt": (ca.sqrt(X), np.sqrt),
    "exp": (ca.exp(X), np.exp),
    "log": (ca.log(X), np.log),
    "sin": (ca.sin(X), np.sin),
    "cos": (ca.cos(X), np.cos),
    "tan": (ca.tan(X), np.tan),
    "asin": (ca.asin(X), np.arcsin),
    "acos": (ca.acos(X), np.arccos),
    "atan": (ca.atan(X), np.arctan),
    "sinh": (ca.sinh(X), np.sinh),
    "cosh": (ca.cosh(X), np.cosh),
    "tanh": (ca.tanh(X), np.tanh),
    "abs": (ca.fabs(X), np.abs),
    "sign": (ca.sign(X), np.sign),
    "floor": (ca.floor(X), np.floor),
    "ceil": (ca.ceil(X), np.ceil),
    "not": (ca.logic_not(X), np.logical_not),
}
TWO = {
    "add": (X + Y, np.add),
    "sub": (X - Y, np.subtract),
    "mul": (X * Y, np.multiply),
    "div": (X / Y, np.divide),
    "pow": (X**Y, np.power),
    "atan2": (ca.atan2(X, Y), np.arctan2),
    "hypot": (ca.hypot(X, Y), np.hypot),
    "copysign": (ca.copysign(X, Y), np.copysign),
    "fmin": (ca.fmin(X, Y), np.fmin),
    "fmax": (ca.fmax(X, Y), np.fmax),
    "fmod": (ca.fmod(X, Y), np.fmod),
    "less": (X < Y, np.less),
    "less_equal": (X <= Y, np.less_equal),
    "equal": (X == Y, np.equal),
    "not_equal": (X != Y, np.not_equal),
    "and": (ca.logic_and(X, Y), np.logical_and),
    "or": (ca.logic_or(X, Y), np.logical_or),
    "if": (ca.if_else(X < Y, 1.0 / X, Y), lambda x, y: np.where(x < y, 1.0 / x, y)),
}


@pytest.mark.filterwarnings(
    "ignore::RuntimeWarning"
)  # of NumPy, where there is no value
def test_every_operation_equals_numpy(rng: np.random.Generator) -> None:
    outputs = [formula for formula, _ in (ONE | TWO).values()]
    function = batched([X, Y], outputs)
    for n in COUNTS:
        x, y = rng.uniform(-2.0, 2.0, (2, n))
        if n > len(SPECIAL) ** 2:
            x[: len(SPECIAL) ** 2] = np.repeat(SPECIAL, len(SPECIAL))
            y[: len(SPECIAL) ** 2] = np.tile(SPECIAL, len(SPECIAL))
        want = [call(x) for _, call in ONE.values()]
        want += [call(x, y) for _, call in TWO.values()]
        got = function(x[:, None], y[:, None])
        assert function._compiled[lanes.Evaluation] is not None
        for name, values, numbers in zip(ONE | TWO, got, want, strict=True):
            np.testing.assert_allclose(
                values[:, 0], numbers, rtol=5e-16, atol=0.0, err_msg=name
            )


def test_sines_and_cosines_are_within_an_ulp_or_two() -> None:
    """Against 80 bits, where the machine has them, near multiples of pi/2 too."""
    if np.finfo(np.longdouble).eps > 1e-18:
        pytest.skip("no long doubles on this processor")
    turns = np.pi / 2.0 * np.arange(-300, 301)
    near = np.concatenate([turns, np.nextafter(turns, 1e9), turns + 1e-9])
    wide = np.concatenate(
        [np.linspace(-1e5, 1e5, 4001), [1e5 + 1.0, 1e9, -1e22, 1e300]]
    )
    small = np.geomspace(1e-300, 10.0, 1001)
    angles = np.concatenate([near, wide, small, -small, [0.0]])
    sine, cosine = batched([X], [ca.sin(X), ca.cos(X)])(angles[:, None])
    for got, exact in ((sine, np.sin), (cosine, np.cos)):
        want = exact(angles.astype(np.longdouble))
        scale = np.maximum(np.abs(want), 1e-15).astype(float)
        assert (np.abs(got[:, 0] - want) / np.spacing(scale)).max() < 2.0


def test_a_point_does_not_depend_on_its_neighbours(rng: np.random.Generator) -> None:
    function = batched([A, Z], [ca.sin(A) * Z, A @ Z.T / A[0]])
    a, z = rng.uniform(1.0, 2.0, (2, 20, 2))
    together = function(a, z)
    a[5], z[11] = np.nan, np.inf
    for k in (0, 4, 6, 12, 19):
        for every, alone in zip(together, function(a[k], z[k]), strict=True):
            assert every[k].tolist() == alone[0].tolist()


def test_inputs_lie_anywhere(rng: np.random.Generator) -> None:
    function = batched([A, Z], [A + 2.0 * Z])
    wide = rng.uniform(1.0, 2.0, (30, 8))
    a, z = wide[::2, 1:3], wide[::-2, ::4]  # rows apart, columns apart
    np.testing.assert_array_equal(function(a, z)[0], a + 2.0 * z)
    whole = np.arange(30).reshape(15, 2)
    np.testing.assert_array_equal(function(whole, z[3])[0], whole + 2.0 * z[3])
    assert function(np.zeros((0, 2)), z[3])[0].shape == (0, 2)


def test_inputs_of_another_size_are_refused() -> None:
    function = batched([A, Z], [A + Z])
    for a, z in (((9, 3), (9, 2)), ((9, 2), (9, 1)), ((9, 2), (8, 2))):
        with pytest.raises(ValueError, match=r"entries|broadcast"):
            function(np.ones(a), np.ones(z))


def test_a_very_long_function_is_not_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lanes, "MAX_INSTRUCTIONS", 3)
    function = batched([A, Z], [A + Z])
    assert function(np.ones(2), np.ones(2))[0].tolist() == [[2.0, 2.0]]
    assert function._compiled[lanes.Evaluation] is None


# -- Newton's method -------------------------------------------------------------------

#: z0^2 = a0 and z0 z1 = a1, which has a closed form
SQUARES = ca.vertcat(Z[0] ** 2 - A[0], Z[0] * Z[1] - A[1])


def solve(equations: ca.SX, start: np.ndarray, a: np.ndarray) -> SolvedSystems:
    function = batched([Z, A], [equations, ca.jacobian(equations, Z)])
    solution = function.solve([start, a], 1, TOLERANCE, LONGEST)
    assert function._compiled[lanes.Newton] is not None
    return solution


@pytest.mark.parametrize("n", COUNTS)
def test_solutions_are_the_closed_form(rng: np.random.Generator, n: int) -> None:
    a = rng.uniform(1.0, 1.2, (n, 2))
    z = np.column_stack([np.sqrt(a[:, 0]), a[:, 1] / np.sqrt(a[:, 0])])
    (x,), solved, near = solve(SQUARES, z + rng.uniform(-0.05, 0.05, z.shape), a)
    assert solved.all()
    assert not near.any()
    np.testing.assert_allclose(x, z, rtol=4e-16, atol=0.0)


def test_what_has_no_solution_is_not_solved_and_disturbs_no_other() -> None:
    a = np.array([[1.0, 1.0], [-1.0, 1.0], [np.nan, 1.0], [1.21, 1.1]])
    (x,), solved, _ = solve(SQUARES, np.full((4, 2), 1.05), a)
    assert solved.tolist() == [True, False, False, True]
    np.testing.assert_allclose(x[[0, 3]], [[1.0, 1.0], [1.1, 1.0]], rtol=1e-15)


def test_a_double_root_is_not_solved() -> None:
    """Steps halve there: a short one does not show that the error is short."""
    equations = ca.vertcat((Z[0] - A[0]) ** 2, Z[1] - A[1])
    a = np.ones((3, 2))
    start = a + np.array([[1e-8, 0.0], [1e-9, 0.0], [1e-3, 0.0]])
    assert not solve(equations, start, a).solved.any()


def test_a_step_longer_than_the_longest_is_left_to_careful_steps() -> None:
    a, start = np.ones((2, 2)), np.array([[1.3, 1.0], [1.01, 1.0]])
    _, solved, near = solve(SQUARES, start, a)
    assert solved.tolist() == [False, True]
    assert not near.any()


def test_each_lane_chooses_its_pivots() -> None:
    """The pivot of the first system is 0 in the second: no order serves both."""
    turned = ca.vertcat(
        ca.cos(A[0]) * Z[0] + ca.sin(A[0]) * Z[1], -ca.sin(A[0]) * Z[0] + Z[1]
    )
    a = np.array([[0.0, 0.0], [np.pi / 2.0, 0.0], [0.7, 0.0]])
    (x,), solved, _ = solve(turned, np.full((3, 2), 0.01), a)
    assert solved.all()
    assert np.abs(x).max() < 1e-15


def test_rows_by_adjoints_are_those_of_lapack(rng: np.random.Generator) -> None:
    size, n = 5, 37
    entries, factors = ca.SX.sym("entries", size * size), ca.SX.sym("factors", size)
    by = ca.SX.sym("by", size, 3)
    row = (by.T @ factors).T
    function = batched(
        [entries, ca.vec(by), factors], [ca.reshape(entries, size, size), row]
    )
    matrices = np.eye(size) + 0.3 * rng.standard_normal((n, size, size))
    for matrix in matrices:  # each needs another order of rows
        matrix[:] = matrix[rng.permutation(size)]
    slopes = rng.standard_normal((n, size, 3))
    right = rng.standard_normal((n, 2, size))
    scale = np.array([1.0, 0.5, 2.0, 1.0, 3.0])
    inputs = [m.transpose(0, 2, 1).reshape(n, -1) for m in (matrices, slopes)]
    rows = function.pull_back(inputs, right, scale)
    adjoint = np.linalg.solve(matrices.transpose(0, 2, 1), right.transpose(0, 2, 1))
    want = adjoint.transpose(0, 2, 1) @ slopes
    assert rows.accurate.all()
    np.testing.assert_allclose(rows.values, want, rtol=1e-11, atol=1e-12)
    exact = np.linalg.cond(matrices * scale)
    assert (rows.condition >= exact * (1.0 - 1e-9)).all()
    norm = np.linalg.norm(matrices * scale, axis=(1, 2)) ** size
    volume = np.abs(np.linalg.det(matrices * scale)) * (size - 1.0) ** ((size - 1) / 2)
    np.testing.assert_allclose(rows.condition, norm / volume, rtol=1e-9)


def test_a_singular_matrix_has_no_row() -> None:
    entries, factors = ca.SX.sym("entries", 4), ca.SX.sym("factors", 2)
    function = batched([entries, factors], [ca.reshape(entries, 2, 2), factors.T])
    matrices = np.array([[1.0, 2.0, 2.0, 4.0], [1.0, 0.0, 0.0, 1.0]])
    rows = function.pull_back([matrices], np.ones((2, 1, 2)), np.ones(2))
    assert rows.accurate.tolist() == [False, True]


# -- cores and the switch --------------------------------------------------------------


@pytest.mark.parametrize("cores", [2, 3])
def test_cores_share_points_and_change_no_digit(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, cores: int
) -> None:
    monkeypatch.setattr(lanes, "MIN_SHARED_POINTS", 16)
    function = batched([A, Z], [ca.exp(A) * ca.sin(Z)])
    a, z = rng.uniform(1.0, 2.0, (2, 101, 2))
    monkeypatch.setattr(lanes, "_cores", lambda: 1)
    alone = function(a, z)[0]
    monkeypatch.setattr(lanes, "_cores", lambda: cores)
    assert function(a, z)[0].tobytes() == alone.tobytes()


@pytest.mark.parametrize(("stated", "most"), [("1", 1), ("", math.inf), ("0", 1)])
def test_a_stated_number_of_threads_holds(
    monkeypatch: pytest.MonkeyPatch, stated: str, most: float
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", stated)
    assert 1 <= lanes._cores() <= most


def test_a_function_is_compiled_once_it_has_done_enough(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(batch.COMPILE_VARIABLE)
    counter = CompileSwitch()
    assert not counter.is_on(batch.COMPILE_POINTS, 1000)
    assert counter.is_on(batch.COMPILE_WORK // 1000 + 1, 1000)
    begin_job()
    assert not counter.is_on(1, 1000)


def test_the_variable_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(batch.COMPILE_VARIABLE, batch.NEVER_COMPILE)
    assert not CompileSwitch().is_on(10**12, 1000)
    monkeypatch.setenv(batch.COMPILE_VARIABLE, f" {batch.COMPILE_AT_ONCE}")
    assert CompileSwitch().is_on(1, 1)
    monkeypatch.setenv(batch.COMPILE_VARIABLE, "off")
    with pytest.raises(CompileSettingError, match="OED_COMPILE is 'off': write 0"):
        CompileSwitch()
