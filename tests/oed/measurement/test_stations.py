"""Set-ups on one station, and instruments on a platform that is turned by hand."""

import dataclasses

import casadi as ca
import numpy as np
import pytest
import sample
from shipped_models import (
    a3_head,
    hexapod,
    length_gauge,
    linear_delta,
    orientation,
    planar_2dof,
    pose_tracker,
)

from oed import Measurement, mount

position = pose_tracker.position
machine = hexapod.machine

NESTS = {"one": (0.05, 0.0, 0.0), "two": (-0.03, 0.04, 0.0), "three": (0.0, -0.05, 0.0)}
COMMAND = np.array(
    [[0.0, 0.0, 0.5, 0.0, 0.0, 0.0], [0.02, -0.01, 0.52, 0.05, -0.08, 0.03]]
)
STUDY = """\
schema = 1
name = "nests"

[machine]
model = "hexapod"
drive = "gear"

[[setup]]
name = "one"
instrument = "pose_tracker_position"
tool_mm = [50.0, 0.0, 0.0]
station = "tracker"

[[setup]]
name = "two"
instrument = "pose_tracker_position"
tool_mm = [-30.0, 40.0, 0.0]
station = "tracker"

[[prior.tolerance]]
parameters = ["tracker.shift_*"]
sigma_mm = 5.0
"""


def measurement(station: str) -> Measurement:
    setups = [
        dataclasses.replace(mount(position, name, tool=tool), station=station)
        for name, tool in NESTS.items()
    ]
    return Measurement(machine, setups)


def test_three_nests_of_one_tracker_have_six_unknowns():
    """Their slopes are the sums of those over three trackers' frames."""
    apart, shared = measurement(""), measurement("tracker")
    count = len(machine.parameters)
    assert len(apart.names) == count + 18
    assert shared.names[count:] == tuple(
        f"tracker.{kind}_{axis}" for kind in ("shift", "turn") for axis in "xyz"
    )
    series = [shared.series(name, COMMAND) for name in NESTS]
    slopes = shared.jacobian(series, shared.nominal)
    three = apart.jacobian(series, apart.nominal)
    np.testing.assert_allclose(slopes[:, :count], three[:, :count], atol=1e-12)
    summed = three[:, count:].reshape(-1, 3, 6).sum(axis=1)
    np.testing.assert_allclose(slopes[:, count:], summed, atol=1e-12)
    # a shifted tracker moves the readings of all nests by as much
    theta = shared.nominal
    theta[shared.names.index("tracker.shift_y")] = 2e-3
    moved = shared.readings(series, theta) - shared.readings(series, shared.nominal)
    expected = np.tile([0.0, 2e-3, 0.0], 6)
    np.testing.assert_allclose(np.abs(moved), expected, atol=1e-12)


def test_a_study_states_a_station(tmp_path):
    resolved = sample.resolved(STUDY, tmp_path)
    everything = resolved.measurement_with(resolved.setups)
    tracker = [p for p in everything.parameters if p.name.startswith("tracker.")]
    shared = {p.name: p.tolerance for p in tracker}
    assert len(shared) == 6
    assert shared["tracker.shift_x"] == pytest.approx(5e-3)
    assert not [name for name in everything.names if name.startswith(("one.", "two."))]


@pytest.mark.parametrize(("old", "new"), [
    ("-30.0, 40.0, 0.0]\n", "-30.0, 40.0, 0.0]\ntolerance = { shift_x_mm = 1.0 }\n",),
    ('"pose_tracker_position"\ntool_mm = [-', '"length_gauge"\ntool_mm = [-'),
    ('0]\nstation = "tracker"\n\n[[prior', '0]\nstation = "one"\n\n[[prior'),
])  # fmt: skip
def test_a_station_of_unlike_setups_is_refused(old, new, tmp_path):
    error = sample.refused(STUDY, (old, new), folder=tmp_path)
    assert "setup[2].station" in str(error)
    assert "one instrument and the same tolerances" in str(error)


def test_the_workspace_holds_for_the_reference_tool(tmp_path):
    """A nest 300 mm beside the axis rises where the platform tilts; the pose is inside."""
    high = 550.0 + 300.0 * np.sin(np.radians(14.0))
    x, z = f"x_mm = [{300.0 * np.cos(np.radians(14.0)):.6f}]", f"z_mm = [{high:.6f}]"
    turn = "y_mm = [0.0]\nrx_deg = [0.0]\nry_deg = [-14.0]\nspin_deg = [0.0]"
    grid = f'\n[[design.reference]]\nname = "tilted"\nsetup = "one"\n{x}\n{z}\n{turn}\n'
    far = STUDY.replace("[50.0, 0.0, 0.0]", "[300.0, 0.0, 0.0]")
    (plan,) = sample.resolved(far + grid, tmp_path).reference_plans
    kinematics = Measurement(machine, []).kinematics
    home = kinematics.reference_tool_commands(
        plan.series[0].command, np.array([0.3, 0, 0])
    )
    np.testing.assert_allclose(home[0, :3], [0.0, 0.0, 0.55], atol=1e-6)
    beyond = grid.replace(f"z_mm = [{high:.6f}]", f"z_mm = [{high + 300.0:.6f}]")
    error = sample.refused(far + beyond, folder=tmp_path)
    assert "z_mm" in str(error)


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
