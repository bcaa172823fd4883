"""Pose errors of a wrong machine, and its home, against exact geometry."""

import dataclasses
from collections.abc import Sequence

import casadi as ca
import numpy as np
import pytest
from oracles import a3_geometry as a3
from oracles import delta_trilateration as delta
from shipped_models import a3_head, cables_planar, linear_delta

from oed.mechanism import (
    AssemblyError,
    ErrorModel,
    Kinematics,
    closest_closure,
    pose_errors,
)
from oed.mechanism.batch import BatchedFunction
from oed.mechanism.expressions import MachineExpressions
from oed.mechanism.inverse import InverseKinematics
from oed.mechanism.pose_slopes import PoseAdjoints, PoseEquations
from oed.model import Expr, Machine, Values

A3 = Kinematics(a3_head.machine)
NOMINAL = a3_head.machine.nominal
COMMAND = np.array([[1.1, 0.3, 0.2], [1.2, -2.0, 0.5], [1.25, 1.1, 0.05]])
TOOL = np.array([0.02, -0.03, 0.1])
SMALL = 1e-7


@pytest.fixture
def direction(rng: np.random.Generator) -> np.ndarray:
    tolerance = np.array([p.tolerance for p in a3_head.machine.parameters])
    return tolerance * rng.standard_normal(len(NOMINAL))


def test_joints_of_a_redundant_machine_follow_all_its_equations(rng):
    """A cable that starts elsewhere is paid out by as much: no other cable pulls at it."""
    machine = cables_planar.machine
    command = rng.uniform(-0.3, 0.3, (4, 2))
    model = ErrorModel.of(Kinematics(machine), command)
    zero = [p.name for p in machine.parameters].index("l2")
    assert np.abs(model.joints[:, :, zero] - [0.0, -1.0, 0.0, 0.0]).max() < 1e-12
    assert np.abs(model.remaining).max() < 1e-12


def test_an_error_model_is_the_slope_of_exact_errors(direction):
    """By differences, with a tool that is beside the axis; what is held stays in place."""
    model = ErrorModel.of(A3, COMMAND, TOOL)
    _, q = A3.inverse(COMMAND, tool=TOOL)
    corrected = SMALL * model.joints @ direction

    def slope(by: np.ndarray) -> np.ndarray:
        moved = [
            pose_errors.pose_error(A3, COMMAND, q + s * by, NOMINAL + s * step, TOOL)
            for s, step in ((1.0, SMALL * direction), (-1.0, SMALL * direction))
        ]
        return (moved[0] - moved[1]) / (2.0 * SMALL)

    size = np.abs(model.raw @ direction).max()
    assert np.abs(slope(0.0 * q) - model.raw @ direction).max() < 1e-6 * size
    remaining = model.remaining @ direction
    assert np.abs(slope(corrected) - remaining).max() < 1e-6 * size
    x, _ = A3.inverse(COMMAND, tool=TOOL)
    rotation, point, twist = A3.frames(x, TOOL)
    np.testing.assert_array_equal(model.rotation, rotation)
    np.testing.assert_array_equal(model.point, point)
    e = A3.expressions
    slope = ca.jacobian(ca.vertcat(*e.commanded), e.x)
    (by_pose,) = BatchedFunction("by_pose", [e.x, e.tool], [slope])(x, TOOL)
    held = by_pose @ np.linalg.pinv(twist) @ remaining[..., None]
    assert np.abs(held).max() < 1e-9 * size


@pytest.mark.parametrize("index", [[0, 1, 2], [1] * 6, [0, 2] * 6])
def test_slopes_pulled_back_are_those_of_the_sensitivity(index, rng):
    """Whether readings see poses of their own, one pose, or few."""
    x, q = A3.inverse(COMMAND)
    adjoints = PoseAdjoints(A3.slopes, x[None], q[None], NOMINAL[None])
    poses = np.array(index, dtype=np.intp)
    slopes = rng.standard_normal((1, len(poses), 2, x.shape[1]))
    wanted = slopes[0] @ A3.slopes.pose_by_parameter(x, q, NOMINAL)[poses]
    assert adjoints.pull_back(slopes, poses)[0] == pytest.approx(wanted, abs=1e-12)


