"""Home of a machine that is no longer as drawn, against trilateration of the delta."""

import dataclasses
from collections.abc import Sequence

import casadi as ca
import numpy as np
import pytest
from oracles import delta_trilateration as delta
from shipped_models import linear_delta

from oed.mechanism import AssemblyError, Kinematics
from oed.model import Expr, Machine, Values


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
