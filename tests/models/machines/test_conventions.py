"""Every coordinate and channel states its frame, order, sense and unit, and keeps to it.

Numbers come from rotations that SciPy makes of the stated order, and from tool points;
the machine's own rotation is what they are compared with.
"""

import json
import math
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import stated_order
from constraint_machines import swing1
from scipy.spatial.transform import Rotation

from oed import units
from oed.instrument import Instrument, mount
from oed.measurement import Measurement
from oed.mechanism import Kinematics
from oed.model import Machine
from pkm_models.machines import (
    a3_head,
    hexapod,
    planar_2dof,
    prs_spindle,
)
from pkm_studies import catalogue
from pkm_studies.base import Location
from pkm_studies.commands import main

PLACE = Location("catalogue")
MACHINES = [e.name for e in catalogue.listing("machines")]
INSTRUMENTS = [e.name for e in catalogue.listing("instruments")]


def machine(name: str) -> Machine:
    return catalogue.machine(name, Path(), PLACE)


def instrument(name: str) -> Instrument:
    return catalogue.instrument(name, Path(), PLACE)


def random_poses(m: Machine, rng: np.random.Generator, n: int) -> np.ndarray:
    """Commands (n, n_dof) about home that the machine reaches."""
    low, high = np.array([(c.lower, c.upper) for c in m.command]).T
    return m.home_command + 0.3 * (
        rng.uniform(low, high, (n, len(low))) - m.home_command
    )


# -- what is stated --------------------------------------------------------------------


@pytest.mark.parametrize("name", MACHINES)
def test_every_coordinate_of_a_machine_is_stated(name: str) -> None:
    m = machine(name)
    for c in (*m.pose, *m.joints, *m.command, *m.components):
        assert c.about, f"{name}: {c.name}"
    assert m.base_frame
    turns = [c.name for c in m.pose if c.unit == "rad"]
    assert bool(turns) == (m.orientation is not None) == bool(m.tool_axis)
    if m.orientation is not None:
        assert set(m.orientation.names) == set(turns)
    angles = {c.name for c in m.command if c.unit == "rad"}
    named = set() if m.command_orientation is None else set(m.command_orientation.names)
    assert angles == named


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_every_channel_of_an_instrument_is_stated(name: str) -> None:
    tool = instrument(name)
    assert all(c.about for c in tool.channels)
    if tool.orientation is not None:
        assert set(tool.orientation.names) <= {c.name for c in tool.channels}
        formula = tool.orientation.formula
        for c in tool.channels:
            assert (c.name in tool.orientation.names) == (formula in c.about)


