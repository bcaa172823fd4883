"""Kinematics of machines, their batches and linear equations, against oracles and NumPy."""

import dataclasses
import math

import casadi as ca
import numpy as np
import pytest
from oracles import a3_geometry as a3
from oracles import delta_trilateration as delta
from reference import tian_2016 as paper
from scipy import optimize
from scipy.spatial.transform import Rotation
from shipped_models import a3_head, height_probe, hexapod_rus, linear_delta

from kernel.cases import CASES
from oed.base import Array, Index
from oed.instrument import mount
from oed.measurement import Measurement, Series
from oed.mechanism import (
    AssemblyError,
    BatchedFunction,
    Kinematics,
    closest_closure,
    newton,
)
from oed.mechanism.batch import MIN_ARRAY_POINTS
from oed.mechanism.expressions import twist_slope
from oed.mechanism.newton import solve_linear
from oed.mechanism.tape import CHUNK_SIZES, TAPE_SIZES
from oed.model import Coordinate, Expr, Values

A3, DELTA = Kinematics(a3_head.machine), Kinematics(linear_delta.machine)
A3_SPREAD = np.r_[
    np.full(21, 3e-3), np.full(3, 20e-3)
]  # m, rad: three tolerances and more
TOOLS = (0.0, 0.1)


def a3_commands(rng: np.random.Generator, n: int, tool: float = 0.0) -> np.ndarray:
    """As `cases`, for a longer tool, theta at least 1 deg."""
    c = CASES["a3_head"].commands(rng, n)
    return np.column_stack(
        [c[:, 0] + tool, c[:, 1], np.maximum(c[:, 2], np.deg2rad(1))]
    )


def delta_args(p: np.ndarray) -> tuple[np.ndarray, ...]:
    """radius, arm, angle, endstop of parameter vectors (..., 10)."""
    return p[..., 0], p[..., 1:4], p[..., 4:7], p[..., 7:10]


@pytest.mark.parametrize("tool", TOOLS)
def test_a3_inverse_is_the_closed_form(rng, tool):
    command = a3_commands(rng, 300, tool)
    x, q = A3.inverse(command, tool=np.array([0, 0, tool]))
    rotation, tip, _ = A3.frames(x, np.array([0, 0, tool]))
    nominal_tip, nominal_rotation = a3.nominal_pose(*command.T, tool)
    assert np.abs(q - a3.inverse_nominal(*command.T, tool)).max() < 1e-14
    assert np.abs(tip - nominal_tip).max() < 1e-14
    assert np.abs(rotation - nominal_rotation).max() < 1e-14


@pytest.mark.parametrize("tool", TOOLS)
def test_a3_forward_is_the_oracles_for_wrong_machines(rng, tool):
    command = a3_commands(rng, 60, tool)
    x, q = A3.inverse(command, tool=np.array([0, 0, tool]))
    p = A3_SPREAD * rng.standard_normal((40, 24))
    found = A3.forward(q, p, x)
    assert found.shape == (40, 60, 6)
    rotation, tip, _ = A3.frames(found.reshape(-1, 6), np.array([0, 0, tool]))
    want = a3.forward(p[:, None], q, tool)
    assert np.abs(tip - want.tip.reshape(-1, 3)).max() < 1e-12
    assert np.abs(rotation - want.R.reshape(-1, 3, 3)).max() < 1e-12


@pytest.mark.parametrize("tool", TOOLS)
def test_a3_sensitivity_is_the_papers_linear_model(rng, tool):
    command, offset = a3_commands(rng, 100, tool), np.array([0, 0, tool])
    x, q = A3.inverse(command, tool=offset)
    twist = A3.frames(x, offset)[2] @ A3.slopes.pose_by_parameter(
        x, q, A3.machine.nominal
    )
    model = a3.linear_model(*command.T, tool)
    assert np.abs(twist - model).max() < 1e-12 * np.abs(model).max()
    by_joint, by_parameter = (
        f(x, q, A3.machine.nominal)
        for f in (A3.slopes.pose_by_joint, A3.slopes.pose_by_parameter)
    )
    assert (
        np.abs(by_joint - by_parameter[..., :3]).max() < 1e-13
    )  # a home error adds to the joint


