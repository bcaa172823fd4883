"""Level, dial and length gauges and autocollimator on a platform that is turned by hand."""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from shipped_models import (
    a3_head,
    hexapod,
    length_gauge,
    linear_delta,
    orientation,
    planar_2dof,
)

from oed.instrument import mount
from oed.measurement import Measurement

INSTRUMENTS = (orientation.instrument, orientation.level, orientation.autocollimator)
#: rx, ry, spin of a hexapod's command, rad
ANGLES = [(2e-3, 0.0, 0.0), (0.0, -3e-3, 0.0), (0.0, 0.0, 5e-3), (0.02, -0.03, 0.05)]


def read(kind: object, angles: tuple[float, float, float]) -> np.ndarray:
    m = Measurement(hexapod.machine, [mount(kind, "one")])
    command = [*hexapod.machine.home_command[:3], *angles]
    return m.readings([m.series("one", np.array([command]))], m.nominal)


@pytest.mark.parametrize("kind", INSTRUMENTS, ids=lambda k: k.name)
@pytest.mark.parametrize("axis", range(3))
def test_a_turn_about_one_axis_is_read_with_its_sign(kind, axis):
    """By hand: 2 mrad about x lifts v; -3 mrad about y lifts u; 5 mrad turns u to y."""
    expected = np.array(ANGLES[axis])[: len(kind.channels)]
    assert read(kind, ANGLES[axis]) == pytest.approx(expected, abs=1e-15)


def test_rows_can_be_taken_one_by_one():
    alone = orientation.instrument.take_channels(["read_spin"])
    assert read(alone, ANGLES[2]) == pytest.approx([5e-3], abs=1e-15)


def test_zeros_are_held_unless_freed():
    m = Measurement(a3_head.machine, [mount(orientation.level, "level")])
    assert not m.freed(["level.*"]).any()
    freed = mount(orientation.level, "level", tolerances={"zero_x": 1e-5})
    m = Measurement(a3_head.machine, [freed])
    assert m.freed(["level.*"]).sum() == 1
    series = m.series("level", a3_head.machine.home_command[None])
    theta = m.nominal.copy()
    theta[m.names.index("level.zero_x")] = 4e-5
    assert m.readings([series], theta) == pytest.approx([4e-5, 0.0], abs=1e-12)


def _about_z(pose: dict) -> tuple[ca.SX, ca.SX]:
    c, s = ca.cos(pose["y"]), ca.sin(pose["y"])
    rows = [ca.horzcat(c, -s, 0.0), ca.horzcat(s, c, 0.0), ca.horzcat(0.0, 0.0, 1.0)]
    return ca.vertcat(*rows), ca.vertcat(0.0, pose["y"], pose["z"])


SPINNING = dataclasses.replace(planar_2dof.machine, platform=_about_z)


@pytest.mark.parametrize(
    "machine", [linear_delta.machine, planar_2dof.machine, SPINNING]
)
def test_a_platform_that_does_not_tilt_has_nothing_for_a_level(machine):
    with pytest.raises(ValueError, match="its platform keeps the orientation"):
        Measurement(machine, [mount(orientation.level, "level")])


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
