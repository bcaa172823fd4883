"""Corrections that depend on the machine's state: temperature, payload, direction, feed."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from oed.base.arrays import Array
from oed.compensate.setpoint import Conditions, Setpoint
from oed.compensate.table import InterpolationTable
from oed.mechanism.kinematics import Kinematics

#: what the values of a table are added to
Target = Literal["command", "parameters", "joints"]


@dataclasses.dataclass(frozen=True)
class StateCompensator:
    """A table over states, and over commands where the correction varies with the place.

    kinematics  of the machine
    table       axes are states (`temp_leg1`, `payload`, `direction`, `feed`) or command
                coordinates; values are added to the `target`, SI
    target      command (n_dof), parameters (np) or joints (nq)
    joint_wise  whether a state is given joint by joint, (n, nq), as the direction of
                travel of each joint: value k is then read at the state of joint k
    """

    kinematics: Kinematics
    table: InterpolationTable
    target: Target
    joint_wise: bool = False

    def apply(self, setpoint: Setpoint, conditions: Conditions) -> Setpoint:
        """The setpoint with the correction of these states.

        Raises ValueError where a state of the table is not given.
        """
        change = self._correction(setpoint.command, conditions)
        if self.target == "command":
            command = setpoint.command + change
            return dataclasses.replace(setpoint, command=command)
        if self.target == "parameters":
            parameters = setpoint.parameters + change
            return dataclasses.replace(setpoint, parameters=parameters)
        offset = setpoint.joint_offset + change
        return dataclasses.replace(setpoint, joint_offset=offset)

    def limits(self, command: Array) -> tuple[str, ...]:
        """What the correction rests on, in sentences."""
        sentences = []
        for name, places in zip(self.table.axes, self.table.knots, strict=True):
            if name not in self._coordinates():
                sentences.append(
                    f"the correction rests on {name} being read; beyond"
                    f" {places[0]:.4g} to {places[-1]:.4g} (SI) it keeps its end value"
                )
        return tuple(sentences)

    def _coordinates(self) -> list[str]:
        return [c.name for c in self.kinematics.machine.command]

    def _correction(self, command: Array, conditions: Conditions) -> Array:
        """Correction (n, m) at commands in their states."""
        joints = len(self.kinematics.machine.joints)
        if not self.joint_wise:
            return self.table.at(self._places(command, conditions, None))
        columns = [
            self.table.at(self._places(command, conditions, k))[:, k]
            for k in range(joints)
        ]
        return np.column_stack(columns)

    def _places(
        self, command: Array, conditions: Conditions, joint: int | None
    ) -> Array:
        coordinates = self._coordinates()
        columns = []
        for name in self.table.axes:
            if name in coordinates:
                columns.append(command[:, coordinates.index(name)])
                continue
            if name not in conditions:
                raise ValueError(f"the correction needs the state {name}: give it")
            state = np.asarray(conditions[name], dtype=float)
            column = state[:, joint] if state.ndim == 2 else state
            columns.append(np.broadcast_to(column, len(command)))
        return np.column_stack(columns)