def test_the_command_lists_the_statements(capsys: pytest.CaptureFixture[str]) -> None:
    for kind, names in (("machines", MACHINES), ("instruments", INSTRUMENTS)):
        assert main(["list", kind, "--json"]) == 0
        entries = {e["name"]: e for e in json.loads(capsys.readouterr().out)}
        assert list(entries) == names
        for entry in entries.values():
            assert main(["list", kind, entry["name"]]) == 0
            printed = capsys.readouterr().out
            assert f"source: {entry['source']}" in printed
            assert entry["columns"]
            for c in entry["columns"]:
                assert c["about"]
                shown = f"{c['name']}: {c['role']}: {c['about']}" in printed
                assert shown == (c["role"] != "parameter")
                assert c["name"].rpartition("_")[2] in units.UNITS
    assert main(["list", "machines"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == len(MACHINES)


# -- machines keep to it ---------------------------------------------------------------


@pytest.mark.parametrize("name", [n for n in MACHINES if machine(n).orientation])
def test_the_pose_s_angles_make_the_platform_s_rotation(
    name: str, rng: np.random.Generator
) -> None:
    m = machine(name)
    assert m.orientation is not None
    for _ in range(5):
        pose = {c.name: float(rng.uniform(-0.5, 0.5)) for c in m.pose}
        rotation, point = m.platform(pose)
        assert np.array(ca.DM(rotation)) == pytest.approx(
            stated_order.rotation(m.orientation, pose), abs=1e-12
        )
        for axis, name_of in enumerate("xyz"):
            assert float(ca.DM(point)[axis]) == pose.get(name_of, 0.0)


@pytest.mark.parametrize(
    "name", [n for n in MACHINES if machine(n).command_orientation]
)
def test_the_command_s_angles_are_where_the_tool_stands(
    name: str, rng: np.random.Generator
) -> None:
    m = machine(name)
    stated = m.command_orientation
    assert stated is not None
    kinematics = Kinematics(m)
    command = random_poses(m, rng, 6)
    x, _ = kinematics.inverse(command)
    rotation, point, _ = kinematics.frames(x, np.zeros(3))
    for k, values in enumerate(command):
        angles = {c.name: float(v) for c, v in zip(m.command, values, strict=True)}
        expected = stated_order.rotation(stated, angles)
        columns = [2] if stated.axis_only else [0, 1, 2]
        assert rotation[k][:, columns] == pytest.approx(expected[:, columns], abs=1e-10)
        for axis, name_of in enumerate("xyz"):
            if name_of in angles:
                assert point[k, axis] == pytest.approx(angles[name_of], abs=1e-12)


def test_errors_have_the_sense_actual_less_wanted() -> None:
    """Each component moved by itself, with the angles of its own statement."""
    step = 1e-7
    kinematics = Kinematics(a3_head.machine)
    command = np.array([[1.15, 0.7, 0.4]])
    for k, column in enumerate(("psi", "theta", "phi")):
        angles = {"psi": 0.7, "theta": 0.4, "phi": -0.7}
        wanted = stated_order.rotation(a3_head.EULER, angles)
        angles[column] += step
        turned = stated_order.rotation(a3_head.EULER, angles) @ wanted.T
        twist = np.r_[np.zeros(3), Rotation.from_matrix(turned).as_rotvec()][None]
        found = kinematics.error_components(command, twist)[0, 3:]
        assert found == pytest.approx(step * np.eye(3)[k], abs=1e-12)
    kinematics = Kinematics(prs_spindle.machine)
    command = np.array([[0.2, 0.3, -0.2]])
    for k, column in enumerate(("alpha", "beta", "gamma")):
        angles = {"alpha": 0.3, "beta": -0.2, "gamma": 0.01}
        wanted = stated_order.rotation(prs_spindle.ANGLES, angles)
        angles[column] += step
        turned = stated_order.rotation(prs_spindle.ANGLES, angles) @ wanted.T
        twist = np.r_[np.zeros(3), Rotation.from_matrix(turned).as_rotvec()][None]
        found = kinematics.error_components(command, twist)[0, 3:]
        assert found == pytest.approx(step * np.eye(3)[k], abs=1e-12)


#: (machine, sign): a joint that grows by its words does so to the distance of its strut
LENGTHS = {
    "a3_head": 1.0,
    "hexapod": 1.0,
    "hexapod_ups": 1.0,
    "pentapod": 1.0,
    "micro_cmm": 1.0,
    "tripod_rps": 1.0,
    "tripod_passive_leg": 1.0,
    "tripod_upr_spr": 1.0,
    "cables_planar": 1.0,
    "cables_spatial": 1.0,
    "cable_robot": 1.0,
}
#: carriages: the strut's end at the base moves along this axis of the base frame; 0 for
#: the guide's own direction
CARRIAGES = {
    "linear_delta": (2, -1.0),
    "delta": (2, -1.0),
    "delta_printer": (2, -1.0),
    "planar_2dof": (2, 1.0),
    "prs_spindle": (2, 1.0),
    "prs_spindle_struts": (2, 1.0),
    "hexaglide": (0, 1.0),
    "hexapod_pus": None,
    "tripod_prs": None,
    "orthoglide": None,
}
#: new_families; of the printer, test_rotary_printers
CRANKS = (
    *("five_bar", "hexapod_rus", "rotary_delta", "tripod_wrist"),
    "rotary_delta_printer",
)


@pytest.mark.parametrize("name", [n for n in MACHINES if n not in CRANKS])
def test_joints_have_the_sense_of_their_words(name: str) -> None:
    """Every machine is in a table: a new one has to state its sense."""
    m = machine(name)
    kinematics = Kinematics(m)
    command = random_poses(m, np.random.default_rng(3), 1)
    x, q = kinematics.inverse(command)
    h = 1e-6
    for k, joint in enumerate(m.joints):
        ends = []
        for sign in (h, -h):
            moved = q.copy()
            moved[:, k] += sign
            pose = x
            if name in LENGTHS and len(m.joints) == len(m.command):
                pose = kinematics.forward(moved, m.nominal, x)
            ends.append(kinematics.struts(pose, moved, m.nominal)[:2])
        if name in LENGTHS:
            if len(m.joints) > len(m.command):
                continue  # settled by all its cables: see below
            lengths = [np.linalg.norm(t[0, k] - b[0, k]) for b, t in ends]
            assert (lengths[0] - lengths[1]) / (2 * h) == pytest.approx(1.0, abs=1e-6)
            assert "length" in joint.about
            continue
        direction = (ends[0][0][0, k] - ends[1][0][0, k]) / (2 * h)
        axis = CARRIAGES[name]
        if axis is None:
            assert np.linalg.norm(direction) == pytest.approx(1.0, abs=1e-6)
            assert "along the direction of its guide" in joint.about
        else:
            assert direction[axis[0]] == pytest.approx(axis[1], abs=1e-6)


@pytest.mark.parametrize("name", ["cables_planar", "cables_spatial", "cable_robot"])
def test_cables_pay_out_as_they_grow(name: str) -> None:
    """Away from an anchor its joint grows."""
    m = machine(name)
    kinematics = Kinematics(m)
    x, q = kinematics.inverse(m.home_command[None])
    anchor, end, _ = kinematics.struts(x, q, m.nominal)
    for k, joint in enumerate(m.joints):
        away = end[0, k] - anchor[0, k]
        command = m.home_command.copy()
        for c, name_of in enumerate(c.name for c in m.command):
            if name_of in "xyz":
                command[c] += 1e-3 * away["xyz".index(name_of)]
        _, moved = kinematics.inverse(command[None])
        assert moved[0, k] > q[0, k]
        assert "paid out" in joint.about or "paying out" in joint.about


# -- instruments keep to it ------------------------------------------------------------

#: what a channel reads of the tool points (2, 3) and rotations (2, 3, 3) of a pose and
#: of its reference, with the set-up's settings
Reading = Callable[[np.ndarray, np.ndarray, dict[str, float]], float]


def coordinate(axis: int) -> Reading:
    return lambda p, r, k: p[0, axis]


def difference(axis: int) -> Reading:
    return lambda p, r, k: p[0, axis] - p[1, axis]


def distance(p: np.ndarray, r: np.ndarray, k: dict[str, float]) -> float:
    return float(np.linalg.norm(p[0] - p[1]))


def to_cup(p: np.ndarray, r: np.ndarray, k: dict[str, float]) -> float:
    return float(np.linalg.norm(p[0] - [k["at_x"], k["at_y"], k["at_z"]]))


def from_plate(axis: int) -> Reading:
    return lambda p, r, k: p[0, axis] - k[f"at_{'xyz'[axis]}"]


def tilt_of_edge(p: np.ndarray, r: np.ndarray, k: dict[str, float]) -> float:
    return math.asin(r[0][2, 1])


POINT = {f"read_{n}": coordinate(i) for i, n in enumerate("xyz")}
SLOPES: dict[str, Reading] = {
    "read_tilt_x": tilt_of_edge,
    "read_tilt_y": lambda p, r, k: -math.asin(r[0][2, 0]),
}
#: readings by hand; those of an orientation are rebuilt from the stated order
READINGS: dict[str, dict[str, Reading]] = {
    "ball_bar": {"length": distance},
    "ball_bar_free_cup": {"length": to_cup},
    "ball_distance": {"length": distance},
    "ball_plate": {f"ball_{n}": from_plate(i) for i, n in enumerate("xyz")},
    "calliper": {"length": distance},
    "camera": POINT,
    "camera_known_frame": POINT,
    "contact_probe": {
        "height": lambda p, r, k: (
            p[0, 2] - k["bed_slope_x"] * p[0, 0] - k["bed_slope_y"] * p[0, 1]
        )
    },
    "height_probe": {"height": coordinate(2)},
    "height_probe_tilted_bed": {"height": coordinate(2)},
    "length_gauge": {"height": lambda p, r, k: p[0, 2] - k["at_z"]},
    "laser_ball_bar": POINT,
    "laser_ball_bar_position": POINT,
    "planar_position": {n: POINT[n] for n in ("read_x", "read_y")},
    "pose_tracker": POINT,
    "pose_tracker_position": POINT,
    "passive_joint": {"swing1": lambda p, r, k: swing1(p, r)},
    "locked_joint": {"off_swing1": lambda p, r, k: swing1(p, r)},
    "seat": {f"miss_{n}": from_plate(i) for i, n in enumerate("xyz")},
    "touch_plane": {"off": lambda p, r, k: p[0, 2] - k["at"]},
    "rm1": {"dy": difference(1)},
    "rm2": {"dz": difference(2)},
    "rm3": {"dz": difference(2)},
    "rm4": {"dy": difference(1)},
    "rm5": {"dy": difference(1), "dz": difference(2)},
    "home_orientation": SLOPES
    | {"read_spin": lambda p, r, k: math.atan2(r[0][1, 0], r[0][0, 0])},
    "level": SLOPES,
    "autocollimator": {
        "read_tilt_x": lambda p, r, k: math.atan2(-r[0][1, 2], r[0][2, 2]),
        "read_tilt_y": lambda p, r, k: math.atan2(r[0][0, 2], r[0][2, 2]),
    },
}
#: read the closure, not the pose: see tests/models/instruments/test_redundancy.py
OF_CLOSURE = ("redundancy", "redundancy_per_leg")
SETTINGS = {
    "at_x": 0.1,
    "at_y": -0.7,
    "at_z": 0.05,
    "at": 0.3,
    "bed_slope_x": 0.02,
    "bed_slope_y": -0.03,
}


@pytest.mark.parametrize("name", [n for n in INSTRUMENTS if n not in OF_CLOSURE])
def test_channels_read_what_they_state(name: str, rng: np.random.Generator) -> None:
    """On a hexapod, or on the plane machine where the line of a run is one of its own."""
    tool = instrument(name)
    m = planar_2dof.machine if name.startswith("rm") else hexapod.machine
    settings = {
        s.name: SETTINGS.get(s.name, s.default)
        for s in tool.settings
        if s.name in SETTINGS or s.default is not None
    }
    teach = tuple(m.home_command) if tool.reference == "teach" else None
    setup = mount(tool, "one", teach=teach, **settings)
    measurement = Measurement(m, [setup])
    command = random_poses(m, rng, 2)
    series = measurement.series("one", command)
    y = measurement.readings([series], measurement.nominal)
    values = dict(
        zip((c.name for c in tool.channels), y[-len(tool.channels) :], strict=True)
    )
    x = measurement.poses(series, measurement.nominal)
    rotation, point, _ = measurement.kinematics.frames(x, np.zeros(3))
    rows = series.index[-1]
    by_hand = READINGS[name]
    for channel, reading in by_hand.items():
        expected = reading(point[rows], rotation[rows], dict(settings))
        assert values[channel] == pytest.approx(expected, abs=1e-12), channel
    angles = () if tool.orientation is None else tool.orientation.names
    assert set(by_hand) | set(angles) == {c.name for c in tool.channels}
    if tool.orientation is not None:
        rebuilt = stated_order.rotation(tool.orientation, values)
        columns = [2] if tool.orientation.axis_only else [0, 1, 2]
        actual = rotation[rows[0]]
        assert np.abs(actual - np.eye(3)).max() > 0.02
        assert rebuilt[:, columns] == pytest.approx(actual[:, columns], abs=1e-12)


def test_the_laser_ball_bar_s_direction_runs_from_b_to_a() -> None:
    """B is one baseline from A against the tool axis, as the channels say."""
    tool = instrument("laser_ball_bar")
    m = prs_spindle.machine
    at = {name: value for name, value in SETTINGS.items() if name.startswith("at_")}
    setup = mount(tool, "bar", **at)
    measurement = Measurement(m, [setup])
    series = measurement.series("bar", np.array([[0.2, 0.3, -0.25]]))
    y = measurement.readings([series], measurement.nominal)
    a, alpha, beta = y[:3], y[3], y[4]
    n = [
        math.sin(beta),
        -math.sin(alpha) * math.cos(beta),
        math.cos(alpha) * math.cos(beta),
    ]
    x = measurement.poses(series, measurement.nominal)
    _, b, _ = measurement.kinematics.frames(x, np.array([0.0, 0.0, -0.1]))
    assert (a - b[0]) / 0.1 == pytest.approx(n, abs=1e-12)
    assert (alpha, beta) == pytest.approx((0.3, -0.25), abs=1e-12)


def test_redundancy_states_its_channels_on_every_machine() -> None:
    for m in map(machine, ("cables_spatial", "cable_robot", "cables_planar")):
        for name in OF_CLOSURE:
            channels = instrument(name).for_machine(m).channels
            assert len(channels) == len(m.joints) - len(m.command)
            assert "" not in {c.about for c in channels}