def test_a3_sensitivity_of_a_wrong_machine_is_the_oracles_complex_step(rng):
    command, p = a3_commands(rng, 20), A3_SPREAD * rng.standard_normal(24)
    start, q = A3.inverse(command)
    x = A3.forward(q, p, start)
    rotation, _, twist = A3.frames(x, np.zeros(3))
    moved = a3.forward(p + 1e-30j * np.eye(24), q[:, None])
    spin = (moved.R.imag / 1e-30) @ np.swapaxes(rotation, 1, 2)[:, None]
    exact = np.concatenate(
        [moved.tip.imag / 1e-30, spin[..., [2, 0, 1], [1, 2, 0]]], axis=-1
    ).swapaxes(1, 2)
    assert (
        np.abs(twist @ A3.slopes.pose_by_parameter(x, q, p) - exact).max()
        < 1e-11 * np.abs(exact).max()
    )


def test_a3_components_are_the_slopes_of_the_euler_angles(rng):
    """dpsi, dtheta, dphi of a small turn, against Euler angles of the turned platform."""
    command, size = a3_commands(rng, 50), 1e-6
    command[:, 2] = np.maximum(command[:, 2], np.deg2rad(5))
    twist = np.hstack(
        [rng.standard_normal((50, 3)), size * rng.standard_normal((50, 3))]
    )
    told = A3.error_components(command, twist)
    nominal = a3.rotation(command[:, 1], command[:, 2], -command[:, 1])
    turn = Rotation.from_rotvec(twist[:, 3:]).as_matrix() @ nominal
    back = Rotation.from_rotvec(-twist[:, 3:]).as_matrix() @ nominal
    change = np.column_stack(a3.euler(turn)) - np.column_stack(a3.euler(back))
    assert np.abs(told[:, 3:] - np.angle(np.exp(1j * change)) / 2).max() < 1e-8 * size
    assert (told[:, :3] == twist[:, :3]).all()
    linear = np.einsum("nkj,nj->nk", A3.error_components_jacobian(command), twist)
    assert np.abs(linear - told).max() < 1e-15


def test_a3_is_upright_without_trouble():
    """Euler angles are singular at theta = 0; the pose coordinates are not."""
    command = np.array([[1.1, psi, 0.0] for psi in (-1.0, 0.0, 2.0)])
    x, q = A3.inverse(command)
    assert np.ptp(q) < 1e-15
    twist = A3.frames(x, np.zeros(3))[2] @ A3.slopes.pose_by_parameter(
        x, q, A3.machine.nominal
    )
    assert np.abs(twist - a3.linear_model(*command[1])).max() < 1e-13


def test_delta_inverse_and_forward_are_trilateration(rng):
    point = CASES["linear_delta"].commands(rng, 200)
    spread = np.array([p.tolerance for p in DELTA.machine.parameters])
    p = DELTA.machine.nominal + 3.0 * spread * rng.standard_normal((30, 10))
    x, q = DELTA.inverse(point)
    assert (x == point).all() or np.abs(x - point).max() < 1e-15
    assert (
        np.abs(q - delta.travel_to(point, *delta_args(DELTA.machine.nominal))).max()
        < 1e-14
    )
    found = DELTA.forward(q, p, x)
    want = delta.nozzle(q, *delta_args(p[:, None]))
    assert np.abs(found - want).max() < 1e-12


def test_delta_inverse_with_a_machine_for_each_pose(rng):
    point = CASES["linear_delta"].commands(rng, 50)
    p = DELTA.machine.nominal + 1e-3 * rng.standard_normal((50, 10))
    _, q = DELTA.inverse(point, p)
    assert np.abs(q - delta.travel_to(point, *delta_args(p))).max() < 1e-14


def test_recorded_joints_are_followed_from_home(rng):
    q = delta.travel_to(
        CASES["linear_delta"].commands(rng, 40), *delta_args(DELTA.machine.nominal)
    )
    exact = delta.nozzle(q, *delta_args(DELTA.machine.nominal))
    assert np.abs(DELTA.start_poses(q) - exact).max() < 1e-12
    command = a3_commands(rng, 40)
    x = A3.start_poses(a3.inverse_nominal(*command.T))
    assert np.abs(x[:, :3] - a3.nominal_pose(*command.T)[0]).max() < 1e-12


def test_a_failing_pose_does_not_disturb_the_others(rng):
    command = a3_commands(rng, 9)
    x, q = A3.inverse(command)
    p = A3_SPREAD * rng.standard_normal((3, 24))
    alone = A3.forward(q, p, x)
    broken = q.copy()
    broken[4] = [0.3, 0.9, 1.8]
    found, bad = A3.try_forward(broken, p, x)
    assert bad.shape == (3, 9)
    assert (bad == (np.arange(9) == 4)).all()
    keep = np.arange(9) != 4
    assert np.abs(found[:, keep] - alone[:, keep]).max() < 1e-14
    with pytest.raises(ArithmeticError):
        a3.forward(np.zeros(24), broken[4])


