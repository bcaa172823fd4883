"""Compiled functions and machines: NumPy, closed forms, LAPACK, and the same digits."""

import math
import time

import casadi as ca
import numpy as np
import pytest
from shipped_models import five_bar, linear_delta

from kernel.cases import CASES
from kernel.mechanism.compiling import (
    both,
    compiled,
    compiled_files,
    needs_compiler,
    not_compiled,
)
from oed.measurement import Measurement
from oed.mechanism import (
    AssemblyError,
    BatchedFunction,
    Kinematics,
    batch,
    newton,
    systems,
)
from oed.mechanism import compiled as lanes
from oed.mechanism.batch import CompileSettingError
from oed.mechanism.systems import SolvedSystems

__all__ = ["compiled_files"]
pytestmark = [needs_compiler, pytest.mark.usefixtures("compiled_files")]

Z, A = ca.SX.sym("z", 2), ca.SX.sym("a", 2)
TOLERANCE, LONGEST = newton.STEP_TOLERANCE, 0.2
COUNTS = (1, 7, 8, 9, 200)


def batched(inputs: list[ca.SX], outputs: list[ca.SX]) -> BatchedFunction:
    return compiled(lambda: BatchedFunction("f", inputs, outputs))


def test_a_point_does_not_depend_on_its_neighbours(rng):
    function = batched([A, Z], [ca.sin(A) * Z, A @ Z.T / A[0]])
    a, z = rng.uniform(1.0, 2.0, (2, 20, 2))
    together = function(a, z)
    a[5], z[11] = np.nan, np.inf
    for k in (0, 4, 6, 12, 19):
        for every, alone in zip(together, function(a[k], z[k]), strict=True):
            assert every[k].tolist() == alone[0].tolist()


def test_inputs_lie_anywhere(rng):
    function = batched([A, Z], [A + 2.0 * Z])
    wide = rng.uniform(1.0, 2.0, (30, 8))
    a, z = wide[::2, 1:3], wide[::-2, ::4]  # rows apart, columns apart
    np.testing.assert_array_equal(function(a, z)[0], a + 2.0 * z)
    whole = np.arange(30).reshape(15, 2)
    np.testing.assert_array_equal(function(whole, z[3])[0], whole + 2.0 * z[3])
    assert function(np.zeros((0, 2)), z[3])[0].shape == (0, 2)


def test_inputs_of_another_size_are_refused():
    function = batched([A, Z], [A + Z])
    for a, z in (((9, 3), (9, 2)), ((9, 2), (9, 1)), ((9, 2), (8, 2))):
        with pytest.raises(ValueError, match=r"entries|broadcast"):
            function(np.ones(a), np.ones(z))


def test_a_very_long_function_is_not_compiled(monkeypatch):
    monkeypatch.setattr(batch, "MAX_INSTRUCTIONS", 3)
    function = batched([A, Z], [A + Z])
    assert function(np.ones(2), np.ones(2))[0].tolist() == [[2.0, 2.0]]
    assert function._jobs[lanes.Evaluation].ready is None


# -- Newton's method -------------------------------------------------------------------
#: z0^2 = a0 and z0 z1 = a1, which has a closed form
SQUARES = ca.vertcat(Z[0] ** 2 - A[0], Z[0] * Z[1] - A[1])


def solve(equations: ca.SX, start: np.ndarray, a: np.ndarray) -> SolvedSystems:
    """Solved compiled, and with the same digits without."""
    outputs = [equations, ca.jacobian(equations, Z)]
    fast, plain = both(lambda: BatchedFunction("f", [Z, A], outputs))
    found = fast.solve([start, a], TOLERANCE, LONGEST)
    assert fast._jobs[lanes.Newton].ready is not None
    other = plain.solve([start, a], TOLERANCE, LONGEST)
    for one, two in zip(found[1:], other[1:], strict=True):
        np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(
        found.values[found.solved], other.values[other.solved]
    )
    return found


@pytest.mark.parametrize("n", COUNTS)
def test_solutions_are_the_closed_form(rng, n):
    a = rng.uniform(1.0, 1.2, (n, 2))
    z = np.column_stack([np.sqrt(a[:, 0]), a[:, 1] / np.sqrt(a[:, 0])])
    x, solved, near = solve(SQUARES, z + rng.uniform(-0.05, 0.05, z.shape), a)
    assert solved.all()
    assert not near.any()
    np.testing.assert_allclose(x, z, rtol=4e-16, atol=0.0)


