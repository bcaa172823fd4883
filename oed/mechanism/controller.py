"""What a controller holds of its machine: parameters, and corrections of its joints."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from oed.base import Array

#: what is added (n, nq) to the joints at commands (n, n_dof) that mean poses (n, nx), SI
Corrections = Callable[[Array, Array], Array]


@dataclasses.dataclass(frozen=True, eq=False)
class Controller:
    """A controller that an earlier calibration compensated.

    parameters   (np,) of its inverse kinematics, SI
    corrections  that it adds to these joints; None where it has no such table
    """

    parameters: Array
    corrections: Corrections | None = None

    def corrected(self, command: Array, pose: Array, joints: Array) -> Array:
        """Joints (n, nq) to which it drives, from pose and joints of its parameters."""
        if self.corrections is None:
            return joints
        return np.asarray(joints + self.corrections(command, pose))
