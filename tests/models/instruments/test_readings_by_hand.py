"""What each instrument reads of a pose, whole or in part, in NumPy and by SciPy's rotations."""

import math
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import stated_order
from constraint_machines import swing1
from sample import refused, resolved
from scipy.spatial.transform import Rotation
from shipped_models import a3_head, delta

from oed.instrument import Frame, Instrument, mount
from oed.measurement import Measurement
from pkm_models.instruments import (
    ball_bar,
    ball_plate,
    calliper,
    camera,
    height_probe,
    laser_ball_bar,
    length_gauge,
    planar_position,
    pose_tracker,
    relative,
    seat,
    touch_plane,
)
from pkm_models.machines import cable_robot, cables_planar, cables_spatial, hexapod
from pkm_studies import catalogue
from pkm_studies.base import Location

RNG = np.random.default_rng(8)
TURNS = Rotation.from_euler("XYZ", RNG.uniform(-0.5, 0.5, (2, 3)))
(X, Y, Z), OTHER = POINTS = RNG.uniform(0.2, 1.0, (2, 3))
POINT, WAY = POINTS[0], POINTS[0] - POINTS[1]
#: unknowns of the set-ups, and numbers that they state; SI
S = dict(scale=0.02, offset=0.03, height=0.04, tilt=0.05, tilt_x=0.06, tilt_y=0.07)
S |= dict(tilt_u=0.08, tilt_v=0.09)
K = dict(bed_slope_x=0.11, bed_slope_y=0.12, at=0.13, normal_z=1.0)
CUP, SEAT, SHIFT, TURN, AT = RNG.uniform(-0.1, 0.1, (5, 3))
for names, values in (("cup", CUP), ("seat", SEAT), ("shift", SHIFT), ("turn", TURN)):
    S |= {f"{names}_{axis}": value for axis, value in zip("xyz", values, strict=True)}
K |= {f"at_{axis}": value for axis, value in zip("xyz", AT, strict=True)}
SPIN = Rotation.from_euler("z", TURN[2])
FRAME = Rotation.from_rotvec([TURN[0], TURN[1], 0.0]) * SPIN
SEEN = FRAME.apply(POINT) + SHIFT
ACROSS = {"y": WAY[1] - S["tilt"] * WAY[2], "z": WAY[2] - S["tilt"] * WAY[1]}
LEVEL = Z + S["offset"]
TILTED = S["tilt_y"] * X - S["tilt_x"] * Y
ABOUT = FRAME.apply(POINT - AT) + AT + SHIFT
AXIS = (FRAME * TURNS[0]).as_matrix()[:, 2]
BY_HAND = [
    (ball_bar.instrument, [np.linalg.norm(WAY - CUP)]),
    (ball_bar.free_cup, [np.linalg.norm(POINT - AT - CUP)]),
    (ball_plate.instrument, FRAME.apply(POINT - AT) + SHIFT),
    (ball_plate.distance, [np.linalg.norm(WAY) / 1.02]),
    (calliper.instrument, [1.02 * np.linalg.norm(WAY)]),
    (camera.instrument, SEEN),
    (camera.known_frame, POINT),
    (height_probe.instrument, [LEVEL]),
    (height_probe.tilted_bed, [LEVEL + TILTED]),
    (height_probe.contact, [LEVEL - 0.11 * X - 0.12 * Y]),
    (laser_ball_bar.instrument, [*ABOUT, np.arctan2(-AXIS[1], AXIS[2]), np.arcsin(AXIS[0])]),
    (laser_ball_bar.position, ABOUT),
    (length_gauge.instrument, [Z - AT[2] - S["height"] + TILTED]),
    (planar_position.instrument, (SPIN.apply(POINT) + SHIFT)[:2]),
    (pose_tracker.instrument, [*SEEN, *(FRAME * TURNS[0]).as_euler("XYZ")]),
    (pose_tracker.position, SEEN),
    (relative.rm1, [WAY[1]]),
    (relative.rm2, [WAY[2]]),
    (relative.rm3, [ACROSS["z"]]),
    (relative.rm4, [ACROSS["y"]]),
    (relative.rm5, [WAY[1], ACROSS["z"]]),
    (seat.instrument, POINT - AT - SEAT),
    (touch_plane.instrument, [Z - 0.13 - S["offset"] - S["tilt_u"] * Y + S["tilt_v"] * X]),
]  # fmt: skip


