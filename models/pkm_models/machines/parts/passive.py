"""Passive joints at the base of a machine's struts: hinges and universal joints.

A strut leaves its base joint in the direction of the vector v. The joint's first axis t
is fixed in the base frame, and r is a direction square to it, as of an upright strut:

    swing = atan2(v . (t x r), v . r),        side = asin(v . t / |v|).

`swing` turns about t, right-handed from r; `side` leans out of the plane square to t,
towards it. A hinge has the first alone.
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from oed.base import Array
from oed.model import Expr, PassiveJoint, Strut

#: direction of an upright strut, from its base joint
UP, DOWN = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)


def tangents(points: Array) -> Array:
    """Horizontal axes (n, 3) of base joints across the radius; x at their centre."""
    radius = np.asarray(points, dtype=float)
    radius = radius - radius.mean(axis=0)
    across = np.stack([-radius[:, 1], radius[:, 0], 0.0 * radius[:, 0]], axis=1)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across[length[:, 0] < 1e-9] = (1.0, 0.0, 0.0)
    return np.asarray(across / np.where(length < 1e-9, 1.0, length))


def hinges(
    struts: Sequence[Strut],
    axes: Array | Sequence[Expr],
    upright: Array | Sequence[float],
) -> list[PassiveJoint]:
    """`swing1`, ... of struts about hinges' axes (3,), 0 at `upright` (3,), (n, 3)."""
    from_where = np.broadcast_to(np.asarray(upright, dtype=float), (len(struts), 3))
    limbs = enumerate(zip(struts, axes, from_where, strict=True), start=1)
    return [_swing(i, *limb) for i, limb in limbs]


def universals(
    struts: Sequence[Strut],
    axes: Array | Sequence[Expr],
    upright: Array | Sequence[float],
) -> list[PassiveJoint]:
    """`swing1`, `side1`, ... of struts with universal joints of first axes (3,)."""
    joints = []
    for i, swing in enumerate(hinges(struts, axes, upright)):
        joints += [swing, _side(i + 1, struts[i], axes[i])]
    return joints


def _swing(i: int, strut: Strut, axis: Expr, upright: Array) -> PassiveJoint:
    base, platform = strut
    v = platform - base
    t = _vector(axis)
    r = _vector(upright)
    r = r - ca.dot(r, t) * t
    r = r / ca.norm_2(r)
    ways = {UP: "from straight up", DOWN: "from straight down"}
    way = ways.get(tuple(upright.tolist()), "from the strut as drawn")
    about = f"swing of strut {i} about the first axis of its base joint, right-handed, {way}"
    return PassiveJoint(
        f"swing{i}", "rad", ca.atan2(ca.dot(v, ca.cross(t, r)), ca.dot(v, r)), about
    )


def _side(i: int, strut: Strut, axis: Expr) -> PassiveJoint:
    base, platform = strut
    v = platform - base
    sine = ca.dot(v, _vector(axis)) / ca.norm_2(v)
    about = f"lean of strut {i} towards the first axis of its base joint"
    return PassiveJoint(f"side{i}", "rad", ca.asin(sine), about)


def _vector(axis: Expr) -> Expr:
    """A direction (3,) of numbers or expressions, as CasADi has them."""
    if isinstance(axis, ca.SX | ca.DM):
        return axis
    return ca.DM(np.asarray(axis, dtype=float).tolist())
