"""Joints that hold commands, and offsets for additional axes where no joint does.

A machine that drives z and two tilts leaves errors in x, in y and about the tool axis.
With the joints at what compensation gives, they are known as well as the parameters are,
and an X-Y table or a part program can take them back. Tian et al. (2016) correct x and y
by the drives of their table (section 4).
"""

import dataclasses

import numpy as np

from oed.base import Array
from oed.mechanism import NO_TOOL, ErrorModel, Kinematics, pose_error
from oed.model import Component

TURN = "turn"  #: name of the offset about the tool axis
#: a rotation lies along the tool axis where it is off it by less than this share
ALIGNMENT_TOLERANCE = 1e-6
N_POSES = 8  #: poses at which the directions of what stays are examined


@dataclasses.dataclass(frozen=True, slots=True)
class FurtherAxis:
    """A motion that no joint makes."""

    name: str  #: of the offset: that of its pose component, or `turn`
    unit: str  #: SI unit
    component: str  #: pose component that it corrects
    about: str  #: what the offset is, for tables


@dataclasses.dataclass(frozen=True)
class FurtherAxes:
    """The m motions that would correct what a machine's joints do not."""

    kinematics: Kinematics
    axes: tuple[FurtherAxis, ...]

    def __len__(self) -> int:
        return len(self.axes)

    def offsets(self, command: Array, parameters: Array) -> Array:
        """How far (n, m) a machine that joints compensate by parameters (np,) is off
        its commands, SI; an additional axis takes it back. AssemblyError.
        """
        joints = compensated_joints(self.kinematics, command, parameters)
        twist = pose_error(self.kinematics, command, joints, parameters)
        rows = self.rows(command)
        return (rows @ twist[:, :, None])[:, :, 0]

    def rows(self, command: Array) -> Array:
        """Rows (n, m, 6) that take the offsets from a twist error at commands."""
        machine = self.kinematics.machine
        names = [c.name for c in machine.components]
        rows = np.empty((len(command), len(self.axes), 6))
        jacobians = self.kinematics.error_components_jacobian(command)
        for k, axis in enumerate(self.axes):
            if axis.name == TURN:
                rows[:, k] = _tool_axis_rows(self.kinematics, command)
            else:
                rows[:, k] = jacobians[:, names.index(axis.component)]
        return rows

    def twists(self, command: Array, offsets: Array) -> Array:
        """Twist errors (n, 6) that offsets (n, m) are, at commands."""
        inverse = np.linalg.pinv(self.rows(command))
        return (inverse @ offsets[:, :, None])[:, :, 0]

    @classmethod
    def of(cls, kinematics: Kinematics) -> "FurtherAxes":
        """The motions that a machine's joints do not make; none where they make all."""
        machine = kinematics.machine
        undriven = [c for c in machine.components if not c.compensatable]
        angles = [c for c in undriven if c.unit == "rad"]
        turns = len(angles) == 1 and _turns_about_tool_axis(kinematics)
        axes = []
        for component in undriven:
            if turns and component.unit == "rad":
                about = "rotation about the tool axis, right-handed"
                axes.append(FurtherAxis(TURN, "rad", component.name, about))
            else:
                axes.append(_axis(component))
        return cls(kinematics, tuple(axes))


def _axis(component: Component) -> FurtherAxis:
    about = f"error in {component.name}"
    if component.about:
        about += f": {component.about}"
    return FurtherAxis(component.name, component.unit, component.name, about)


def _tool_axis_rows(kinematics: Kinematics, command: Array) -> Array:
    """Rows (n, 6): the rotation vector along the tool axis of the wanted pose."""
    nominal = kinematics.machine.nominal
    x, _ = kinematics.inverse(command, nominal)
    rotation, _, _ = kinematics.frames(x, NO_TOOL)
    return np.hstack([np.zeros((len(command), 3)), rotation[:, :, 2]])


def _turns_about_tool_axis(kinematics: Kinematics) -> bool:
    """Whether compensation leaves no rotation but that, by slopes about home."""
    machine = kinematics.machine
    span = np.array([c.upper - c.lower for c in machine.command])
    rng = np.random.default_rng(0)
    shifts = 0.05 * span * rng.uniform(-1.0, 1.0, (N_POSES, len(span)))
    low, high = np.array([(c.lower, c.upper) for c in machine.command]).T
    command = np.clip(machine.home_command + shifts, low, high)
    turns = ErrorModel.of(kinematics, command).remaining[:, 3:]
    axis = _tool_axis_rows(kinematics, command)[:, 3:]
    along = np.einsum("ni,nip->np", axis, turns)
    across = turns - axis[:, :, None] * along[:, None]
    return bool(np.abs(across).max() <= ALIGNMENT_TOLERANCE * np.abs(turns).max())


def compensated_joints(
    kinematics: Kinematics, command: Array, parameters: Array, tool: Array = NO_TOOL
) -> Array:
    """Joints (n, nq) that hold commands (n, n_dof) on a machine with these parameters.

    `parameters` are (np,) or (n, np), SI. Raises AssemblyError.
    """
    return kinematics.inverse(command, parameters, tool)[1]


def joint_corrections(
    kinematics: Kinematics, command: Array, parameters: Array
) -> Array:
    """What (n, nq) a controller with the nominal model adds to its joints at commands,
    for a real machine of parameters (np,), SI. Raises AssemblyError.
    """
    needed = compensated_joints(kinematics, command, parameters)
    modelled = compensated_joints(kinematics, command, kinematics.machine.nominal)
    return needed - modelled


def commands_of_added(kinematics: Kinematics, command: Array, added: Array) -> Array:
    """Commands (n, n_dof) at which the nominal model has what is `added` (n, nq) to its joints.

    Raises AssemblyError.
    """
    nominal = kinematics.machine.nominal
    start, joints = kinematics.inverse(command)
    pose = kinematics.forward(joints + added, nominal, start)
    return kinematics.command_of_pose(pose, command, NO_TOOL)