@pytest.mark.parametrize(
    ("instrument", "expected"), BY_HAND, ids=[one.name for one, _ in BY_HAND]
)
def test_a_reading_is_as_by_hand(instrument, expected):
    frames = [
        Frame(ca.DM(turn.as_matrix()), ca.DM(point))
        for turn, point in zip(TURNS, POINTS, strict=True)
    ]
    free = {p.name for p in instrument.nuisances}
    stated = {setting.name: setting.default for setting in instrument.settings}
    s = {name: value for name, value in S.items() if name in free}
    k = {name: K.get(name, default) for name, default in stated.items()}
    read = instrument.observe(frames, s, k)
    assert len(read) == len(instrument.channels)
    assert [float(value) for value in read] == pytest.approx(list(expected), abs=1e-12)


# -- what is stated, and angles --------------------------------------------------------
INSTRUMENTS = [e.name for e in catalogue.listing("instruments")]
#: what a channel reads of the rotation of a hexapod's platform
Reading = Callable[[np.ndarray], float]
SLOPES: dict[str, Reading] = {
    "read_tilt_x": lambda r: math.asin(r[2, 1]),
    "read_tilt_y": lambda r: -math.asin(r[2, 0]),
}
#: readings of angles by hand; those of an orientation are rebuilt from the stated order
ANGLES: dict[str, dict[str, Reading]] = {
    "laser_ball_bar": {},
    "pose_tracker": {},
    "passive_joint": {},
    "locked_joint": {},
    "home_orientation": SLOPES | {"read_spin": lambda r: math.atan2(r[1, 0], r[0, 0])},
    "level": SLOPES,
    "autocollimator": {
        "read_tilt_x": lambda r: math.atan2(-r[1, 2], r[2, 2]),
        "read_tilt_y": lambda r: math.atan2(r[0, 2], r[2, 2]),
    },
}
#: read the closure, not the pose: see test_constraints.py
OF_CLOSURE = ("redundancy", "redundancy_per_leg")


def of_name(name: str) -> Instrument:
    return catalogue.instrument(name, Path(), Location("catalogue"))


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_every_channel_of_an_instrument_is_stated(name):
    tool = of_name(name)
    assert all(c.about for c in tool.channels)
    if tool.orientation is not None:
        assert set(tool.orientation.names) <= {c.name for c in tool.channels}
        formula = tool.orientation.formula
        for c in tool.channels:
            assert (c.name in tool.orientation.names) == (formula in c.about)


#: noise of a channel as data sheets and papers have it, SI
NOISE = {
    "ball_bar": ("length", 0.5e-6),
    "ball_distance": ("length", 2 * 0.15e-6),  # both ends are probed
    "length_gauge": ("height", 1e-6),
    "pose_tracker": ("read_alpha", math.radians(5.0 / 3600.0)),
    "rm2": ("dz", 1e-6),  # interferometer
    "rm4": ("dy", 3e-6),  # micrometer
}
#: numbers of a set-up that states none: ISO 230-4's bar; a laser ball bar's data sheet
DEFAULTS = {
    "ball_bar": {"length": 0.3},
    "laser_ball_bar": {"baseline": 0.1, "range_noise": 0.3e-6, "angle_noise": math.radians(1.15 / 3600.0)},
    "touch_plane": {"normal_x": 0.0, "normal_y": 0.0, "normal_z": 1.0},
}  # fmt: skip


def test_noise_and_settings_are_those_of_data_sheets():
    for name, (channel, sigma) in NOISE.items():
        stated = {c.name: c.sigma for c in of_name(name).channels}
        assert stated[channel] == pytest.approx(sigma)
    for name, values in DEFAULTS.items():
        settings = {s.name: s.default for s in of_name(name).settings}
        assert {key: settings[key] for key in values} == pytest.approx(values)


def test_every_instrument_is_worked_by_hand():
    worked = {instrument.name for instrument, _ in BY_HAND}
    assert worked | set(ANGLES) | set(OF_CLOSURE) == set(INSTRUMENTS)


