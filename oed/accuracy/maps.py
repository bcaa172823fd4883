"""Pose errors of changed parameters: linear maps, and exactly for a compensated machine.

The linear maps state them against a reference:

"absolute"  in the base frame
"home"      zeroed at the home pose: of the place, the error at home is subtracted; of the
            orientation R, the turn from home R R_home^T is compared with the commanded one
"best_fit"  after the best rigid alignment of all workspace poses
"""

import dataclasses
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
import scipy

from oed.base import Array, consecutive_slices
from oed.mechanism import NO_TOOL, ErrorModel, Kinematics, pose_error

Reference = Literal["home", "absolute", "best_fit"]


@dataclasses.dataclass(frozen=True)
class ErrorMaps:
    """Slopes of k pose error components over np parameters, at n commands; SI.

    command    (n, n_dof)
    names      (k,) of the components
    raw        (n, k, np) without compensation
    remaining  (n, k, np) with the compensatable components nulled

    >>> import numpy as np
    >>> from oed import Measurement, mount
    >>> from oed.accuracy import ErrorMaps
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> command = np.array([[0.0, 0.5], [1.0, 0.5]])
    >>> maps = ErrorMaps.of(measurement.kinematics, command)
    >>> maps.names
    ('y', 'z')
    """

    command: Array
    names: tuple[str, ...]
    raw: Array
    remaining: Array

    @classmethod
    def of(
        cls,
        kinematics: Kinematics,
        command: Array,
        reference: Reference = "home",
        tool: Array = NO_TOOL,
        further: tuple[Array, Array] | None = None,
        parameters: Array | None = None,
    ) -> "ErrorMaps":
        """Error maps at workspace commands (n, n_dof), SI. Raises AssemblyError.

        tool        tool point in the platform's frame; home is home with this tool
        further     twists (n + 1, 6, m) per unit of m coefficients, raw and remaining, the
                    home pose last; the maps are then over them in place of the parameters
        parameters  (np,) of the machine about which the maps hold; nominal by default
        """
        of_one = (reference,)
        return maps_by_reference(
            kinematics, command, of_one, tool, further, parameters
        )[reference]


def maps_by_reference(
    kinematics: Kinematics,
    command: Array,
    references: Sequence[Reference],
    tool: Array = NO_TOOL,
    further: tuple[Array, Array] | None = None,
    parameters: Array | None = None,
) -> dict[Reference, ErrorMaps]:
    """Error maps against several references, as `ErrorMaps.of`."""
    machine = kinematics.machine
    model = ErrorModel.of(kinematics, machine.and_home(command, tool), tool, parameters)
    twists = (model.raw, model.remaining) if further is None else further
    slope = kinematics.error_components_jacobian(command)
    names = tuple(c.name for c in machine.components)
    maps: dict[Reference, ErrorMaps] = {}
    for reference in references:
        frame = (model.rotation, model.point, reference, machine.alignment_lever)
        raw, remaining = (slope @ _relative(twist, *frame) for twist in twists)
        maps[reference] = ErrorMaps(command, names, raw, remaining)
    return maps


def raw_maps_of_machines(
    kinematics: Kinematics,
    command: Array,
    references: Sequence[Reference],
    tool: Array,
    parameters: Array,
) -> list[dict[Reference, Array]]:
    """Maps (n, k, np) without compensation about each of m machines, p (m, np).

    Raises AssemblyError, with machine times (n + 1) plus pose, home the last.
    """
    machine = kinematics.machine
    count = len(parameters)
    poses = machine.and_home(command, tool)
    p = np.repeat(parameters, len(poses), axis=0)
    x, q = kinematics.inverse(np.tile(poses, (count, 1)), p, tool)
    rotation, point, twist = kinematics.frames(x, tool)
    raw = twist @ kinematics.slopes.pose_by_parameter(x, q, p)
    slope = kinematics.error_components_jacobian(command)
    maps = []
    for rows in consecutive_slices([len(poses)] * count):
        frame = (raw[rows], rotation[rows], point[rows])
        lever = machine.alignment_lever
        maps.append({r: slope @ _relative(*frame, r, lever) for r in references})
    return maps


