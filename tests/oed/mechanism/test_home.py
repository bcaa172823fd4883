"""Home of a machine whose numbers are no longer those it was drawn with, against
trilateration of the delta.
"""

import dataclasses
from collections.abc import Sequence

import casadi as ca
import pytest
from oracles import delta_trilateration as delta
from shipped_models import linear_delta

from oed.mechanism import Kinematics
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
def test_home_stays_in_the_mode_of_the_machine_as_drawn(longer: float) -> None:
    """Where the start leads to carriages below the tool, the way from the drawn machine
    leads to those above.
    """
    drawn = dataclasses.replace(linear_delta.machine, guess=misled)
    machine = with_radius(drawn, linear_delta.RADIUS + longer)
    p = machine.nominal
    q = Kinematics(machine).inverse(machine.home_command[None])[1][0]
    closed_form = delta.travel_to(machine.home_command, p[0], p[1:4], p[4:7], p[7:10])
    assert q == pytest.approx(closed_form, abs=1e-12)
