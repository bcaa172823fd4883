"""Every coordinate and channel states its frame, order, sense and unit, and keeps to it.

Numbers come from rotations that SciPy makes of the stated order, and from tool points;
the machine's own rotation is what they are compared with.
"""

import json
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import stated_order
from scipy.spatial.transform import Rotation

from oed import units
from oed.mechanism import Kinematics
from oed.model import Machine
from pkm_models.machines import a3_head, prs_spindle
from pkm_models.machines.parts import legs
from pkm_studies import catalogue
from pkm_studies.base import Location
from pkm_studies.commands import main

PLACE = Location("catalogue")
MACHINES = [e.name for e in catalogue.listing("machines")]
INSTRUMENTS = [e.name for e in catalogue.listing("instruments")]


def machine(name: str) -> Machine:
    return catalogue.machine(name, Path(), PLACE)


def random_poses(m: Machine, rng: np.random.Generator, n: int) -> np.ndarray:
    """Commands (n, n_dof) about home that the machine reaches."""
    low, high = np.array([(c.lower, c.upper) for c in m.command]).T
    return m.home_command + 0.3 * (
        rng.uniform(low, high, (n, len(low))) - m.home_command
    )


# -- what is stated --------------------------------------------------------------------
@pytest.mark.parametrize("name", MACHINES)
def test_every_coordinate_of_a_machine_is_stated(name):
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


def test_the_command_lists_the_statements(capsys):
    for kind, names in (("machines", MACHINES), ("instruments", INSTRUMENTS)):
        assert main(["list", kind, "--json"]) == 0
        entries = {e["name"]: e for e in json.loads(capsys.readouterr().out)}
        assert list(entries) == names
        for entry in entries.values():
            assert entry["columns"]
            for c in entry["columns"]:
                assert c["about"]
                assert c["name"].rpartition("_")[2] in units.UNITS
        for entry in list(entries.values())[::5]:
            assert main(["list", kind, entry["name"]]) == 0
            printed = capsys.readouterr().out
            assert f"source: {entry['source']}" in printed
            for c in entry["columns"]:
                shown = f"{c['name']}: {c['role']}: {c['about']}" in printed
                assert shown == (c["role"] != "parameter")
    assert main(["list", "machines"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == len(MACHINES)


# -- machines keep to it ---------------------------------------------------------------
@pytest.mark.parametrize("name", [n for n in MACHINES if machine(n).orientation])
def test_the_pose_s_angles_make_the_platform_s_rotation(name, rng):
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
def test_the_command_s_angles_are_where_the_tool_stands(name, rng):
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


def test_errors_have_the_sense_actual_less_wanted():
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
    "a3_head": 1.0, "hexapod": 1.0, "hexapod_ups": 1.0, "pentapod": 1.0,
    "micro_cmm": 1.0, "tripod_rps": 1.0, "tripod_passive_leg": 1.0,
    "tripod_upr_spr": 1.0, "cables_planar": 1.0, "cables_spatial": 1.0,
    "cable_robot": 1.0,
}  # fmt: skip
#: carriages: the strut's end at the base moves along this axis of the base frame; 0 for
#: the guide's own direction
CARRIAGES = {
    "linear_delta": (2, -1.0), "delta": (2, -1.0), "delta_printer": (2, -1.0),
    "planar_2dof": (2, 1.0), "prs_spindle": (2, 1.0), "prs_spindle_struts": (2, 1.0),
    "hexaglide": (0, 1.0), "hexapod_pus": None, "tripod_prs": None, "orthoglide": None,
}  # fmt: skip
#: new_families; of the printer, test_rotary_printers
CRANKS = (
    *("five_bar", "hexapod_rus", "rotary_delta", "tripod_wrist"),
    "rotary_delta_printer",
)


@pytest.mark.parametrize("name", [n for n in MACHINES if n not in CRANKS])
def test_joints_have_the_sense_of_their_words(name):
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
def test_cables_pay_out_as_they_grow(name):
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


def test_tilts_lean_a_guide_towards_its_sides():
    """By hand: small tilts a and b of a guide along z, with sides x and y."""
    tilts = {"tilt1a": 0.03, "tilt1b": -0.04}
    along, sides = np.eye(3)[2], np.eye(3)[:2]
    direction = np.array(legs.direction(tilts, 1, along, sides)).ravel()
    expected = np.array([0.03, -0.04, 1.0])
    assert direction == pytest.approx(expected / np.linalg.norm(expected))
