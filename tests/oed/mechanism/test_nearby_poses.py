"""Poses near known parameters: as Newton's method solves them, near and far."""

from __future__ import annotations

import numpy as np
import pytest
from shipped_models import a3_head, cable_robot, hexapod, linear_delta

from oed.mechanism import Kinematics
from oed.model import Machine


@pytest.mark.parametrize(
    "machine",
    [a3_head.machine, hexapod.machine, linear_delta.machine, cable_robot.machine],
    ids=lambda machine: machine.name,
)
@pytest.mark.parametrize("tolerances", [1e-3, 0.1, 3.0])
def test_as_newton_from_the_nominal_pose(machine: Machine, tolerances: float) -> None:
    kinematics, rng = Kinematics(machine), np.random.default_rng(2)
    lower = np.array([c.lower for c in machine.command])
    upper = np.array([c.upper for c in machine.command])
    command = 0.25 * lower + 0.5 * (
        lower + (upper - lower) * rng.random((5, len(lower)))
    )
    command = machine.home_command + 0.3 * (command - machine.home_command)
    x, q = kinematics.inverse(command)
    spread = tolerances * np.array([p.tolerance for p in machine.parameters])
    vectors = machine.nominal + spread * rng.standard_normal((6, len(spread)))
    poses = kinematics.nearby(q, machine.nominal, x).solve(vectors)
    exact = kinematics.forward(q, vectors, x)
    np.testing.assert_allclose(poses, exact, rtol=0.0, atol=2e-11)


def test_poses_that_do_not_assemble_are_nan() -> None:
    machine = linear_delta.machine
    kinematics = Kinematics(machine)
    x, q = kinematics.inverse(np.array([machine.home_command, machine.home_command]))
    vectors = np.vstack([machine.nominal, machine.nominal])
    arm = next(k for k, p in enumerate(machine.parameters) if p.name == "arm1")
    vectors[1, arm] -= 10.0
    poses = kinematics.nearby(q, machine.nominal, x).solve(vectors)
    assert np.isfinite(poses[0]).all()
    assert np.isnan(poses[1]).all()