def test_what_has_no_solution_is_not_solved_and_disturbs_no_other():
    a = np.array([[1.0, 1.0], [-1.0, 1.0], [np.nan, 1.0], [1.21, 1.1]])
    x, solved, _ = solve(SQUARES, np.full((4, 2), 1.05), a)
    assert solved.tolist() == [True, False, False, True]
    np.testing.assert_allclose(x[[0, 3]], [[1.0, 1.0], [1.1, 1.0]], rtol=1e-15)


def test_a_double_root_is_not_solved():
    """Steps halve there: a short one does not show that the error is short."""
    equations = ca.vertcat((Z[0] - A[0]) ** 2, Z[1] - A[1])
    a = np.ones((3, 2))
    start = a + np.array([[1e-8, 0.0], [1e-9, 0.0], [1e-3, 0.0]])
    assert not solve(equations, start, a).solved.any()


def test_a_step_longer_than_the_longest_is_left_to_careful_steps():
    a, start = np.ones((2, 2)), np.array([[1.3, 1.0], [1.01, 1.0]])
    _, solved, near = solve(SQUARES, start, a)
    assert solved.tolist() == [False, True]
    assert not near.any()


def test_a_system_does_not_depend_on_its_neighbours(rng):
    """Some are solved in one step, others in four."""
    a = np.column_stack([rng.uniform(1.0, 1.2, 40), np.ones(40)])
    start = np.sqrt(a) + rng.uniform(-0.1, 0.1, (40, 2)) * (np.arange(40)[:, None] % 3)
    together = solve(SQUARES, start, a)
    for k in (0, 1, 2, 17):
        alone = solve(SQUARES, start[k : k + 1], a[k : k + 1])
        assert alone.values[0].tolist() == together.values[k].tolist()


def test_each_point_chooses_its_pivots():
    """The pivot of the first system is 0 in the second: no order serves both."""
    turned = ca.vertcat(
        ca.cos(A[0]) * Z[0] + ca.sin(A[0]) * Z[1], -ca.sin(A[0]) * Z[0] + Z[1]
    )
    a = np.array([[0.0, 0.0], [np.pi / 2.0, 0.0], [0.7, 0.0]])
    x, solved, _ = solve(turned, np.full((3, 2), 0.01), a)
    assert solved.all()
    assert np.abs(x).max() < 1e-15


def test_factors_are_those_of_lapack(rng):
    matrices = rng.standard_normal((50, 5, 5))
    right = rng.standard_normal((50, 5))
    found = systems.factors(matrices).solve(right.T.copy()).T
    wanted = np.linalg.solve(matrices, right[:, :, None])[:, :, 0]
    error = np.abs(found - wanted).max(axis=1) / np.abs(wanted).max(axis=1)
    assert (error < 1e-15 * np.maximum(np.linalg.cond(matrices), 10.0)).all()


def pull_back(inputs, outputs, values, right, scale):
    """Rows compiled, and with the same digits without."""
    fast, plain = both(lambda: BatchedFunction("f", inputs, outputs))
    rows, other = (f.pull_back(values, right, scale) for f in (fast, plain))
    assert fast._jobs[lanes.Adjoint].ready is not None
    held = np.isfinite(rows.condition)
    np.testing.assert_array_equal(held, np.isfinite(other.condition))
    for one, two in zip(rows, other, strict=True):
        np.testing.assert_array_equal(one[held], two[held])
    return rows


@pytest.mark.parametrize("n", [1, 37, 300])
def test_rows_by_adjoints_are_those_of_lapack(rng, n):
    size = 5
    entries, factors = ca.SX.sym("entries", size * size), ca.SX.sym("factors", size)
    by = ca.SX.sym("by", size, 3)
    row = (by.T @ factors).T
    matrices = np.eye(size) + 0.3 * rng.standard_normal((n, size, size))
    for matrix in matrices:  # each needs another order of rows
        matrix[:] = matrix[rng.permutation(size)]
    slopes = rng.standard_normal((n, size, 3))
    right = rng.standard_normal((n, 2, size))
    scale = np.array([1.0, 0.5, 2.0, 1.0, 3.0])
    inputs, outputs = (
        [entries, ca.vec(by), factors],
        [ca.reshape(entries, size, size), row],
    )
    given = [m.transpose(0, 2, 1).reshape(n, -1) for m in (matrices, slopes)]
    rows = pull_back(inputs, outputs, given, right, scale)
    adjoint = np.linalg.solve(matrices.transpose(0, 2, 1), right.transpose(0, 2, 1))
    want = adjoint.transpose(0, 2, 1) @ slopes
    np.testing.assert_allclose(rows.values, want, rtol=1e-11, atol=1e-12)
    exact = np.linalg.cond(matrices * scale)
    assert (rows.condition >= exact * (1.0 - 1e-9)).all()
    norm = np.linalg.norm(matrices * scale, axis=(1, 2)) ** size
    volume = np.abs(np.linalg.det(matrices * scale)) * (size - 1.0) ** ((size - 1) / 2)
    np.testing.assert_allclose(rows.condition, norm / volume, rtol=1e-9)


