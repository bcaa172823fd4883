"""Registration: where an instrument's own frame is in the base frame, as six unknowns
of a set-up.

A point is read as R(turn) (point - about) + about + shift, a rotation as R(turn) times
it, with R a small rotation and `about` a known point (a gimbal's centre), so that shift
and turn are as independent as they can be.
"""

from collections.abc import Sequence

import casadi as ca

from oed.instrument import Channel, Setting
from oed.model import Expr, Parameter, Values
from pkm_models.rotation import tilt_torsion

#: what an instrument reads of the tool point along an axis of its frame
COORDINATE = (
    "{} of the tool point in the instrument's frame, which is the base frame up to shift"
    " and turn"
)


def point_channels(
    sigma: float, axes: str = "xyz", about: str = COORDINATE, stem: str = "read"
) -> tuple[Channel, ...]:
    """`read_x`, ...: a coordinate of a point along each axis `{}`, with its noise, m."""
    return tuple(
        Channel(f"{stem}_{n}", "m", sigma, about=about.format(n)) for n in axes
    )


def place_settings(
    about: str, values: Sequence[float | None] = (None, None, None)
) -> tuple[Setting, ...]:
    """`at_x`, ...: a place (3,) in the base frame, m; a set-up has to state what is None."""
    return tuple(
        Setting(f"at_{n}", "m", value, about.format(n))
        for n, value in zip("xyz", values, strict=True)
    )


def place(k: Values) -> Expr:
    """The place (3,) that settings state, m."""
    return ca.vertcat(k["at_x"], k["at_y"], k["at_z"])


def unknowns(
    stem: str, tolerance: float, unit: str, about: str, axes: str = "xyz"
) -> tuple[Parameter, ...]:
    """`cup_x`, ...: an unknown of a set-up along each axis, `{}` in `about`."""
    return tuple(
        Parameter(f"{stem}_{n}", 0.0, tolerance, unit, about.format(n)) for n in axes
    )


def frame_parameters(shift: float, turn: float) -> tuple[Parameter, ...]:
    """The six unknowns with their tolerances (m, rad); 0 holds a known frame's."""
    turns = "rotation of the instrument's frame about {}"
    return (
        *unknowns("shift", shift, "m", "{} of the instrument's frame"),
        *unknowns("turn", turn, "rad", turns),
    )


def rotation_in_frame(s: Values, rotation: Expr) -> Expr:
    """A rotation (3 x 3) or direction (3,) as the instrument sees it."""
    return tilt_torsion(s["turn_x"], s["turn_y"], s["turn_z"]) @ rotation


def point_in_frame(s: Values, point: Expr, about: Expr) -> Expr:
    """A point (3,) of the base frame, as the instrument sees it."""
    return (
        rotation_in_frame(s, point - about)
        + about
        + ca.vertcat(s["shift_x"], s["shift_y"], s["shift_z"])
    )


def coordinates_in_frame(s: Values, point: Expr) -> list[Expr]:
    """Its coordinates, x, y and z, with the base frame's origin as `about`."""
    return list(ca.vertsplit(point_in_frame(s, point, ca.DM.zeros(3))))


def axis_angles(axis: Expr) -> list[Expr]:
    """alpha, beta of (sin beta, -sin alpha cos beta, cos alpha cos beta) l (3,)."""
    return [
        ca.atan2(-axis[1], axis[2]),
        ca.atan2(axis[0], ca.sqrt(axis[1] ** 2 + axis[2] ** 2)),
    ]
