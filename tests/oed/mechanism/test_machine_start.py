"""Where a machine's solver starts, worked by hand on a delta."""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from shipped_models import linear_delta

from oed.mechanism import closest_closure

machine = linear_delta.machine


def test_a_machine_that_does_not_assemble_can_be_looked_at() -> None:
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
