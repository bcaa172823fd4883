"""A fit that mirrors the machine is counted."""

from __future__ import annotations

import numpy as np
from shipped_models import camera, delta

from oed.instrument import mount
from oed.measurement import Measurement


def test_a_machine_through_its_singular_pose_is_counted():
    """A delta whose tool would be above the carriages: the mirrored solution."""
    m = Measurement(delta.machine, [mount(camera.known_frame, "camera")])
    series = m.series("camera", np.array([[0.0, 0.0, 0.1], [0.02, 0.01, 0.2]]))
    assert m.mode_jumps([series], m.nominal) == (0, 2)
    carriages = delta.machine.nominal[9] + np.sqrt(0.345**2 - 0.16175**2) - series.q
    above = series.start.copy()
    above[:, 2] = 2.0 * carriages.mean(axis=1) - above[:, 2]
    mirrored = m.kinematics.forward(series.q, m.nominal, above)
    side = m.kinematics.assembly_side(mirrored, series.q, m.nominal)
    assert (
        side * m.kinematics.assembly_side(series.start, series.q, m.nominal)
    ).tolist() == [-1.0, -1.0]
