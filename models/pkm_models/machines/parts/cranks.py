"""Struts of fixed length on cranks: what rotary deltas, hexapods and five-bars share.

Crank i turns by q_i + zero_i, right-handed, about an axis w_i through b_i. Its knee is at

    k_i = b_i + r_i (cos(q_i + zero_i) u_i + sin(q_i + zero_i) w_i x u_i),

with u_i the direction of the crank at angle 0, and the strut runs from there to the
platform's joint.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from oed.base import Array
from oed.model import (
    Coordinate,
    Dimension,
    Expr,
    Parameter,
    PassiveJoint,
    Start,
    Strut,
    Values,
)
from pkm_models.machines.parts import families, legs, passive
from pkm_models.machines.parts.coordinates import joint
from pkm_models.machines.parts.families import point
from pkm_models.rotation import across

ZERO_SD = 2e-3  #: prior standard deviation of the cranks' zeros, rad
MAX_ANGLE = 1.5 * math.pi  #: cranks turn by less than this either way, rad
#: joints of cranks
CRANK = "angle of crank {}, right-handed about its axis, from the direction of angle 0"
SIDE = (
    "1 where the knee is ahead, by the crank's sense, of the line to its platform joint,"
    " -1 where behind"
)


@dataclasses.dataclass(frozen=True, eq=False)
class CrankedStruts(legs.FixedStruts):
    """Limbs 1 to n."""

    axis: Array  #: (n, 3) directions w_i
    #: (n, 3) directions u_i; what of them is along the axis does not count
    first: Array
    #: (n,) 1 where a knee is ahead of the line to the platform joint, -1 where behind
    side: Array
    #: (x, p, i) the platform joint (3,) of a limb
    joint: Callable[[Values, Values, int], Expr]
    #: whether the machine is planar: points have x and y, and no axis is tilted
    flat: bool = False

    @functools.cached_property
    def _across(self) -> Array:
        return across(self.axis)

    @property
    def limbs(self) -> range:
        """Numbers of the limbs, from 1."""
        return range(1, len(self.axis) + 1)

    def centre(self, p: Values, i: int) -> Expr:
        """Centre (3,) of a crank."""
        if self.flat:
            return ca.vertcat(p[f"b{i}x"], p[f"b{i}y"], 0.0)
        return point(p, "b", i)

    def turning_axis(self, p: Values, i: int) -> Expr:
        """Direction (3,) of a crank's axis."""
        if self.flat:
            return ca.DM(self.axis[i - 1])
        return legs.direction(p, i, self.axis[i - 1], self._across[i - 1])

    def _directions(self, p: Values, i: int) -> tuple[Expr, Expr]:
        """Directions (3,) of a crank at angle 0 and at a right angle."""
        axis, first = self.turning_axis(p, i), ca.DM(self.first[i - 1])
        first = first - ca.dot(first, axis) * axis
        first = first / ca.norm_2(first)
        return first, ca.cross(axis, first)

    def ends(self, x: Values, q: Values, p: Values, i: int) -> Strut:
        """Ends (3,) of a strut, at the knee and at the platform."""
        first, second = self._directions(p, i)
        angle = q[f"q{i}"] + p[f"zero{i}"]
        arm = p[f"r{i}"] * (ca.cos(angle) * first + ca.sin(angle) * second)
        return self.centre(p, i) + arm, self.joint(x, p, i)

    def angles(self, x: Values, p: Values) -> list[Expr]:
        """Angle of each crank for a pose, with the knee on its side."""
        angles = []
        for i in self.limbs:
            first, second = self._directions(p, i)
            offset = self.joint(x, p, i) - self.centre(p, i)
            along, up = ca.dot(offset, first), ca.dot(offset, second)
            crank, strut = p[f"r{i}"], p[f"l{i}"]
            reach = ca.dot(offset, offset) + crank**2 - strut**2
            cosine = reach / (2.0 * crank * ca.sqrt(along**2 + up**2))
            turn = ca.acos(cosine)
            angles.append(ca.atan2(up, along) + self.side[i - 1] * turn - p[f"zero{i}"])
        return angles

    def start(self, pose: Sequence[Expr]) -> Callable[[Values, Values], Start]:
        """A guess of a machine whose pose has the command's coordinates `pose`."""
        return lambda c, p: ([c[n] for n in pose], self.angles(c, p))

    def skeleton(self, x: Values, q: Values, p: Values) -> list[list[Expr]]:
        """Base, and each crank with its strut."""
        centres = [self.centre(p, i) for i in self.limbs]
        limbs = zip(centres, self.struts(x, q, p), strict=True)
        lines = [[centre, *strut] for centre, strut in limbs]
        return [[*centres, centres[0]], *lines]

    def passive(self, x: Values, q: Values, p: Values) -> list[PassiveJoint]:
        """Universal joints of the struts at the knees: first axes along the cranks'."""
        struts = self.struts(x, q, p)
        axes = [self.turning_axis(p, i) for i in self.limbs]
        uprights = []
        for first, axis in zip(self.first, self.axis, strict=True):
            uprights.append(np.cross(axis, first))
        if self.flat:
            return passive.hinges(struts, axes, np.array(uprights))
        return passive.universals(struts, axes, np.array(uprights))


def dimensions(
    centre: Array, axis: Array, first: Array, crank: float, strut: float, side: float
) -> tuple[Dimension, ...]:
    """Centres, axes and zero directions of the cranks, and the lengths of the limbs."""
    n = len(centre)
    return (
        Dimension("centre", "m", (n, 3), centre, "centres of the cranks"),
        Dimension("axis", "1", (n, 3), axis, "axes of the cranks, right-handed"),
        Dimension("first", "1", (n, 3), first, "directions of the cranks at angle 0"),
        Dimension("crank", "m", (n,), crank, "lengths of the cranks"),
        Dimension("strut", "m", (n,), strut, "lengths of the struts"),
        Dimension("side", "1", (n,), (side,) * n, SIDE),
    )


def joints(count: int) -> tuple[Coordinate, ...]:
    """Joints `q1`, `q2`, ..., rad."""
    names = [f"q{i + 1}" for i in range(count)]
    return tuple(joint(name, "rad", -MAX_ANGLE, MAX_ANGLE, CRANK) for name in names)


def parameters(
    centre: Array, axis: Array, crank: Array, strut: Array, sd: float
) -> tuple[Parameter, ...]:
    """Centres (n, 2) or (n, 3) with zeros and lengths; axes (n, 3) tilt in space alone."""
    n, axes = centre.shape
    return (
        *families.places("b", centre, sd, "centre of crank", "xyz"[:axes]),
        *(legs.tilts(axis, "the axis of crank") if axes == 3 else ()),
        *families.numbers("zero", [0.0] * n, ZERO_SD, "rad", "zero error of crank"),
        *families.numbers("r", crank.tolist(), sd, "m", "length of crank"),
        *families.numbers("l", strut.tolist(), sd, "m", "length of strut"),
    )


def directions(axis: Array, first: Array, count: int) -> tuple[Array, Array]:
    """Unit axes and directions at angle 0 (n, 3). Raises ValueError for none."""
    axis = families.unit_vectors(axis, count)
    first = families.unit_vectors(first, count)
    square = first - np.sum(first * axis, axis=1, keepdims=True) * axis
    if np.linalg.norm(square, axis=1).min() < 1e-6:
        raise ValueError("first: a crank's direction at angle 0 lies along its axis")
    return axis, families.unit_vectors(square, count)
