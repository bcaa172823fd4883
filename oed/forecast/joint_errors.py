"""Errors of the driven components as functions of errors of the joints, here and at home.

What calibration leaves is smooth in the joints, which yield under load, not in the pose:
near a singular pose a joint's error moves the tool far. So an error of the k driven
components at a command is

    e = L(c) u(c) + H(c) u(home) + G(c) p,

with u the errors of the joints, L and H their effect on the error against the reference,
and p errors of the parameters. Commands enter by the joints that they ask for, along the
principal axes of these over the workspace. There a full turn ends where it began, a tilt
of zero has one direction, and the places near a singular pose, where errors change fast,
lie far apart.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from oed.accuracy import Reference, error_maps
from oed.base import Array
from oed.mechanism import NO_TOOL, Kinematics
from oed.model import Component

#: what counts as an equal place, m or rad
POSITION_TOLERANCE = 1e-9
#: slope over a twist from which on a component's error has no meaning: psi of an upright
#: tool
MAX_SLOPE = 1e3


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorRows:
    """Errors (n, k) of the driven components as functions of joints and parameters.

    positions     (n, a) joints along their principal axes, the workspace from -1 to 1
    local         (n, k, q) per error of each joint at the command, SI
    at_home       (n, k, q) per error of each joint at home, SI
    by_parameter  (n, k, b) per standard deviation of b known directions of the parameters
    """

    positions: Array
    local: Array
    at_home: Array
    by_parameter: Array


@dataclasses.dataclass(frozen=True, eq=False)
class JointErrors:
    """Error rows of a machine over a workspace.

    kinematics  of the machine
    command     (n, n_dof) commands of the workspace, SI
    reference   against which errors are stated: home or absolute
    spread      (np, b) of the parameters' errors, per standard deviation, SI; b = 0
                where no parameter was estimated
    """

    kinematics: Kinematics
    command: Array
    reference: Reference
    spread: Array

    @property
    def driven(self) -> tuple[Component, ...]:
        """Components (k,) that the joints drive."""
        return tuple(c for c in self.kinematics.machine.components if c.compensatable)

    @property
    def _driven(self) -> list[int]:
        components = self.kinematics.machine.components
        return [k for k, c in enumerate(components) if c.compensatable]

    @property
    def home_place(self) -> Array:
        """Where home lies (a,) among the places."""
        return np.asarray(self.positions(self.kinematics.machine.home_command[None])[0])

    def positions(self, command: Array) -> Array:
        """Joints at commands (n, n_dof), along their principal axes, scaled (n, a)."""
        middle, axes = self._axes
        return np.asarray((self.kinematics.inverse(command)[1] - middle) @ axes)

    @functools.cached_property
    def _axes(self) -> tuple[Array, Array]:
        """Middle (q,) and axes (q, a) that scale the workspace's joints to -1 to 1."""
        joints = self.kinematics.inverse(self.command)[1]
        count = int((np.ptp(self.command, axis=0) > POSITION_TOLERANCE).sum())
        axes = np.linalg.svd(joints - joints.mean(axis=0), full_matrices=False)[2].T
        along = joints @ axes[:, :count]
        low, high = along.min(axis=0), along.max(axis=0)
        middle = axes[:, :count] @ ((low + high) / 2.0)
        return middle, np.asarray(axes[:, :count] * 2.0 / (high - low))

    def rows(self, command: Array) -> ErrorRows:
        """The rows at commands (n, n_dof). Raises AssemblyError."""
        kinematics = self.kinematics
        machine = kinematics.machine
        driven = self._driven
        both = np.vstack([command, machine.home_command[None]])
        motion = self._twists(both)
        count = motion.shape[2]
        apart = np.zeros((len(both), 6, 2 * count))
        apart[:-1, :, :count] = motion[:-1]
        apart[-1, :, count:] = motion[-1]
        maps = error_maps(
            kinematics, command, self.reference, further=(apart, apart)
        ).raw[:, driven]
        of_parameters = np.zeros((len(command), len(driven), 0))
        if self.spread.shape[1]:
            raw = error_maps(kinematics, command, self.reference).raw[:, driven]
            of_parameters = raw @ self.spread
        return ErrorRows(
            positions=self.positions(command),
            local=maps[:, :, :count],
            at_home=maps[:, :, count:],
            by_parameter=of_parameters,
        )

    def meaningful(self, command: Array) -> Array:
        """Which components (n, k) have an error at commands (n, n_dof)."""
        jacobian = self.kinematics.error_components_jacobian(command)
        size = np.linalg.norm(jacobian[:, self._driven], axis=2)
        return np.asarray(np.isfinite(size) & (size < MAX_SLOPE))

    def _twists(self, command: Array) -> Array:
        """Twists (n, 6, q) per error of each joint; of the struts where they are stated."""
        kinematics, machine = self.kinematics, self.kinematics.machine
        x, q = kinematics.inverse(command)
        by_joint = kinematics.slopes.over_joints(x, q, machine.nominal)
        if machine.struts is not None:
            by_joint = by_joint * kinematics.struts(x, q, machine.nominal)[2][:, None]
        return np.asarray(kinematics.frames(x, NO_TOOL)[2] @ by_joint)
