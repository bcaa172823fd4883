"""What the families with six coordinates of a platform have in common."""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from oed.base import Array
from oed.model import Component, Coordinate, Dimension, Expr, Parameter, Strut, Values
from pkm_models.machines.parts import coordinates, families
from pkm_models.machines.parts.families import Geometry, point
from pkm_models.machines.parts.six_dof import ANGLES, XYZ, platform
from pkm_models.rotation import across

Point = tuple[float, float, float]
DIRECTION_SD = 1e-3  #: prior standard deviations of directions, rad
BASE = "joint centres at the base, in the base frame"
PLATFORM = "joint centres at the platform, from the tool point"
SIDE = "1 where the carriage is ahead of its platform joint, -1 where behind"
LEG = "length of leg {} less its zero"  #: joints of extensible legs and of carriages
CARRIAGE = "travel of carriage {} along the direction of its guide"
#: commands of a tripod: height and tilt vector of the tool
TRIPOD_COMMAND = ("z", "rx", "ry")


def ranges_dimensions(
    home: Sequence[float], reach: float, tilt: float
) -> tuple[Dimension, ...]:
    """Home of the tool point, how far the workspace reaches about it, and the tilt."""
    return (
        Dimension("home", "m", (3,), tuple(home), "tool point at home"),
        Dimension("reach", "m", (), reach, "half the workspace's width about home"),
        Dimension("tilt", "rad", (), tilt, "largest tilt, either way"),
        families.tolerance_dimension(),
    )


def platform_joint(x: Values, p: Values, i: int) -> Expr:
    """Joint centre (3,) of limb i at the platform, in the base frame."""
    return leg_in(platform(x), p, i)[1]


def leg(x: Values, p: Values, i: int) -> Strut:
    """Ends (3,) of an extensible leg, at the base and at the platform."""
    return leg_in(platform(x), p, i)


def leg_in(frame: tuple[Expr, Expr], p: Values, i: int) -> Strut:
    """As `leg`, of a platform of this rotation and origin."""
    rotation, origin = frame
    return point(p, "b", i), origin + rotation @ point(p, "a", i)


def leg_length(x: Values, p: Values, i: int) -> Expr:
    """Distance of a leg's joints less the zero of its scale, m."""
    return length_in(platform(x), p, i)


def length_in(frame: tuple[Expr, Expr], p: Values, i: int) -> Expr:
    """As `leg_length`, of a platform of this rotation and origin."""
    foot, joint = leg_in(frame, p, i)
    return ca.norm_2(joint - foot) - p[f"l{i}"]


def drawn(
    x: Values, p: Values, base: Sequence[Point], platform_joints: Sequence[Point]
) -> list[Strut]:
    """Ends (3,) of limbs between joints as drawn, with errors `db1x`, `da1x`, ..."""
    rotation, origin = platform(x)
    struts = []
    for i, (foot, joint) in enumerate(zip(base, platform_joints, strict=True), start=1):
        local = ca.vertcat(*families.shifted(joint, p, f"da{i}"))
        base_end = ca.vertcat(*families.shifted(foot, p, f"db{i}"))
        struts.append((base_end, origin + rotation @ local))
    return struts


class ExtensibleLegs:
    """Legs between the points of a table of geometry, each with the zero of its scale.

    home       (3,) tool point at home, m
    drawn      (n, 3) legs at home, m
    lengths    (n,) of them
    size       largest distance of a platform joint from the tool point, m
    tolerance  standard deviation of places and lengths, m
    """

    def __init__(self, table: Geometry) -> None:
        self.base = families.array(table, "base")
        self.platform = families.array(table, "platform")
        self.home = families.array(table, "home")
        self.drawn = self.home + self.platform - self.base
        self.lengths = np.linalg.norm(self.drawn, axis=1)
        self.size = families.largest(self.platform)
        self.tolerance = families.tolerance(table, float(self.lengths.mean()))

    def parameters(self) -> list[Parameter]:
        """Joints at base and platform, and zeros."""
        sd = self.tolerance
        zeros = [0.0] * len(self.base)
        return [
            *families.places("b", self.base, sd, "base joint"),
            *families.places("a", self.platform, sd, "platform joint"),
            *families.numbers("l", zeros, sd, "m", "zero of leg"),
        ]

    def struts(self, x: Values, q: Values, p: Values) -> list[Strut]:
        """Ends of all legs."""
        return [leg(x, p, i) for i in range(1, len(self.base) + 1)]

    def skeleton(self, x: Values, q: Values, p: Values) -> list[list[Expr]]:
        """Base, legs, platform and tool."""
        feet, joints = zip(*self.struts(x, q, p), strict=True)
        return skeleton(feet, joints, x)


def errors(free: Sequence[str]) -> tuple[Component, ...]:
    """Pose errors x, y, z and rotation vector; those in `free` can be nulled."""
    errors = [coordinates.point_error(n, driven=n in free) for n in XYZ]
    turns = [coordinates.turn_error(n, driven=n in free) for n in ("ax", "ay", "az")]
    return (*errors, *turns)


