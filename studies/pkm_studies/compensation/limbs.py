"""Limbs of a machine as bodies and joints, from the ends of its struts.

A limb is a leg that changes its length, or a strut of fixed length on a carriage or on a
crank. Which one it is, and its numbers, follow from how the strut's end at the base moves
with the joint. Machines that struts alone do not describe have no such limbs: those with
hinges that hold the platform, with cables, and with more joints than freedoms.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array
from oed.mechanism import Kinematics

#: change of a joint, m or rad, from which the motion of a strut's end is taken
TURN, TRAVEL = 0.5, 0.01
#: m; what differs less between two poses does not move
STILL = 1e-9
LEG, CARRIAGE, CRANK = "leg", "carriage", "crank"


@dataclasses.dataclass(frozen=True)
class Limb:
    """A limb at home, in the base frame; m, rad.

    kind      `leg`, `carriage` or `crank`
    centre    (3,) of a crank; where the strut starts, for the others
    start     (3,) of the strut
    end       (3,) of the strut, at the platform
    local     (3,) the same in the platform's frame, from its tool point
    axis      (3,) direction in which the joint moves, or about which it turns
    joint     value of the joint
    """

    kind: str
    centre: Array
    start: Array
    end: Array
    local: Array
    axis: Array
    joint: float


@dataclasses.dataclass(frozen=True)
class PlatformOnLimbs:
    """A platform and its limbs at home.

    rotation  (3, 3) of the platform
    point     (3,) tool point, m
    """

    rotation: Array
    point: Array
    limbs: tuple[Limb, ...]


def platform_on_limbs(
    kinematics: Kinematics, parameters: Array
) -> PlatformOnLimbs | None:
    """The machine with parameters (np,), SI; None where struts do not describe it."""
    machine = kinematics.machine
    count = len(machine.joints)
    other = machine.struts is None or machine.cable_stiffness is not None
    if other or len(machine.pose) != count or len(machine.command) != count:
        return None
    home = machine.home_command
    shift = 0.1 * np.array([c.upper - c.lower for c in machine.command])
    poses, joints = kinematics.inverse(np.array([home, home + shift]), parameters)
    _, ends, _ = kinematics.struts(poses, joints, parameters)
    rotation, point, _ = kinematics.frames(poses, np.zeros(3))
    local = np.einsum("nji,nkj->nki", rotation, ends - point[:, None])
    if np.ptp(local, axis=0).max() > STILL:
        return None
    limbs = [
        _limb(kinematics, poses, joints, parameters, ends[0, k], local[0, k], k)
        for k in range(count)
    ]
    known = [limb for limb in limbs if limb is not None]
    return (
        PlatformOnLimbs(rotation[0], point[0], tuple(known))
        if len(known) == count
        else None
    )


def _limb(
    kinematics: Kinematics,
    poses: Array,
    joints: Array,
    p: Array,
    end: Array,
    local: Array,
    k: int,
) -> Limb | None:
    """Limb k, from where its strut starts at four values of its joint."""
    turns = kinematics.machine.joints[k].unit == "rad"
    change = TURN if turns else TRAVEL
    moved = np.repeat(joints[:1], 4, axis=0)
    moved[:, k] += change * np.array([0.0, 1.0, -1.0, 2.0])
    at_home = np.repeat(poses[:1], 4, axis=0)
    starts, _, longer = kinematics.struts(at_home, moved, p)
    there, ahead, behind, further = starts[:, k]
    joint = float(joints[0, k])
    if turns:
        arm = (2.0 * there - ahead - behind) / (2.0 * (1.0 - np.cos(change)))
        motion = (ahead - behind) / (2.0 * np.sin(change))
        size = float(arm @ arm)
        if size < STILL**2:
            return None
        axis, centre = np.cross(arm, motion) / size, there - arm
        expected = centre + np.cos(2 * change) * arm + np.sin(2 * change) * motion
        whole = abs(np.linalg.norm(axis) - 1.0) < STILL
        if not whole or np.abs(further - expected).max() > STILL:
            return None
        return Limb(CRANK, centre, there, end, local, axis, joint)
    if np.ptp(starts[:, k], axis=0).max() > STILL:
        axis = (ahead - behind) / (2.0 * change)
        straight = np.abs(there + 2.0 * change * axis - further).max() < STILL
        if not straight or abs(np.linalg.norm(axis) - 1.0) > STILL:
            return None
        return Limb(CARRIAGE, there, there, end, local, axis, joint)
    axis = (end - there) / np.linalg.norm(end - there)
    if abs(longer[0, k] - 1.0) > STILL:
        return None
    return Limb(LEG, there, there, end, local, axis, joint)


def square_directions(limb: Limb) -> tuple[Array, Array]:
    """Two unit vectors (3,) square to a strut, about which it swings."""
    along = limb.end - limb.start
    along = along / np.linalg.norm(along)
    first = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    first = first / np.linalg.norm(first)
    return first, np.cross(along, first)
