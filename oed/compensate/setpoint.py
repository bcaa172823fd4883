"""What a compensator changes: command, controller's parameters and joint offsets."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Protocol

import numpy as np

from oed.base.arrays import Array
from oed.base.text import quantity
from oed.mechanism.kinematics import Kinematics
from oed.model.machine import Machine

#: state of the machine at n commands, SI: name -> (n,), or (n, nq) joint by joint
Conditions = Mapping[str, Array]


@dataclasses.dataclass(frozen=True)
class Setpoint:
    """What a controller is given for n commands, SI.

    command       (n, n_dof) that its inverse kinematics converts
    parameters    (np,) or (n, np) of its model
    joint_offset  (n, nq) added to the joints that its model computes
    """

    command: Array
    parameters: Array
    joint_offset: Array

    def joints(self, kinematics: Kinematics, tool: Array | None = None) -> Array:
        """Joints (n, nq) that the controller drives to. Raises AssemblyError."""
        modelled = kinematics.inverse(self.command, self.parameters, tool)[1]
        return np.asarray(modelled + self.joint_offset)


def uncompensated(machine: Machine, command: Array) -> Setpoint:
    """The setpoint of a controller with the nominal model."""
    offset = np.zeros((len(command), len(machine.joints)))
    return Setpoint(command, machine.nominal, offset)


class Compensator(Protocol):
    """One method of compensation; each stands in a file of this package."""

    def apply(self, setpoint: Setpoint, conditions: Conditions) -> Setpoint:
        """The setpoint, corrected. Raises ValueError where a condition is missing."""
        ...

    def limits(self, command: Array) -> tuple[str, ...]:
        """What stays uncorrected over commands (n, n_dof), in sentences."""
        ...


def undriven_components(machine: Machine, remaining: Array) -> tuple[str, ...]:
    """A sentence on components without a drive, from their errors (n, k), SI.

    None for a machine that drives all its components.
    """
    largest = np.abs(remaining).max(axis=0)
    parts = [
        f"{component.name} {quantity(size, component.unit)}"
        for component, size in zip(machine.components, largest, strict=True)
        if not component.compensatable
    ]
    if not parts:
        return ()
    return (f"no joint drives these components, at most: {', '.join(parts)}",)