def pose_at(c: Values, home: Sequence[float]) -> dict[str, Expr]:
    """A pose by name: the command's coordinates, home's place, and no spin."""
    start = dict(zip(XYZ, home, strict=True)) | dict.fromkeys(ANGLES, 0.0)
    return {**start, **dict(c)}


def skeleton(
    feet: Sequence[Expr], joints: Sequence[Expr], x: Values
) -> list[list[Expr]]:
    """Base, limbs, platform and tool."""
    centre = sum(joints[1:], joints[0]) / len(joints)
    limbs = [[b, a] for b, a in zip(feet, joints, strict=True)]
    base, top = [*feet, feet[0]], [*joints, joints[0]]
    return [base, *limbs, top, [centre, platform(x)[1]]]


class FixedStruts:
    """Struts of fixed length on carriages or cranks, limbs 1 to n."""

    @property
    def limbs(self) -> range:
        """Numbers of the limbs, from 1."""
        raise NotImplementedError

    def ends(self, x: Values, q: Values, p: Values, i: int) -> Strut:
        """Ends (3,) of a strut, at what moves it and at the platform."""
        raise NotImplementedError

    def struts(self, x: Values, q: Values, p: Values) -> list[Strut]:
        """Ends of all struts."""
        return [self.ends(x, q, p, i) for i in self.limbs]

    def closure(self, x: Values, q: Values, p: Values) -> list[Expr]:
        """Strut lengths, m."""
        ends = zip(self.limbs, self.struts(x, q, p), strict=True)
        return [ca.norm_2(joint - foot) - p[f"l{i}"] for i, (foot, joint) in ends]


# -- carriages on straight guides ------------------------------------------------------
def direction(p: Values, i: int, along: Array, sides: Array) -> Expr:
    """Direction (3,) of guide i with its two tilts."""
    tilted = (
        ca.DM(along)
        + p[f"tilt{i}a"] * ca.DM(sides[0])
        + p[f"tilt{i}b"] * ca.DM(sides[1])
    )
    return tilted / ca.norm_2(tilted)


def travel(joint: Expr, foot: Expr, axis: Expr, strut: Expr, side: float) -> Expr:
    """Travel along a guide that puts a strut's carriage at its length from a joint."""
    offset = joint - foot
    along = ca.dot(offset, axis)
    sideways = ca.dot(offset, offset) - along**2
    height = ca.sqrt(strut**2 - sideways)
    return along + side * height


def tilts(directions: Array, what: str, frame: str = "base") -> list[Parameter]:
    """Two tilts, rad, of each direction (n, 3): towards those `across` it, of a frame."""
    return [
        Parameter(
            f"tilt{i}{k}",
            0.0,
            DIRECTION_SD,
            "rad",
            f"tilt of {what} {i} towards ({x:.3g}, {y:.3g}, {z:.3g}) of the {frame} frame",
        )
        for i, sides in enumerate(across(directions), start=1)
        for k, (x, y, z) in zip("ab", sides + 0.0, strict=True)
    ]


def guide_dimensions(
    guide: Array, along: Array, strut: float, side: Sequence[float]
) -> tuple[Dimension, ...]:
    """Guides, their directions, struts and the sides of their carriages."""
    n = len(guide)
    return (
        Dimension("guide", "m", (n, 3), guide, "points of the guides at travel 0"),
        Dimension("direction", "1", (n, 3), along, "directions of the guides"),
        Dimension("strut", "m", (n,), strut, "strut lengths"),
        Dimension("side", "1", (n,), tuple(side), SIDE),
    )


# -- tripods ---------------------------------------------------------------------------
def tripod_command(table: Geometry) -> tuple[Coordinate, ...]:
    """Height within reach of home, and tilt vector."""
    z, reach, tilt = (
        float(table["home"][2]),
        float(table["reach"]),
        float(table["tilt"]),
    )
    of = coordinates.TILT_DIRECTION
    angles = [coordinates.angle(n, -tilt, tilt, of=of) for n in TRIPOD_COMMAND[1:]]
    return (coordinates.point("z", z - reach, z + reach), *angles)


def tripod_start(c: Values, p: Values) -> list[Expr]:
    """Pose with the platform's joints over the base's, upright up to its tilt."""
    rotation, _ = platform(pose_at(c, (0.0, 0.0, 0.0)))
    offset = _centre(p, "b") - rotation @ _centre(p, "a")
    return [offset[0], offset[1], c["z"], c["rx"], c["ry"], 0.0]


def _centre(p: Values, stem: str) -> Expr:
    points = [point(p, stem, i) for i in (1, 2, 3)]
    return sum(points[1:], points[0]) / 3.0


def hinge(v: Expr, axis: Array, p: Values, i: int) -> Expr:
    """How far a strut (3,) is out of the plane of its hinge, m."""
    tilt = p[f"hinge{i}"]
    return ca.dot(ca.DM(axis), v) - ca.norm_2(v) * ca.sin(tilt)


def hinge_parameters() -> list[Parameter]:
    """The tilts of three struts out of the planes of their hinges, rad."""
    about = "tilt out of its plane of strut"
    return families.numbers("hinge", (0.0, 0.0, 0.0), DIRECTION_SD, "rad", about)