@pytest.mark.parametrize("name", ANGLES)
def test_angles_are_those_of_their_words(name, rng):
    """On a hexapod that stands about home."""
    tool, m = of_name(name), hexapod.machine
    at = dict(at_x=0.1, at_y=-0.7, at_z=0.05) if name == "laser_ball_bar" else {}
    measurement = Measurement(m, [mount(tool, "one", **at)])
    low, high = np.array([(c.lower, c.upper) for c in m.command]).T
    command = m.home_command + 0.3 * (rng.uniform(low, high, (2, 6)) - m.home_command)
    series = measurement.series("one", command)
    y = measurement.readings([series], measurement.nominal)[-len(tool.channels) :]
    values = dict(zip((c.name for c in tool.channels), y, strict=True))
    x = measurement.poses(series, measurement.nominal)
    rotation, point, _ = measurement.kinematics.frames(x, np.zeros(3))
    rows = series.index[-1]
    actual = rotation[rows[0]]
    for channel, reading in ANGLES[name].items():
        assert values[channel] == pytest.approx(reading(actual), abs=1e-12)
    if name.endswith("_joint"):
        turned = pytest.approx(swing1(point[rows], rotation[rows]), abs=1e-12)
        assert list(values.values()) == [turned]
    if tool.orientation is not None:
        rebuilt = stated_order.rotation(tool.orientation, values)
        columns = [2] if tool.orientation.axis_only else [0, 1, 2]
        assert np.abs(actual - np.eye(3)).max() > 0.02
        assert rebuilt[:, columns] == pytest.approx(actual[:, columns], abs=1e-12)


def test_redundancy_states_its_channels_on_every_machine():
    for m in (one.machine for one in (cables_spatial, cable_robot, cables_planar)):
        for name in OF_CLOSURE:
            channels = of_name(name).for_machine(m).channels
            assert len(channels) == len(m.joints) - len(m.command)
            assert "" not in {c.about for c in channels}


ARM = """\
schema = 1
name = "arm"

[machine]
model = "planar_2dof"

[[setup]]
name = "camera"
instrument = "camera"
channels = ["read_y", "read_z"]

[readings]
files = ["arm.csv"]
"""
ARM_ROWS = """\
setup,run,order,y_mm,z_mm,read_y_mm,read_z_mm
camera,a,1,0,100,0.1,100.2
camera,a,2,500,100,500.1,100.1
camera,a,3,0,600,0.2,600.3
"""


def test_a_camera_in_a_plane_has_two_readings_a_pose(tmp_path):
    (tmp_path / "arm.csv").write_text(ARM_ROWS, encoding="utf-8")
    study = resolved(ARM, tmp_path)
    assert study.dataset is not None
    assert len(study.dataset) == 6
    assert [c.name for c in study.setups["camera"].instrument.channels] == [
        "read_y",
        "read_z",
    ]
    assert study.setups["camera"].sigma == (1e-3, 1e-3)


@pytest.mark.parametrize(
    ("channels", "said"),
    [('["read_q"]', "camera has no channel ['read_q']"), ("[]", "must read one of")],
)
def test_channels_that_do_not_exist_are_refused(channels, said):
    assert said in str(refused(ARM, ('["read_y", "read_z"]', channels)))


def test_a_subset_of_channels_reads_and_scatters_as_the_whole_does(rng):
    whole = laser_ball_bar.instrument
    rows = [0, 2, 4]
    part = whole.take_channels([whole.channels[k].name for k in rows])
    gimbal = {"at_x": 0.0, "at_y": -1.0, "at_z": 1.0}
    setups = [mount(whole, "whole", **gimbal), mount(part, "part", **gimbal)]
    m = Measurement(a3_head.machine, setups)
    command = np.array([[1.1, 0.3, 0.2], [1.2, -2.0, 0.4]])
    both = [m.series(name, command) for name in ("whole", "part")]
    theta = m.nominal + 1e-4 * rng.standard_normal(len(m.names))
    theta[m.nuisance_slice("part")] = theta[m.nuisance_slice("whole")]
    full, taken = (m.readings([s], theta).reshape(2, -1) for s in both)
    assert taken == pytest.approx(full[:, rows], abs=1e-15)
    covariances = [m.of(s).reading_covariances(s) for s in both]
    expected = covariances[0][:, rows][:, :, rows]
    assert covariances[1] == pytest.approx(expected, rel=1e-12)


def test_a_contact_with_a_bed_of_known_slopes_by_hand():
    """The reading of a contact is implied: 0 over a plane that rises along x and y."""
    setup = mount(height_probe.contact, "probe", bed_slope_x=6e-3, bed_slope_y=-2e-3)
    m = Measurement(delta.machine, [setup])
    series = m.series("probe", np.array([[0.05, -0.02, 0.03]]))
    theta = m.nominal
    theta[m.nuisance_slice("probe")] = 1e-4
    expected = 0.03 + 1e-4 - 6e-3 * 0.05 - 2e-3 * 0.02
    assert m.readings([series], theta) == pytest.approx([expected], abs=1e-12)
    assert height_probe.contact.implied == 0.0