def test_a_singular_matrix_has_no_finite_condition():
    entries, factors = ca.SX.sym("entries", 4), ca.SX.sym("factors", 2)
    matrices = np.array([[1.0, 2.0, 2.0, 4.0], [1.0, 0.0, 0.0, 1.0]])
    outputs = [ca.reshape(entries, 2, 2), factors.T]
    rows = pull_back(
        [entries, factors], outputs, [matrices], np.ones((2, 1, 2)), np.ones(2)
    )
    assert np.isfinite(rows.condition).tolist() == [False, True]


# -- cores and the switch --------------------------------------------------------------
@pytest.mark.parametrize("cores", [2, 3])
def test_cores_share_points_and_change_no_digit(rng, monkeypatch, cores):
    monkeypatch.setattr(lanes, "MIN_SHARED_POINTS", 16)
    function = batched([A, Z], [ca.exp(A) * ca.sin(Z)])
    a, z = rng.uniform(1.0, 2.0, (2, 101, 2))
    monkeypatch.setattr(lanes, "_cores", lambda: 1)
    alone = function(a, z)[0]
    monkeypatch.setattr(lanes, "_cores", lambda: cores)
    assert function(a, z)[0].tobytes() == alone.tobytes()


@pytest.mark.parametrize(("stated", "most"), [("1", 1), ("", math.inf), ("0", 1)])
def test_a_stated_number_of_threads_holds(monkeypatch, stated, most):
    monkeypatch.setenv("OMP_NUM_THREADS", stated)
    assert 1 <= lanes._cores() <= most


