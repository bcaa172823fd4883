"""Whether the angles of a Hangprinter's motors are degrees: against places, and in size."""

from __future__ import annotations

import numpy as np

from oed.base.arrays import Array
from oed.mechanism.kinematics import Kinematics
from oed.model.machine import Machine
from pkm_studies.base.errors import InputError

#: share of the nearest anchor's distance within which all poses say nothing of a machine
NEAR = 0.02
#: factor between recorded and expected angles from which on they are no such angles
FACTOR = 1.5


def check_unit(machine: Machine, motors: Array, places: Array, file: str) -> None:
    """Raises InputError where the motors do not turn as the places and lines want.

    motors  (n, 4) angles, deg
    places  (k, 3) of the mover at the first of these poses, mm; may be none
    """
    kinematics = Kinematics(machine)
    if len(places):
        expected = np.degrees(kinematics.inverse(places / 1e3)[1])
        _check_factor(motors[: len(places)], expected, file)
        return
    anchors = [p.nominal for p in machine.parameters if p.name.startswith("anchor")]
    distances = np.linalg.norm(np.reshape(anchors, (-1, 3)), axis=1)
    around = NEAR * distances.min() * np.vstack([np.eye(3), -np.eye(3)])
    least = np.abs(np.degrees(kinematics.inverse(around)[1])).max()
    if np.abs(motors).max() < least:
        raise _refusal(
            f"no motor turns by more than {np.abs(motors).max():.3g} deg, which moves the"
            f" lines by less than {1e3 * NEAR * distances.min():.3g} mm",
            file,
        )


def _check_factor(motors: Array, expected: Array, file: str) -> None:
    """Raises InputError where angles (k, 4) are a multiple of the expected ones, deg."""
    square = float(np.sum(expected**2))
    if square == 0.0:
        return
    factor = float(np.sum(motors * expected)) / square
    if 1.0 / FACTOR < factor < FACTOR:
        return
    raise _refusal(
        f"the motors turn by {factor:.3g} times what the places and M669, M666 give",
        file,
    )


def _refusal(problem: str, file: str) -> InputError:
    return InputError(
        problem,
        "give degrees since the origin, positive where a line is paid out; radians times"
        " 57.2958",
        file=file,
        field="A, B, C, D",
    )
