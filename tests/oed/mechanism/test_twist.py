"""Slopes over the platform's twist, against derivatives over the pose coordinates."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from shipped_models import a3_head, hexapod, linear_delta, tripod_prs

from oed.mechanism import Kinematics
from oed.mechanism.expressions import (
    MachineExpressions,
    machine_expressions,
    twist_slope,
)
from oed.mechanism.twist import TwistSlopes, twist_slopes
from oed.model import Machine


def _slopes_over_pose(
    slopes: TwistSlopes, e: MachineExpressions, at: list[np.ndarray]
) -> np.ndarray:
    """Slopes (6, 6) over the pose that slopes over the twist stand for."""
    function = ca.Function("f", [e.x, e.q, e.p], [slopes.slope, slopes.change])
    over_twist, change = (np.array(value) for value in function(*at))
    angles = list(slopes.angles)
    over_twist[:, angles] = over_twist[:, angles] @ np.linalg.inv(change)
    return over_twist


@pytest.mark.parametrize(
    "machine",
    [a3_head.machine, hexapod.machine, tripod_prs.machine],
    ids=lambda m: m.name,
)
def test_slopes_over_the_twist_are_those_over_the_pose(
    machine: Machine, rng: np.random.Generator
) -> None:
    e, kinematics = machine_expressions(machine), Kinematics(machine)
    slopes = twist_slopes(machine, e.balance, e)
    assert slopes is not None
    x, q = kinematics.inverse(machine.home_command)
    tolerance = np.array([p.tolerance for p in machine.parameters])
    p = machine.nominal + tolerance * rng.standard_normal(len(tolerance))
    pose = x[0] + 0.1 * rng.standard_normal(6)
    step = 1e-6 * np.eye(6)
    ahead, behind = (
        kinematics.equations.misfit(pose + sign * step, q[0], p)[0]
        for sign in (1.0, -1.0)
    )
    wanted = ((ahead - behind) / 2e-6).T
    found = _slopes_over_pose(slopes, e, [pose, q[0], p])
    np.testing.assert_allclose(found, wanted, atol=1e-8)


def test_they_take_fewer_instructions() -> None:
    e = machine_expressions(hexapod.machine)
    slopes = twist_slopes(hexapod.machine, e.balance, e)
    assert slopes is not None
    sizes = [
        ca.Function(
            "f", [e.x, e.q, e.p], [ca.densify(o) for o in outputs], {"cse": True}
        ).n_instructions()
        for outputs in (
            (e.balance, slopes.slope, slopes.change),
            (e.balance, ca.jacobian(e.balance, e.x)),
        )
    ]
    assert sizes[0] < 0.85 * sizes[1]


def test_none_without_a_rotation() -> None:
    e = machine_expressions(linear_delta.machine)
    assert twist_slopes(linear_delta.machine, e.balance, e) is None


def test_none_where_equations_take_an_angle_itself() -> None:
    e = machine_expressions(hexapod.machine)
    by_angle = ca.vertcat(e.balance[:5], e.balance[5] + e.x[5])
    assert twist_slopes(hexapod.machine, by_angle, e) is None


def test_the_twist_of_a_turn_about_z() -> None:
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