@pytest.mark.parametrize("away", [0.0, 1e-9, 1e-3, 2e-2])
def test_a_singular_pose_is_reported(away):
    """Two places of the tool meet; the start is `away` (m) from there."""
    radius, arm = linear_delta.RADIUS, linear_delta.ARM
    half_base = radius * np.sqrt(3) / 2
    height = arm + np.sqrt(
        arm**2 - half_base**2
    )  # of the triangle, from (half_base^2 + height^2) / (2 height) = arm
    drop = np.sqrt(height**2 - (1.5 * radius) ** 2)
    singular = np.array([0.0, 0.0, drop])
    tops = delta.carriages(singular, *delta_args(DELTA.machine.nominal))
    middle = tops[:2].mean(axis=0)
    centre = middle + (1 - arm / height) * (tops[2] - middle)
    assert np.linalg.norm(centre - tops, axis=1) == pytest.approx(arm, abs=1e-12)
    normal = np.cross(tops[1] - tops[0], tops[2] - tops[0])
    start = centre - away * normal / np.linalg.norm(normal) * np.sign(normal[2])
    x, q = DELTA.inverse(np.array([[0.0, 0.0, 0.02], [0.01, 0.0, 0.02]]))
    m = Measurement(linear_delta.machine, [mount(height_probe.instrument, "probe")])
    sent, starts = np.insert(q, 1, singular, axis=0), np.insert(x, 1, start, axis=0)
    rows, none = np.arange(3)[:, None], np.full((3, 3), np.nan)
    series = Series("probe", sent, starts, none, rows, np.full(3, "1"))
    with pytest.raises(AssemblyError, match=r"pose numbers 1\b.*singular") as caught:
        m.jacobian([series], m.nominal)
    assert caught.value.indices.tolist() == [1]
    copies = 100  # as many as run in array operations, each with parameters of its own
    with pytest.raises(
        AssemblyError, match=r"pose numbers 1, 4, 7, .*singular"
    ) as many:
        m.jacobian([series], np.tile(m.nominal, (copies, 1)))
    assert many.value.indices.tolist() == list(range(1, 3 * copies, 3))


FOURTH = np.pi / 6  # angle of a fourth tower


def four_legs() -> Kinematics:
    """The delta with a fourth leg and joint: arm and endstop as the first's."""
    plain = linear_delta.machine

    def closure(x: Values, q: Values, p: Values) -> list[Expr]:
        height = p["endstop1"] + ca.sqrt(p["arm1"] ** 2 - p["radius"] ** 2) - q["q4"]
        top = ca.vertcat(
            p["radius"] * math.cos(FOURTH), p["radius"] * math.sin(FOURTH), height
        )
        return [
            *plain.closure(x, q, p),
            ca.norm_2(ca.vertcat(x["x"], x["y"], x["z"]) - top) - p["arm1"],
        ]

    def guess(c: Values, p: Values) -> tuple[list[Expr], list[Expr]]:
        x, q = plain.guess(c, p)
        return list(x), [*q, q[0]]

    joints = (*plain.joints, Coordinate("q4", "m", -0.05, 0.6))
    return Kinematics(
        dataclasses.replace(plain, joints=joints, closure=closure, guess=guess)
    )


