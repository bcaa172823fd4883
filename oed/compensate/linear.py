"""The linear compensator, Eqs. (22)-(25) of Tian et al. (2016), and its cut-off error.

A command asks for as many quantities as the machine has degrees of freedom (its
compensatable pose components). With X = dx/dq, A = dx/dp and C = d commanded/dx at the
nominal pose, Eqs. (22)-(25) of Tian et al. (2016) read

    dq_m = -(C X)^-1 C A dp,            remaining = (A - X (C X)^-1 C A) dp,

and C remaining = 0. `oed.compensate.exact` does the same through the closure.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Array
from oed.base.text import quantity
from oed.compensate.setpoint import Conditions, Setpoint, undriven_components
from oed.mechanism.error_model import error_model
from oed.mechanism.kinematics import Kinematics
from oed.mechanism.pose_errors import NO_TOOL, component_errors


@dataclasses.dataclass(frozen=True)
class LinearCompensator:
    """Adds dq_m = J(command) dp to the joints of an unchanged controller, Eq. (24).

    deviation  (np,) identified parameters less those of the controller's model, SI
    """

    kinematics: Kinematics
    deviation: Array
    tool: Array = dataclasses.field(default_factory=lambda: NO_TOOL)

    def apply(self, setpoint: Setpoint, conditions: Conditions) -> Setpoint:
        """The setpoint with further joint offsets. Raises AssemblyError."""
        model = error_model(self.kinematics, setpoint.command, self.tool)
        offset = setpoint.joint_offset + model.joints @ self.deviation
        return dataclasses.replace(setpoint, joint_offset=offset)

    def cut_off(self, command: Array) -> Array:
        """Errors (n, k) of the pose components that linearisation leaves, SI.

        They are the exact errors of a machine with the identified parameters, sent to
        the joints of Eq. (24), less the linear prediction of Eq. (25). Raises
        AssemblyError.
        """
        machine = self.kinematics.machine
        model = error_model(self.kinematics, command, self.tool)
        _, nominal = self.kinematics.inverse(command, machine.nominal, self.tool)
        joints = nominal + model.joints @ self.deviation
        truth = machine.nominal + self.deviation
        exact = component_errors(self.kinematics, command, joints, truth, self.tool)
        return exact - self.remaining(command)

    def remaining(self, command: Array) -> Array:
        """Linear errors (n, k) of components that no joint removes, SI, Eq. (25)."""
        model = error_model(self.kinematics, command, self.tool)
        slope = self.kinematics.error_components_jacobian(command)
        return np.asarray(slope @ (model.remaining @ self.deviation)[:, :, None])[
            :, :, 0
        ]

    def limits(self, command: Array) -> tuple[str, ...]:
        """What stays uncorrected over commands (n, n_dof), in sentences."""
        machine = self.kinematics.machine
        largest = np.abs(self.cut_off(command)).max(axis=0)
        driven = [
            f"{c.name} {quantity(size, c.unit)}"
            for c, size in zip(machine.components, largest, strict=True)
            if c.compensatable
        ]
        cut_off = f"linearisation leaves at most {', '.join(driven)} (cut-off error)"
        return (cut_off, *undriven_components(machine, self.remaining(command)))
