"""Where a machine's solver starts, worked by hand on a delta."""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from shipped_models import hexapod_rus, linear_delta

from oed.mechanism import Kinematics, closest_closure

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
