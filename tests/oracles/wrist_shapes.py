"""Tripods with a wrist of any size, and a verdict on their poses: that of their tripod.

It must never import the toolkit.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oracles.machine_shapes import (
    Geometry,
    Verdict,
    passive_leg,
    rotations,
    tripod_passive_leg,
)

Array = NDArray[np.float64]


def tripod_wrist(rng: np.random.Generator) -> Geometry:
    """Such a tripod with a wrist: a fork, or a roll along the leg and a bend."""
    shape = tripod_passive_leg(rng)
    size, is_fork = shape["reach"] / 0.25, rng.random() < 0.5
    way = np.sign(shape["home"][2])
    above = np.array([0.0, 0.0, -way * 0.2 * size])
    axes = np.eye(3)[[0, 1]] if is_fork else np.eye(3)[[2, 0]]
    shape["wrist_point"] = above + 0.02 * size * rng.normal(size=(2, 3))
    shape["wrist_axis"] = axes + 0.02 * rng.normal(size=(2, 3))
    turn = rng.uniform(-np.pi, np.pi)
    tilt = 0.0 if is_fork else 0.6
    shape["home_tilt"] = tilt * np.array([np.cos(turn), np.sin(turn)])
    return shape | {"reach": 0.15 * size, "tilt": 0.2}


def _wrist(geometry: Geometry, x: Array, q: Array) -> Verdict:
    """The tripod's verdict on its platform, and whether the tool is over it."""
    heads = []
    for pose, joints in zip(x, q, strict=True):
        tool = Rotation.from_matrix(rotations(pose[None])[0])
        place, turn = np.zeros(3), Rotation.identity()
        for k in (1, 0):
            axis = geometry["wrist_axis"][k] / np.linalg.norm(geometry["wrist_axis"][k])
            step = Rotation.from_rotvec(joints[3 + k] * axis)
            centre = geometry["wrist_point"][k]
            place, turn = centre + step.apply(place - centre), step * turn
        head = tool * turn.inv()
        axis = head.apply([0.0, 0.0, 1.0])
        tilt = np.cross([0.0, 0.0, 1.0], axis)
        tilt *= np.arccos(axis[2]) / max(np.linalg.norm(tilt), 1e-12)
        spin = (Rotation.from_rotvec(tilt).inv() * head).as_rotvec()[2]
        heads.append([*(pose[:3] - head.apply(place)), tilt[0], tilt[1], spin])
    return passive_leg(geometry, np.array(heads), q[:, :3])


FAMILIES = {"tripod_wrist": (tripod_wrist, _wrist)}
