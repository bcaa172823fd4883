"""What machines have in common that drive all six coordinates of a platform: tool
point, tilt and spin.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca

from oed.model.machine import Component, Coordinate, Expr, Machine, Values
from pkm_models.parts import coordinates
from pkm_models.parts.rotation import tilt_torsion

XYZ, ANGLES = "xyz", ("rx", "ry", "spin")
POSE = coordinates.points() + coordinates.angles()
ORIENTATION = coordinates.POSE_ORIENTATION
COMPONENTS: tuple[Component, ...] = coordinates.point_errors() + tuple(
    coordinates.turn_error(n) for n in ("ax", "ay", "az")
)


def command(home: Sequence[float], reach: float, tilt: float) -> tuple[Coordinate, ...]:
    """Tool point within `reach` (m) of home (3,) along each axis, angles within `tilt`
    (rad).
    """
    return (
        *(
            coordinates.point(n, middle - reach, middle + reach)
            for n, middle in zip(XYZ, home, strict=True)
        ),
        *(coordinates.angle(n, -tilt, tilt) for n in ANGLES),
    )


def platform(x: Values) -> tuple[Expr, Expr]:
    """Orientation and tool point."""
    return tilt_torsion(x["rx"], x["ry"], x["spin"]), ca.vertcat(x["x"], x["y"], x["z"])


def commanded(x: Values, tip: Expr) -> list[Expr]:
    """The command that a pose is, its tool point at `tip`."""
    return [tip[0], tip[1], tip[2], *[x[n] for n in ANGLES]]


def target(c: Values) -> list[Expr]:
    """A command's coordinates in the order of the pose's."""
    return [c[n] for n in (*XYZ, *ANGLES)]


def machine(**fields: Any) -> Machine:
    """A machine with such a platform; `fields` are those of its geometry and legs."""
    return Machine(
        pose=POSE,
        components=COMPONENTS,
        platform=platform,
        commanded=commanded,
        target=target,
        read_error=lambda c, twist: twist,
        orientation=ORIENTATION,
        command_orientation=ORIENTATION,
        **fields,
    )