@pytest.fixture
def unset(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(batch.COMPILE_VARIABLE, raising=False)


def is_compiled(function: BatchedFunction) -> bool:
    """Whether it is now, after a call; its values hold in any case."""
    x = np.array([[1.0, 2.0], [0.5, 3.0]])
    np.testing.assert_allclose(function(x, x)[0], np.sin(x) * x, rtol=1e-15)
    return function._jobs[lanes.Evaluation].ready is not None


@pytest.mark.usefixtures("unset")
def test_a_function_is_compiled_beside_the_work(monkeypatch):
    """Then another, of another machine, finds the file once a look would pay."""
    monkeypatch.setattr(lanes, "MIN_SHARED_POINTS", 10**9)
    function = BatchedFunction("f", [A, Z], [ca.sin(A) * Z])
    assert not is_compiled(function)  # the work is short
    until = time.monotonic() + 60.0  # a compiler takes a second, on a busy computer ten
    while not is_compiled(function):
        if time.monotonic() > until:
            pytest.fail("nothing was compiled beside the work")
    another = BatchedFunction("f", [A, Z], [ca.sin(A) * Z])
    while not is_compiled(another):
        assert another._jobs[lanes.Evaluation]._spent < batch.COMPILER_START / 10.0


@pytest.mark.usefixtures("unset")
def test_a_call_that_is_longer_than_the_compilation_waits_for_it():
    function = BatchedFunction("f", [A, Z], [ca.cos(A) * Z + 3.0])
    x = np.ones((200, 2))
    job = batch.CompiledJob(lanes.Evaluation, function._function, "")
    assert job.after(10**9) is not None
    np.testing.assert_array_equal(job.ready.run([x, x], 200)[0], function(x, x)[0])


def test_the_variable_decides(monkeypatch):
    def setting(value: str) -> bool:
        monkeypatch.setenv(batch.COMPILE_VARIABLE, value)
        return is_compiled(BatchedFunction("f", [A, Z], [ca.sin(A) * Z]))

    assert not setting(batch.NEVER_COMPILE)
    assert setting(f" {batch.COMPILE_AT_ONCE}")
    with pytest.raises(CompileSettingError, match="OED_COMPILE is 'off': write 0"):
        setting("off")


BATCHES = (1, 7, 8, 9, 192, 1000)
#: one machine with a pivot of its own at each pose, one with square roots alone
MACHINES = {"five_bar": five_bar.machine, "linear_delta": linear_delta.machine}


def reached(kinematics, rng, count):
    """Poses and joints of random commands around home, as far as all are in reach."""
    machine = kinematics.machine
    lower = np.array([c.lower for c in machine.command])
    upper = np.array([c.upper for c in machine.command])
    home = machine.home_command
    change = rng.uniform(lower, upper, (count, len(lower))) - home
    for share in (0.3, 0.05):
        try:
            return kinematics.inverse(home + share * change)
        except AssemblyError:
            continue
    raise AssertionError(machine.name)


@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_has_the_same_digits_compiled(name, rng):
    machine = MACHINES[name]
    fast, plain = both(lambda: Kinematics(machine))
    x, q = reached(plain, rng, max(BATCHES))
    tolerance = np.array([p.tolerance for p in machine.parameters])
    p = machine.nominal + tolerance * rng.standard_normal((len(q), len(tolerance)))
    lost = rng.random(len(q)) < 0.05
    lost[0] = False
    q[lost] += machine.lever * rng.uniform(-3.0, 3.0, (lost.sum(), q.shape[1]))
    q[6] = np.nan

    def poses(kinematics: Kinematics, n: int) -> tuple[np.ndarray, np.ndarray]:
        return kinematics.equations.solve((x[:n], q[:n], p[:n]), newton.STEP_TOLERANCE)

    for n in BATCHES:
        wanted, fails = not_compiled(lambda n=n: poses(plain, n))
        solved, failed = compiled(lambda n=n: poses(fast, n))
        np.testing.assert_array_equal(failed, fails)
        np.testing.assert_array_equal(solved[~fails], wanted[~fails])
    assert fast.equations.equations._jobs[lanes.Newton].ready is not None

    at = solved[~failed], q[~failed], p[~failed]
    slopes = rng.standard_normal((len(at[0]), 2, x.shape[1]))
    for one, two in zip(
        compiled(lambda: fast.slopes.pull_back(*at, slopes)),
        not_compiled(lambda: plain.slopes.pull_back(*at, slopes)),
        strict=True,
    ):
        np.testing.assert_array_equal(one, two)
    rows, bounds = plain.slopes.pull_back(*at, slopes)
    by_x, by_p, _ = plain.equations.slopes(*at)
    direct = slopes @ -np.linalg.solve(by_x, by_p)
    error = np.abs(rows - direct).max(axis=(1, 2)) / np.abs(direct).max(axis=(1, 2))
    assert (error < 1e-14 * np.maximum(bounds, 10.0)).all()
    exact = np.linalg.cond(by_x * plain.slopes._scale)
    assert (bounds >= exact * (1.0 - 1e-9)).all()


def test_readings_and_their_slopes_have_the_same_digits_compiled(rng):
    """Of two channels, and of a pose against that of its run."""
    case = CASES["planar_2dof"]
    setups = [case.setups["rm1"]]
    fast, plain = both(lambda: Measurement(case.machine, setups))
    command = case.commands(rng, 40)
    series = plain.series("rm1", command, run=[str(i // 8) for i in range(40)])
    theta = plain.nominal + plain.tolerance * rng.standard_normal(
        (9, len(plain.nominal))
    )
    for vectors in (theta[0], theta):
        for compute in ("readings", "jacobian"):
            values = compiled(
                lambda c=compute, v=vectors: getattr(fast, c)([series], v)
            )
            wanted = not_compiled(
                lambda c=compute, v=vectors: getattr(plain, c)([series], v)
            )
            np.testing.assert_array_equal(values, wanted)


@pytest.mark.parametrize("n", [3, 300])
def test_poses_out_of_reach_are_reported_alike(n):
    machine = MACHINES["linear_delta"]
    reports = []
    for build in (not_compiled, compiled):
        kinematics = build(lambda: Kinematics(machine))
        x, q = kinematics.inverse(np.tile(machine.home_command, (n, 1)))
        q[1] += [0.0, 0.0, 50.0 * machine.lever]
        with pytest.raises(AssemblyError) as raised:
            build(lambda k=kinematics, q=q, x=x: k.forward(q, machine.nominal, x))
        reports.append(str(raised.value))
    assert reports[0] == reports[1]
    assert "1 of" in reports[0]
    assert "pose numbers 1" in reports[0]
