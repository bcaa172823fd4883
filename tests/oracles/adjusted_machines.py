"""Oracle for adjusted heads: poses, controllers and errors of the A3 and the 3-PRS head.

All rests on the closures of the other oracles, in plain NumPy: a controller finds joints
for its parameters by Newton's method with differences, and errors are differences of
Euler angles, zeroed at home.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracles import a3_geometry as a3
from oracles import prs_geometry as prs

Array = NDArray


class Head(NamedTuple):
    """A head: commands are z and two angles, errors x, y, z and three angles.

    forward(q, p)     tool point (..., 3) and rotation (..., 3, 3)
    nominal(command)  tool point, rotation and joints of the machine as drawn
    angles(rotation)  (..., 3); the first two are commanded
    home              command at which errors are zeroed
    """

    forward: Callable[[Array, Array], tuple[Array, Array]]
    nominal: Callable[[Array], tuple[Array, Array, Array]]
    angles: Callable[[Array], Array]
    home: Array


def _prs_forward(q: Array, p: Array) -> tuple[Array, Array]:
    reached = prs.forward(q, p.reshape(*p.shape[:-1], 3, 6))
    return reached.tip, reached.rotation


def _a3_forward(q: Array, p: Array) -> tuple[Array, Array]:
    reached = a3.forward(p, q)
    return reached.tip, reached.R


def _a3_nominal(command: Array) -> tuple[Array, Array, Array]:
    columns = command.T
    return *a3.nominal_pose(*columns), a3.inverse_nominal(*columns)


PRS = Head(
    _prs_forward,
    lambda command: prs.nominal(*command.T),
    prs.angles,
    np.array([0.2, 0.0, 0.0]),
)
A3 = Head(
    _a3_forward,
    _a3_nominal,
    lambda rotation: np.stack(a3.euler(rotation), -1),
    np.array([a3.C + a3.D, 0.0, 0.0]),
)


def joints(head: Head, command: Array, p: Array) -> Array:
    """Joints (n, 3) that bring height and tool axis of machine p (np,) to commands."""
    tip, rotation, q = head.nominal(command)
    wanted = np.column_stack([tip[:, 2], rotation[:, 0, 2], rotation[:, 1, 2]])

    def driven(q: Array) -> Array:
        tip, rotation = head.forward(q, p)
        return np.column_stack([tip[:, 2], rotation[:, 0, 2], rotation[:, 1, 2]])

    for _ in range(6):
        gap = driven(q) - wanted
        steps = 1e-6 * np.eye(3)
        slope = np.stack([(driven(q + s) - driven(q - s)) / 2e-6 for s in steps], -1)
        q = q - np.linalg.solve(slope, gap[..., None])[..., 0]
    return q


def errors(head: Head, command: Array, controller: Array, p: Array) -> Array:
    """Errors (n, 6), m and rad, of machine p with a controller's parameters, from home.

    Place is zeroed in the base frame, orientation in the platform's own axes.
    """
    poses = np.vstack([command, head.home])
    tip, rotation, _ = head.nominal(poses)
    reached, turned = head.forward(joints(head, poses, controller), p)
    shift = reached - tip
    zero = rotation[-1].T @ turned[-1]
    angles = head.angles(turned[:-1] @ zero.T) - head.angles(rotation[:-1])
    angles = (angles + np.pi) % (2.0 * np.pi) - np.pi
    return np.hstack([shift[:-1] - shift[-1], angles])
