"""What machines have in common that drive all six coordinates of a platform: tool
point, tilt and spin.
"""

from collections.abc import Sequence
from typing import Any

import casadi as ca

from oed.model import Component, Coordinate, Expr, Machine, Values
from pkm_models.machines.parts import coordinates
from pkm_models.rotation import tilt_torsion

XYZ = "xyz"
ANGLES = ("rx", "ry", "spin")
COMMAND = (*XYZ, *ANGLES)
#: frames of machines whose geometry is a table
GEOMETRY_FRAME = "that of the geometry's points at the base"
GEOMETRY_TOOL_AXIS = "z of the frame of the geometry's points at the platform"
POSE = coordinates.points() + coordinates.angles()
ORIENTATION = coordinates.POSE_ORIENTATION
COMPONENTS: tuple[Component, ...] = coordinates.point_errors() + tuple(
    coordinates.turn_error(n) for n in ("ax", "ay", "az")
)


def command(home: Sequence[float], reach: float, tilt: float) -> tuple[Coordinate, ...]:
    """Tool point within `reach` (m) of home (3,) on each axis, angles within `tilt`."""
    turns = [coordinates.angle(n, -tilt, tilt) for n in ANGLES]
    return (*coordinates.points_about(home, reach), *turns)


def platform(x: Values) -> tuple[Expr, Expr]:
    """Orientation and tool point."""
    return tilt_torsion(x["rx"], x["ry"], x["spin"]), ca.vertcat(x["x"], x["y"], x["z"])


def target(c: Values, names: Sequence[str] = COMMAND) -> list[Expr]:
    """Coordinates of a command, by default in the order of the pose's."""
    return [c[n] for n in names]


def machine(**fields: Any) -> Machine:
    """A machine with such a platform, of `fields`; its geometry a table by default."""
    return driven(
        COMMAND, components=COMPONENTS, command_orientation=ORIENTATION, **fields
    )


def driven(names: Sequence[str], **fields: Any) -> Machine:
    """As `machine`, with only some coordinates of the platform commanded."""
    common: dict[str, Any] = {
        "pose": POSE,
        "platform": platform,
        "commanded": lambda x, tip: [
            tip[XYZ.index(n)] if n in XYZ else x[n] for n in names
        ],
        "target": lambda c: target(c, names),
        "read_error": lambda c, twist: twist,
        "orientation": ORIENTATION,
        "base_frame": GEOMETRY_FRAME,
        "tool_axis": GEOMETRY_TOOL_AXIS,
    }
    return Machine(**{**common, **fields})