def relative_to_reference(
    twist: Array, rotation: Array, point: Array, reference: Reference, lever: float
) -> Array:
    """Twist errors (n, 6) of one machine at n poses, relative to the reference.

    twist, rotation, point  (n + 1, 6), (n + 1, 3, 3), (n + 1, 3) at the poses, home the last
    lever                   m, weighs rotations in the best fit

    Zeroing at home composes finite rotations: a lost spin of milliradians times an
    orientation error would otherwise look like an error of its own.
    """
    if reference != "home":
        return _relative(twist[:, :, None], rotation, point, reference, lever)[:, :, 0]
    turn = scipy.spatial.transform.Rotation.from_rotvec
    in_platform = np.einsum("nji,nj->ni", rotation, twist[:, 3:])
    relative = turn(in_platform[:-1]) * turn(in_platform[-1]).inv()
    in_base = np.einsum("nij,nj->ni", rotation[:-1], relative.as_rotvec())
    return np.hstack([twist[:-1, :3] - twist[-1:, :3], in_base])


def _relative(
    twist: Array, rotation: Array, point: Array, reference: Reference, lever: float
) -> Array:
    """Twists or slopes (n, 6, m), n poses and home, relative to the reference."""
    twist, home_twist = twist[:-1], twist[-1:]
    if reference == "absolute":
        return twist
    if reference == "home":
        # Zeroing on the body: place in the base frame, orientation in the platform's
        # own axes.
        carry = np.zeros((len(twist), 6, 6))
        carry[:, :3, :3] = np.eye(3)
        carry[:, 3:, 3:] = rotation[:-1] @ rotation[-1].T
        return twist - carry @ home_twist
    if reference == "best_fit":
        return _remove_rigid_motion(twist, point[:-1], lever)
    raise ValueError(f"reference {reference!r} is none of {get_args(Reference)}")


def _remove_rigid_motion(twist: Array, point: Array, lever: float) -> Array:
    """Twists (n, 6, m) less the rigid motion that fits them best.

    point  (n, 3) tool points, m
    lever  m, weight of rotations; 0 for places alone. A machine that never turns has no orientation to
           align: its points alone are fitted
    """
    n = len(twist)
    rigid = np.zeros((n, 6, 6))
    rigid[:, :3, :3] = rigid[:, 3:, 3:] = np.eye(3)
    # turns about the base axes shift a point by their cross products with its lever
    rigid[:, :3, 3:] = np.cross((point - point.mean(axis=0))[:, None], np.eye(3))
    weight = np.ones((6, 1))
    weight[3:] = lever if twist[:, 3:].any() else 0.0
    design = (rigid * weight).reshape(6 * n, 6)
    data = (twist * weight).reshape(6 * n, -1)
    motion = np.linalg.lstsq(design, data, rcond=None)[0]
    fit = rigid.reshape(6 * n, 6) @ motion
    return twist - fit.reshape(twist.shape)


def components_against(
    kinematics: Kinematics,
    command: Array,
    twist: Array,
    reference: Reference,
    tool: Array = NO_TOOL,
) -> Array:
    """Errors (..., n, k) of the pose components, SI, against a reference.

    twist  (..., n + 1, 6) pose errors of machines at commands (n, n_dof), home the last
    """
    machine = kinematics.machine
    x, _ = kinematics.inverse(machine.and_home(command, tool), machine.nominal, tool)
    rotation, point, _ = kinematics.frames(x, tool)
    frame = (rotation, point, reference, machine.alignment_lever)
    relative = [
        relative_to_reference(of_one, *frame)
        for of_one in twist.reshape(-1, len(command) + 1, 6)
    ]
    commands = np.tile(command, (len(relative), 1))
    components = kinematics.error_components(commands, np.vstack(relative))
    return components.reshape(*twist.shape[:-2], len(command), -1)


def driven_errors(
    kinematics: Kinematics,
    command: Array,
    parameters: Array,
    reference: Reference,
    *,
    believed: Array | None = None,
    tool: Array = NO_TOOL,
) -> Array:
    """Exact errors (n, k) of pose components at commands (n, n_dof), SI.

    parameters  (np,) of the machine, or (m, np) of m machines, whose errors are (m, n, k)
    believed    (np,) or (m, np) by which its joints are driven; what its controller holds
                by default

    Raises AssemblyError.
    """
    poses = kinematics.machine.and_home(command, tool)
    if believed is None:
        _, joints = kinematics.sent(poses, tool)
    else:
        several = np.atleast_2d(believed)
        of_each = np.repeat(several, len(poses), axis=0)
        every = np.tile(poses, (len(several), 1))
        _, joints = kinematics.inverse(every, of_each, tool)
        joints = joints.reshape(*believed.shape[:-1], len(poses), -1)
    twist = pose_error(kinematics, poses, joints, parameters, tool)
    return components_against(kinematics, command, twist, reference, tool)