def test_a_redundant_machine_settles_where_its_legs_miss_least(rng):
    """Least squares of the legs' misfits, by SciPy; slopes by differences of that."""
    kinematics, point = four_legs(), CASES["linear_delta"].commands(rng, 10)
    p = DELTA.machine.nominal + 1e-3 * rng.standard_normal(10)
    x, q = kinematics.inverse(point, p)
    assert np.abs(q[:, :3] - delta.travel_to(point, *delta_args(p))).max() < 1e-13
    assert np.abs(kinematics.forward(q, p, x + 0.01) - point).max() < 1e-13

    def settled(p: np.ndarray, q: np.ndarray, start: np.ndarray) -> np.ndarray:
        angle, arm, endstop = np.r_[p[4:7], FOURTH], p[[1, 2, 3, 1]], p[[7, 8, 9, 7]]
        height = endstop + np.sqrt(arm**2 - p[0] ** 2) - q
        tops = np.column_stack([p[0] * np.cos(angle), p[0] * np.sin(angle), height])

        def misfit(at: np.ndarray) -> np.ndarray:
            return np.linalg.norm(at - tops, axis=1) - arm

        return optimize.least_squares(
            misfit, start, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale=0.1
        ).x

    q[:, 3] += 1e-3 * rng.standard_normal(10)
    found = kinematics.forward(q, p, x)
    assert (
        np.abs(found - [settled(p, *row) for row in zip(q, x, strict=True)]).max()
        < 1e-8
    )
    assert np.abs(found - x).max() > 1e-4
    slope = kinematics.slopes.pose_by_parameter(x, kinematics.inverse(point, p)[1], p)
    h = 1e-4
    agreed = kinematics.inverse(point, p)[1]
    for k in range(10):
        step = h * np.eye(10)[k]
        ends = [
            np.array([settled(p + d, *row) for row in zip(agreed, x, strict=True)])
            for d in (step, -step)
        ]
        assert (
            np.abs(slope[..., k] - (ends[0] - ends[1]) / (2 * h)).max()
            < 1e-3 * np.abs(slope).max()
        )


def test_drawings_show_the_machine(rng):
    """A3: limbs as long as the joints say, and the spindle ends at the tool point."""
    command = a3_commands(rng, 1)
    x, q = A3.inverse(command)
    base, *limbs, platform, spindle = A3.skeleton(x[0], q[0], A3.machine.nominal)
    assert [np.linalg.norm(b - a) for a, b in limbs] == pytest.approx(q[0], abs=1e-14)
    assert base == pytest.approx(a3.B_NOM[[0, 1, 2, 0]], abs=1e-15)
    assert spindle[1] == pytest.approx(x[0, :3], abs=1e-15)
    assert np.linalg.norm(np.diff(platform, axis=0), axis=1) == pytest.approx(
        paper.A * np.sqrt(3), abs=1e-14
    )


def test_the_twist_of_a_turn_about_z():
    """A point at radius 2 m, turned about z by x: it moves along the tangent."""
    x = ca.SX.sym("x", 1)
    turn = ca.vertcat(
        ca.horzcat(ca.cos(x), -ca.sin(x), 0),
        ca.horzcat(ca.sin(x), ca.cos(x), 0),
        ca.horzcat(0, 0, 1),
    )
    slope = twist_slope(turn, turn @ ca.DM([2.0, 0.0, 0.5]), x)
    at = ca.Function("f", [x], [slope])(0.3)
    tangent = [-2.0 * np.sin(0.3), 2.0 * np.cos(0.3), 0.0, 0.0, 0.0, 1.0]
    assert np.array(at).ravel() == pytest.approx(tangent)


@pytest.mark.parametrize("head", [a3_head, a3])
def test_model_and_oracle_have_the_dimensions_of_table_1(head):
    expected = paper.A, paper.B, paper.C, paper.D
    assert expected == (head.A, head.B, head.C, head.D)


machine = linear_delta.machine


def test_a_machine_that_does_not_assemble_can_be_looked_at():
    """Carriages level with the tool at the centre: the arm's ends are a radius apart."""
    radius, arm, endstop = 0.16175, 0.345, 0.420
    level = endstop + np.sqrt(arm**2 - radius**2)
    odd = dataclasses.replace(
        machine,
        guess=lambda c: ([c["x"], c["y"], c["z"]], [level - c["z"]] * 3),
        skeleton=lambda x, q, p: [[ca.vertcat(x["x"], x["y"], x["z"]), ca.SX.ones(3)]],
    )
    guess = closest_closure(odd, np.array([0.0, 0.0, 0.05])).guess
    assert guess.equations == pytest.approx([radius - arm] * 3)
    np.testing.assert_allclose(guess.lines[0], [[0.0, 0.0, 0.05], [1.0, 1.0, 1.0]])


def test_a_tool_beside_the_platform_adds_no_turn_to_a_crank(rng):
    """The cranks are those of the same pose without a tool, within half a turn."""
    kinematics = Kinematics(hexapod_rus.machine)
    tool = np.array([0.15, 0.0, 0.03])
    command = np.tile(kinematics.machine.home_command, (200, 1))
    command[:, :3] += tool + rng.uniform(-0.03, 0.03, (200, 3))
    command[:, 3:] = rng.uniform(-0.14, 0.14, (200, 3))
    x, q = kinematics.inverse(command, tool=tool)
    assert np.abs(q).max() < np.pi
    np.testing.assert_allclose(q, kinematics.inverse(x)[1], atol=1e-12)


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
