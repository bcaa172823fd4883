"""Limbs of a tree of bodies: legs, carriages and cranks, and where their loops close.

The file may draw its driven joints at other values than those at which the loops close,
as URDF does. Gauss-Newton steps of the driven joints and the tool point close them; the
platform keeps the orientation in which it is drawn.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array
from pkm_studies.base import InputError, Location
from pkm_studies.drafts.bodies.tree import (
    BALL,
    FREE,
    HINGE,
    SLIDE,
    BodyLoop,
    BodyTree,
    PlacedJoint,
    turn,
)

LEG, CARRIAGE, CRANK = "leg", "carriage", "crank"
#: m or 1, over the largest length; what is off by less is in its place
NEAR = 1e-9
STEPS, CLOSED = 50, 1e-12
#: loops of a file: more limbs than any machine has
MOST_LOOPS = 100
KINDS = (
    "a limb is a leg (a universal or ball joint at the base, then a slide along it), or a"
    " strut with such a joint on a slide or on a hinge"
)


@dataclasses.dataclass
class DrawnLimb:
    """A limb as drawn, in the base frame; m, rad.

    kind    `leg`, `carriage` or `crank`
    drive   its driven joint
    start   (3,) of the strut
    end     (3,) of the strut, at the platform
    local   (3,) the same from the tool point
    motion  of the driven joint, from the drawing to where the loops close
    """

    kind: str
    drive: PlacedJoint
    start: Array
    end: Array
    local: Array
    motion: float = 0.0

    @property
    def strut(self) -> float:
        """Length of the strut as drawn."""
        return float(np.linalg.norm(self.end - self.start))

    @property
    def extension(self) -> float:
        """Length of a leg as drawn, along its slide; a drawing at a joint of 0 may have none."""
        return float((self.end - self.start) @ self.drive.axis)

    def end_at(self, motion: float) -> Array:
        """The strut's end (3,) after a motion of the driven joint alone."""
        axis, anchor = self.drive.axis, self.drive.at
        if self.kind == CRANK:
            return np.asarray(anchor + turn(axis, motion) @ (self.end - anchor))
        return np.asarray(self.end + motion * axis)

    def slope(self, motion: float) -> Array:
        """Slope (3,) of the end over the motion."""
        axis, anchor = self.drive.axis, self.drive.at
        if self.kind == CRANK:
            return np.cross(axis, self.end_at(motion) - anchor)
        return axis


@dataclasses.dataclass(frozen=True)
class DrawnMachine:
    """Limbs, the axes along which the platform moves, and whether it turns.

    home  (3,) tool point where the loops close
    """

    limbs: tuple[DrawnLimb, ...]
    axes: Array
    turns: bool
    home: Array


def drawn_machine(tree: BodyTree, location: Location) -> DrawnMachine:
    """The machine of a tree. Raises InputError where it is none of the kinds above."""
    platform = _platform(tree, location)
    axes, turns = _freedoms(tree.joints(platform), platform, location)
    tool = tree.point(platform, tree.tools.get(platform, np.zeros(3)))
    limbs = [_limb(tree, loop, platform, tool, location) for loop in tree.loops]
    home = _close(limbs, tool, axes, location)
    return DrawnMachine(tuple(limbs), axes, turns, home)


def _platform(tree: BodyTree, location: Location) -> str:
    """The body that all loops share."""
    shared = set.intersection(*({loop.first, loop.second} for loop in tree.loops))
    if len(shared) != 1 or not 2 <= len(tree.loops) <= MOST_LOOPS:
        raise location.error(
            f"its {len(tree.loops)} loops do not share one body, the platform",
            "close each limb by a connection to the platform",
        )
    return shared.pop()


def _freedoms(
    joints: list[PlacedJoint], platform: str, location: Location
) -> tuple[Array, bool]:
    """Directions (n, 3) in which a platform moves, and whether it turns."""
    kinds = [placed.joint.kind for placed in joints]
    axes = np.array([p.axis for p in joints if p.joint.kind == SLIDE]).reshape(-1, 3)
    square = np.abs(axes @ axes.T - np.eye(len(axes))).max(initial=0.0) < NEAR
    turning = [k for k in kinds if k != SLIDE]
    if kinds == [FREE]:
        return np.eye(3), True
    if square and len(axes) == 3 and turning in ([BALL], [HINGE] * 3):
        return np.eye(3), True
    if square and len(axes) in (2, 3) and not turning:
        return axes, False
    raise location.error(
        f"body {platform} has the joints {', '.join(kinds) or 'none'}",
        "a platform is free, or has two or three square slides",
    )