def test_forward_undoes_inverse_and_slopes_are_differences():
    expressions = MachineExpressions(a3_head.machine)
    inverse = InverseKinematics(a3_head.machine, expressions)
    x, q = inverse.solve(COMMAND, NOMINAL, np.zeros(3))
    np.testing.assert_allclose(q, a3.inverse_nominal(*COMMAND.T, 0.0), atol=1e-12)
    forward = PoseEquations(a3_head.machine, expressions)
    assert np.abs(forward.equations(x, q, NOMINAL)[0]).max() < 1e-12
    by_pose, by_parameter, _ = forward.slopes(x, q, NOMINAL)
    over_pose, over_parameter, over_joint = forward.slopes(x, q, NOMINAL)
    np.testing.assert_allclose(over_pose, by_pose, atol=1e-14)
    np.testing.assert_allclose(over_parameter, by_parameter, atol=1e-14)
    step = np.array([1e-6, 0.0, 0.0])
    ahead, back = (forward.equations(x, q + s * step, NOMINAL)[0] for s in (1.0, -1.0))
    slope = ((ahead - back) / 2e-6).reshape(over_joint[..., 0].shape)
    np.testing.assert_allclose(over_joint[..., 0], slope, atol=1e-8)


def test_what_is_out_of_reach_is_listed_with_its_command():
    command = np.array([[0.0, 0.0, 0.05], [9.0, 0.0, 0.05]])
    with pytest.raises(AssemblyError, match="out of reach") as error:
        Kinematics(linear_delta.machine).inverse(command)
    assert error.value.indices.tolist() == [1]
    assert error.value.first == pytest.approx(command[1])


def short_arms() -> Machine:
    """A delta whose arms reach nowhere, home neither."""
    machine = linear_delta.machine
    return machine.with_parameters(
        [
            dataclasses.replace(p, nominal=0.1) if p.name.startswith("arm") else p
            for p in machine.parameters
        ]
    )


def test_where_home_fails_as_well_the_commands_are_listed():
    command = np.array([[0.01, 0.0, 0.05], [0.0, 0.02, 0.05]])
    with pytest.raises(AssemblyError, match="out of reach") as error:
        Kinematics(short_arms()).inverse(command)
    assert error.value.indices.tolist() == [0, 1]
    assert error.value.first == pytest.approx(command[0])


def test_a_machine_that_assembles_has_no_open_equation():
    machine = linear_delta.machine
    closest = closest_closure(machine, np.array([0.01, 0.02, 0.05]))
    assert closest.still_open == ()
    assert closest.nearest.tool == pytest.approx([0.01, 0.02, 0.05], abs=1e-9)
    broken = closest_closure(short_arms(), np.array([0.0, 0.0, 0.05]))
    assert broken.still_open == (0, 1, 2)


def misled(c: Values, p: Values) -> tuple[Sequence[Expr], Sequence[Expr]]:
    """The delta's own start for its own radius; for a larger one, all carriages below."""
    pose, joints = linear_delta.guess(c, p)
    is_larger = p["radius"] > linear_delta.RADIUS + 1e-4
    return pose, [ca.if_else(is_larger, q + 0.6, q) for q in joints]


def with_radius(machine: Machine, radius: float) -> Machine:
    parameters = [
        dataclasses.replace(p, nominal=radius) if p.name == "radius" else p
        for p in machine.parameters
    ]
    return machine.with_parameters(parameters)


@pytest.mark.parametrize("longer", [2e-3, 20e-3])
def test_home_stays_in_the_mode_of_the_machine_as_drawn(longer):
    """Where the start leads below the tool, the way from the drawn machine does not."""
    drawn = dataclasses.replace(linear_delta.machine, guess=misled)
    machine = with_radius(drawn, linear_delta.RADIUS + longer)
    p = machine.nominal
    q = Kinematics(machine).inverse(machine.home_command[None])[1][0]
    closed_form = delta.travel_to(machine.home_command, p[0], p[1:4], p[4:7], p[7:10])
    assert q == pytest.approx(closed_form, abs=1e-12)


def test_what_is_out_of_reach_is_listed(rng):
    """A pose is within reach where no rail is farther than its arm."""
    machine = linear_delta.machine
    kinematics = Kinematics(machine)
    p, home = machine.nominal, machine.home_command
    command = home + rng.uniform(-1.0, 1.0, (60, 3)) * [1.0, 1.0, 0.02]
    with np.errstate(invalid="ignore"):  # a square root of what an arm falls short
        travel = [delta.travel_to(c, p[0], p[1:4], p[4:7], p[7:10]) for c in command]
    beyond = np.flatnonzero(~np.isfinite(travel).all(axis=1))
    assert 10 < beyond.size < 60
    with pytest.raises(AssemblyError) as caught:
        kinematics.inverse(command)
    assert np.array_equal(caught.value.indices, beyond)
    within = np.delete(np.arange(60), beyond)
    _, q = kinematics.inverse(command[within])
    assert q == pytest.approx(np.array(travel)[within], abs=1e-12)
