"""Identified parameters in the controller's model, as far as it can hold them."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Array
from oed.base.text import quantity
from oed.compensate.exact import compensated_joints
from oed.compensate.setpoint import Conditions, Setpoint, undriven_components
from oed.mechanism.kinematics import Kinematics
from oed.mechanism.pose_errors import NO_TOOL, component_errors


@dataclasses.dataclass(frozen=True)
class ParameterCompensator:
    """Replaces the parameters of the controller's model.

    identified  (np,) parameters of the machine, SI
    held        (np,) values with which the controller works: those of `identified` that
                its model has, rounded to the digits that it reads; the rest nominal
    """

    kinematics: Kinematics
    identified: Array
    held: Array
    tool: Array = dataclasses.field(default_factory=lambda: NO_TOOL)

    def apply(self, setpoint: Setpoint, conditions: Conditions) -> Setpoint:
        """The setpoint with the parameters that the controller holds."""
        return dataclasses.replace(setpoint, parameters=self.held)

    def remaining(self, command: Array) -> Array:
        """Errors (n, k) of the pose components that stay, SI. Raises AssemblyError."""
        joints = compensated_joints(self.kinematics, command, self.held, self.tool)
        return component_errors(
            self.kinematics, command, joints, self.identified, self.tool
        )

    def limits(self, command: Array) -> tuple[str, ...]:
        """What stays uncorrected over commands (n, n_dof), in sentences."""
        machine = self.kinematics.machine
        remaining = self.remaining(command)
        largest = np.abs(remaining).max(axis=0)
        driven = [
            f"{c.name} {quantity(size, c.unit)}"
            for c, size in zip(machine.components, largest, strict=True)
            if c.compensatable
        ]
        model = f"the controller's model and digits leave at most {', '.join(driven)}"
        return (model, *undriven_components(machine, remaining))
