"""Machines with cranks and glides: poses and ranks beside code written from their
descriptions, and new studies of them.
"""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from oracles import new_families

from oed.mechanism import Kinematics
from oed.model import Machine

Run = Callable[..., tuple[int, str, str]]
NAMES = tuple(new_families.CLOSURES)
WITH_LEGS = ("pentapod", "tripod_upr_spr", "tripod_wrist")


def model(name: str) -> Machine:
    return import_module(f"pkm_models.machines.{name}").machine  # type: ignore[no-any-return]


def commands(machine: Machine, rng: np.random.Generator, count: int) -> np.ndarray:
    low, high = np.array([(c.lower, c.upper) for c in machine.command]).T
    return rng.uniform(low, high, (count, len(low)))


@pytest.mark.parametrize("name", NAMES)
def test_poses_with_errors_are_those_of_the_description(name, rng):
    """All errors but those of directions, whose names each side may choose."""
    machine, errors = model(name), {}
    p = machine.nominal.copy()
    for k, parameter in enumerate(machine.parameters):
        if not parameter.name.startswith("tilt"):
            errors[parameter.name] = parameter.tolerance * rng.standard_normal()
            p[k] += errors[parameter.name]
    kinematics, command = Kinematics(machine), commands(machine, rng, 10)
    x, q = kinematics.inverse(command)
    reached = kinematics.forward(q, p, x)
    for start, joints, at in zip(x, q, reached, strict=True):
        assert new_families.pose(name, joints, {}, start) == pytest.approx(
            start, abs=1e-10
        )
        expected = new_families.pose(name, joints, errors, start)
        assert at == pytest.approx(expected, abs=1e-10)
        assert np.abs(at - start).max() > 1e-5


@pytest.mark.parametrize("name", NAMES)
def test_readings_see_what_the_description_lets_them_see(name, rng):
    """The same space of readings of the pose, hence the same rank."""
    machine = model(name)
    stems = [p.name for p in machine.parameters if not p.name.startswith("tilt")]
    tilted = {p.name[4] for p in machine.parameters if p.name.startswith("tilt")}
    turns = [f"turn{i}{k}" for i in sorted(tilted) for k in "xyz"]
    kinematics = Kinematics(machine)
    # half as many readings again as parameters
    count = -(-3 * len(machine.parameters) // (2 * len(machine.command)))
    x, q = kinematics.inverse(commands(machine, rng, count))
    ours = kinematics.slopes.pose_by_parameter(x, q, machine.nominal)
    theirs = [
        new_families.slopes(name, joints, pose, stems + turns)
        for pose, joints in zip(x, q, strict=True)
    ]
    ours, oracle = ours.reshape(-1, ours.shape[2]), np.vstack(theirs)
    ranks = [
        np.linalg.matrix_rank(scaled(h), tol=1e-6)
        for h in (ours, oracle, np.hstack([scaled(ours), scaled(oracle)]))
    ]
    assert ranks == [len(machine.parameters)] * 3


def scaled(h: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(h, axis=0)
    return h / np.where(size > 1e-9, size, np.inf) / np.sqrt(h.shape[1])


@pytest.mark.parametrize("name", [n for n in NAMES if n not in WITH_LEGS])
def test_joints_turn_in_the_sense_of_their_words(name):
    machine = model(name)
    x, q = Kinematics(machine).inverse(machine.home_command)
    ahead = Kinematics(machine).struts(x, q + 1e-6, machine.nominal)[0][0]
    behind = Kinematics(machine).struts(x, q - 1e-6, machine.nominal)[0][0]
    motion = (ahead - behind) / 2e-6
    if name != "orthoglide":
        crank = [
            machine.nominal[machine.index(f"r{i + 1}")] for i in range(len(motion))
        ]
        assert np.linalg.norm(motion, axis=1) == pytest.approx(crank, abs=1e-6)
        assert "right-handed about its axis" in machine.joints[0].about
    if name == "orthoglide":
        assert motion == pytest.approx(np.eye(3), abs=1e-6)
    elif name == "five_bar":
        knee = 0.5 * (ahead + behind) - [[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0]]
        assert motion == pytest.approx(np.cross([0.0, 0.0, 1.0], knee), abs=1e-6)
    elif name == "rotary_delta":
        assert (motion[:, 2] < 0.0).all()
    else:
        assert (motion[:, 2] > 0.0).all()


def study(name: str, oed: Run, folder: Path) -> Path:
    instrument = "planar_position" if name == "five_bar" else "pose_tracker_position"
    chosen = ("--machine", name, "--instrument", instrument)
    file = folder / f"{name}.study.toml"
    assert oed("new", name, *chosen)[0] == 0
    assert oed("check", file)[0] == 0
    return file


@pytest.mark.usefixtures("own_folder")
@pytest.mark.parametrize("name", NAMES)
def test_a_new_study_passes_its_check(name, oed, tmp_path):
    assert study(name, oed, tmp_path).is_file()


@pytest.mark.parametrize("end", ["base", "platform"])
def test_legs_whose_revolute_axes_disagree_are_refused(end):
    family = model("tripod_upr_spr").family
    table = {d.name: np.array(d.default) for d in family.dimensions if d.name == end}
    table[end][1, 1] += 0.01
    with pytest.raises(ValueError, match=f"{end} joints 1 and 2 must"):
        family.build(table)