def _limb(
    tree: BodyTree, loop: BodyLoop, platform: str, tool: Array, location: Location
) -> DrawnLimb:
    ends = [(loop.first, loop.on_first), (loop.second, loop.on_second)]
    if loop.first == platform:
        ends.reverse()
    (body, on_body), (_, on_platform) = ends
    end = tree.point(body, on_body)
    local = tree.point(platform, on_platform) - tool
    joints = tree.joints(body)
    kinds = [placed.joint.kind for placed in joints]
    if len(joints) >= 2 and kinds[-1] == SLIDE:
        kind, drive, passive = LEG, joints[-1], joints[:-1]
    elif len(joints) >= 2 and kinds[0] in (SLIDE, HINGE):
        kind = CARRIAGE if kinds[0] == SLIDE else CRANK
        drive, passive = joints[0], joints[1:]
    else:
        raise location.error(
            f"body {body} hangs on {', '.join(kinds) or 'nothing'}", KINDS
        )
    if any(p.joint.kind not in (HINGE, BALL) for p in passive):
        raise location.error(f"body {body} hangs on {', '.join(kinds)}", KINDS)
    start = _meeting_point(passive, end, body, location)
    limb = DrawnLimb(kind, drive, start, end, local)
    across = end - start - limb.extension * drive.axis
    if kind == LEG and np.linalg.norm(across) > NEAR:
        raise _no_leg(limb, location)
    return limb


def _no_leg(limb: DrawnLimb, location: Location) -> InputError:
    return location.error(
        f"{limb.drive.joint.name} does not move along the leg from its base joint",
        "a leg's slide runs from the base joint to the platform joint, and grows",
    )


def _meeting_point(
    passive: list[PlacedJoint], end: Array, body: str, location: Location
) -> Array:
    """Where the axes of hinges meet, or a ball joint is; of one hinge, across the end."""
    balls = [p.at for p in passive if p.joint.kind == BALL]
    if balls and len(passive) == 1:
        return balls[0]
    if len(passive) == 1:
        only = passive[0]
        return np.asarray(only.at + (end - only.at) @ only.axis * only.axis)
    across = [np.eye(3) - np.outer(p.axis, p.axis) for p in passive]
    right = [a @ p.at for a, p in zip(across, passive, strict=True)]
    point = np.linalg.lstsq(np.vstack(across), np.concatenate(right), rcond=1e-9)[0]
    missed = [a @ (point - p.at) for a, p in zip(across, passive, strict=True)]
    size = max(1.0, float(np.abs(end).max()))
    if balls or np.abs(missed).max() > NEAR * size:
        raise location.error(f"the passive joints of body {body} do not meet", KINDS)
    return np.asarray(point)


def _close(
    limbs: list[DrawnLimb], tool: Array, axes: Array, location: Location
) -> Array:
    """Move the driven joints until the loops close; the tool point (3,) there."""
    count, freedoms = len(limbs), len(axes)
    moves = np.zeros(freedoms + count)
    for _ in range(STEPS):
        rows, gaps = [], []
        for k, limb in enumerate(limbs):
            motion = moves[freedoms + k]
            point = tool + moves[:freedoms] @ axes
            gaps.append(point + limb.local - limb.end_at(motion))
            row = np.zeros((3, freedoms + count))
            row[:, :freedoms], row[:, freedoms + k] = axes.T, -limb.slope(motion)
            rows.append(row)
        if np.abs(gaps).max() < CLOSED:
            break
        moves -= np.linalg.lstsq(np.vstack(rows), np.concatenate(gaps), rcond=1e-12)[0]
    else:
        raise location.error(
            f"the loops are open by {np.abs(gaps).max():.3g} m as they are drawn",
            "draw the passive joints as they are where the loops close",
        )
    for limb, motion in zip(limbs, moves[freedoms:], strict=True):
        limb.motion = float(motion)
        if limb.kind == LEG and limb.extension + limb.motion <= 0.0:
            raise _no_leg(limb, location)
    return np.asarray(tool + moves[:freedoms] @ axes)
