"""The length gauge against the plane of a tilted table."""

import numpy as np
import pytest
from shipped_models import a3_head, length_gauge

from oed.instrument import mount
from oed.measurement import Measurement

POSES = np.array(
    [[1.13, 0.3, 0.1], [1.2, 2.0, 0.4], [1.17, -1.0, 0.2], [1.15, 4.0, 0.3]]
)


def gauge() -> Measurement:
    return Measurement(
        a3_head.machine, [mount(length_gauge.instrument, "gauge", at_z=1.166)]
    )


def test_it_reads_the_height_over_a_plane_through_three_points():
    """The plane by three of its points, to first order in the tilts."""
    m = gauge()
    series = m.series("gauge", POSES)
    height, tilt_x, tilt_y = 2e-3, 1e-5, -3e-5
    theta = m.nominal.copy()
    theta[-3:] = height, tilt_x, tilt_y
    _, point, _ = m.kinematics.frames(m.poses(series, m.nominal), np.zeros(3))
    turn = np.array([[1.0, 0.0, tilt_y], [0.0, 1.0, -tilt_x], [-tilt_y, tilt_x, 1.0]])
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    corners = corners @ turn.T + [0.0, 0.0, 1.166 + height]
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    over = (point - corners[0]) @ normal / normal[2]  # along z
    assert m.readings([series], theta) == pytest.approx(over, abs=1e-9)
