"""What machines share whose platform only translates, held by parallelograms or a point."""

from collections.abc import Sequence
from typing import Any

import casadi as ca

from oed.model import Coordinate, Dimension, Expr, Machine, PassiveJoint, Strut, Values
from pkm_models.machines.parts import coordinates, families, passive


def ranges_dimensions(home: Sequence[float], reach: float) -> tuple[Dimension, ...]:
    """Home of the tool point, how far the workspace reaches about it, the tolerance."""
    return (
        Dimension("home", "m", (len(home),), tuple(home), "tool point at home"),
        Dimension("reach", "m", (), reach, "half the workspace's width about home"),
        families.tolerance_dimension(),
    )


def tool_point(x: Values) -> Expr:
    """Tool point (3,); 0 along an axis in which the machine does not move."""
    return ca.vertcat(*[x.get(n, 0.0) for n in "xyz"])


def tangential_joints(
    struts: Sequence[Strut], angles: Sequence[Expr]
) -> list[PassiveJoint]:
    """Joints of struts at the base, first axes tangential at these angles about z."""
    axes = [ca.vertcat(-ca.sin(a), ca.cos(a), 0.0) for a in angles]
    return passive.universals(struts, axes, passive.DOWN)


def machine(
    home: Sequence[float], command: Sequence[Coordinate], **fields: Any
) -> Machine:
    """A machine whose tool point moves in the axes of its command, from home (n,)."""
    axes = "".join(c.name for c in command)
    driven = ["xyz".index(n) for n in axes]
    return Machine(
        pose=coordinates.points(axes),
        command=tuple(command),
        components=coordinates.point_errors(axes),
        home=dict(zip(axes, home, strict=True)),
        platform=lambda x: (ca.SX.eye(3), tool_point(x)),
        commanded=lambda x, tip: [tip[k] for k in driven],
        target=lambda c: [c[n] for n in axes],
        read_error=lambda c, twist: [twist[k] for k in driven],
        **fields,
    )
