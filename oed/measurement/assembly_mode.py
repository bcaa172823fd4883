"""Whether a fit has carried a machine into another assembly mode."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array
from oed.measurement.measurement import Measurement
from oed.model.series import Series


def mode_jumps(
    measurement: Measurement, series: Sequence[Series], theta: Array
) -> tuple[int, int]:
    """Number of poses whose det(phi_x) has another sign at theta (n,), and of all.

    Against the nominal poses. 0 where the machine is redundant, which has no such sign.
    """
    kinematics, nominal = measurement.kinematics, measurement.machine.nominal
    p = theta[: len(nominal)]
    jumps = count = 0
    for s in series:
        start = s.start if s.start.ndim == 2 else s.start[0]
        before = kinematics.assembly_side(start, s.q, nominal)
        after = kinematics.assembly_side(measurement.poses(s, theta), s.q, p)
        jumps += int(np.count_nonzero(before * after < 0.0))
        count += len(start)
    return jumps, count
