"""Delta printer over its bed: the bed leans, and the effector tilts with the towers' errors.

z counts from the bed along the towers. With slopes b of the bed, tower by tower the tool is
where a linear delta has it at z + b_x x + b_y y, as in RepRapFirmware with M666 A and B:

    |(x, y, z + b_x x + b_y y) - C_i| = arm_i.

The two rods of tower i keep the edge e_i of the effector parallel to the axis c_i of its
carriage, as far as their lengths agree. With u_i along the rods and R the effector's rotation,

    u_i . (R e_i - c_i) = pair_i,

exact for rods of nearly one length; pair_i is the difference of the two over their spacing.
Axis c_i is tangential at the tower's nominal angle, turned about z by turn_i as the tower is
mounted. Both tilt the effector by an amount that varies over the bed. A probe beside the nozzle
reads that; the nozzle, at the effector's origin, does not. Tilts count from the middle of the
bed, where trigger heights are measured: there R is 1.
"""

import casadi as ca

from oed.model import Expr, Parameter, Start, Values
from pkm_models.machines import delta, linear_delta
from pkm_models.machines.delta import TOWERS
from pkm_models.machines.parts import coordinates, families, six_dof

SIDES = linear_delta.ANGLE  #: angles of the effector's three sides, rad
SLOPE_SD = 5e-3  # of a bed as it is mounted
EDGE_SD = 1e-3  # rad: rods and carriages are right by 0.05 mm over 50 mm
TRIM_SD = 0.1e-3  # m


def _raised(x: Values, p: Values) -> dict[str, Expr]:
    """The tool in the frame of the towers: z raised as the bed is."""
    rise = p["bed_slope_x"] * x["x"] + p["bed_slope_y"] * x["y"]
    return {"x": x["x"], "y": x["y"], "z": x["z"] + rise}


def _tangent(angle: Expr) -> Expr:
    return ca.vertcat(-ca.sin(angle), ca.cos(angle), 0.0)


def _axis(p: Values, i: int) -> Expr:
    """Axis c_i (3,) of the carriage."""
    return _tangent(SIDES[i] + p[f"turn{i}"])


def _effector_edges(p: Values) -> list[Expr]:
    """Edges e_i (3,) of the effector that is level in the middle of the bed.

    From their nominal places they turn by w, until u_i . (e_i - c_i) = pair_i there.
    """
    edges = [_tangent(SIDES[i]) for i in TOWERS]
    normals, sides = [], []
    for i, edge in zip(TOWERS, edges, strict=True):
        angle = p[f"angle{i}"]
        radius = p["radius"] + p[f"trim{i}"]
        drop = ca.sqrt(p[f"arm{i}"] ** 2 - radius**2)
        rod = ca.vertcat(-radius * ca.cos(angle), -radius * ca.sin(angle), -drop)
        rod = rod / p[f"arm{i}"]
        normals.append(ca.cross(edge, rod))
        sides.append(ca.dot(rod, _axis(p, i) - edge) + p[f"pair{i}"])
    turn = ca.solve(ca.horzcat(*normals).T, ca.vertcat(*sides))
    return [edge + ca.cross(turn, edge) for edge in edges]


def closure(x: Values, q: Values, p: Values) -> list[Expr]:
    """Arm lengths, m; the edges of the effector along those of the carriages."""
    raised, upright = _raised(x, p), linear_delta.by_tower(p)
    rows = delta.closure(raised, q, upright)
    rotation, _ = six_dof.platform(x)
    struts = delta.struts(raised, q, upright)
    edges = _effector_edges(p)
    for i, (carriage, tool), edge in zip(TOWERS, struts, edges, strict=True):
        along = (tool - carriage) / p[f"arm{i}"]
        rows.append(ca.dot(along, rotation @ edge - _axis(p, i)) - p[f"pair{i}"])
    return rows


def guess(c: Values, p: Values) -> Start:
    """The commanded point, level, and each carriage at the upper end of its arm."""
    _, joints = delta.guess(_raised(c, p), linear_delta.by_tower(p))
    return [c["x"], c["y"], c["z"], 0.0, 0.0, 0.0], joints


machine = six_dof.driven(
    "xyz",
    name="delta_printer",
    source=(
        "Klipper and RepRapFirmware: delta kinematics, bed tilt (M666 A, B); the"
        " effector's tilt from the lengths of its six rods"
    ),
    about="delta printer over its bed: a bed that leans, an effector that tilts",
    command=linear_delta.machine.command,
    components=coordinates.point_errors(),
    commanded=lambda x, tip: [x["x"], x["y"], x["z"]],
    read_error=lambda c, twist: twist[:3],
    home=linear_delta.machine.home,
    joints=linear_delta.machine.joints,
    base_frame=(
        "origin on the bed, midway between the towers; x and y across the towers, z along"
        " them, from the bed; towers at the angles from x to y that the parameters `angle`"
        " state"
    ),
    tool_axis="along the towers, up, where the effector is in the middle of the bed",
    parameters=(
        *linear_delta.machine.parameters,
        *families.numbers("trim", [0.0] * 3, TRIM_SD, "m", "more radius of tower"),
        *(
            Parameter(
                f"bed_slope_{n}", 0.0, SLOPE_SD, "1", f"rise of the bed along {n}"
            )
            for n in "xy"
        ),
        *families.numbers(
            "pair", [0.0] * 3, EDGE_SD, "rad", "rods' difference over spacing, tower"
        ),
        *families.numbers(
            "turn", [0.0] * 3, EDGE_SD, "rad", "turn of the carriage's axis, tower"
        ),
    ),
    lever=linear_delta.RADIUS,
    closure=closure,
    guess=guess,
    skeleton=lambda x, q, p: delta.skeleton(_raised(x, p), q, linear_delta.by_tower(p)),
    struts=lambda x, q, p: delta.struts(_raised(x, p), q, linear_delta.by_tower(p)),
    frame=linear_delta.machine.frame,
)
