"""`oed compensate --to mjcf` and `urdf`: MuJoCo closes the loops, and its platform stands
where the identified machine's stands.
"""

import csv
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import compensation_sample as sample
import numpy as np
import pytest
from oracles import mujoco_poses
from shipped_models import a3_head, five_bar, hexapod, rotary_delta

from oed.mechanism import Kinematics
from oed.model import Machine

Run = Callable[..., tuple[int, str, str]]
#: legs, cranks of a platform that only translates, and a machine in the plane
MJCF = [hexapod.machine, rotary_delta.machine]
URDF = [hexapod.machine, five_bar.machine]


@pytest.fixture(scope="module")
def mujoco() -> Any:
    return pytest.importorskip("mujoco", reason="MuJoCo is not installed")


def truth(machine: Machine, rng: np.random.Generator) -> np.ndarray:
    tolerance = np.array([p.tolerance for p in machine.parameters])
    return machine.nominal + 0.5 * tolerance * rng.standard_normal(len(tolerance))


def written(
    oed: Run, folder: Path, machine: Machine, values: np.ndarray, to: str
) -> Path:
    sample.save(folder, sample.result(machine, values))
    code, _, err = oed("compensate", folder, "--to", to)
    assert code == 0, err
    return folder


def differences(
    mujoco: Any, model: Any, loops: list[Any], machine: Machine, values: np.ndarray
) -> list[float]:
    """How far MuJoCo's platform is from that of the machine, m and entries of rotations."""
    kinematics, rng = Kinematics(machine), np.random.default_rng(5)
    low, high = np.array([(c.lower, c.upper) for c in machine.command]).T
    shape = (6, len(low))
    command = machine.home_command + 0.3 * (high - low) * rng.uniform(-1, 1, shape)
    x, q = kinematics.inverse(command, values)
    home = kinematics.inverse(machine.home_command, values)[1][0]
    rotation, point, _ = kinematics.frames(x, np.zeros(3))
    platform, found = model.body("platform").id, []
    for k, joints in enumerate(q):
        data = mujoco.MjData(model)
        for share in np.linspace(0.25, 1.0, 4):
            at = home + share * (joints - home)
            named = {j.name: v for j, v in zip(machine.joints, at, strict=True)}
            gap = mujoco_poses.close(mujoco, model, data, named, loops)
        assert gap < 1e-12
        turned = data.xmat[platform].reshape(3, 3) - rotation[k]
        found += [np.abs(data.xpos[platform] - point[k]).max(), np.abs(turned).max()]
    return found


@pytest.mark.parametrize("machine", MJCF, ids=lambda machine: machine.name)
def test_poses_of_the_mjcf_are_those_of_the_machine(
    machine, oed, tmp_path, rng, mujoco
):
    values = truth(machine, rng)
    folder = written(oed, tmp_path / "d", machine, values, "mjcf")
    model = mujoco.MjModel.from_xml_path(str(folder / "compensation.mjcf.xml"))
    loops = mujoco_poses.connections(mujoco, model)
    assert len(loops) == len(machine.joints)
    assert max(differences(mujoco, model, loops, machine, values)) < 1e-9


@pytest.mark.parametrize("machine", URDF, ids=lambda machine: machine.name)
def test_poses_of_the_urdf_with_its_loops_are_those_of_the_machine(
    machine, oed, tmp_path, rng, mujoco
):
    values = truth(machine, rng)
    folder = written(oed, tmp_path / "d", machine, values, "urdf")
    model = mujoco.MjModel.from_xml_path(str(folder / "compensation.urdf"))
    loops = []
    with (folder / "compensation_loops.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            sides = []
            for side in "ab":
                point = [float(row[f"{side}_{k}_m"]) for k in "xyz"]
                sides += [model.body(row[f"link_{side}"]).id, np.array(point)]
            loops.append(tuple(sides))
    assert max(differences(mujoco, model, loops, machine, values)) < 1e-9


def test_a_draw_put_into_the_mjcf_is_the_machine_with_the_drawn_parameters(
    oed, tmp_path, rng, mujoco
):
    machine = rotary_delta.machine
    values = truth(machine, rng)
    folder = written(oed, tmp_path / "d", machine, values, "mjcf")
    with (folder / "compensation_mjcf_draws.csv").open(encoding="utf-8") as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    names = [p.name for p in machine.parameters]
    table = np.array([[row[f"parameter.{n}"] for n in names] for row in rows])
    assert len(table) == 100
    spread = table.std(axis=0) / 1e-5  # the sample's sd: 0.01 in mm or mrad
    assert spread.mean() == pytest.approx(1.0, abs=0.1)
    root = ET.parse(folder / "compensation.mjcf.xml").getroot()
    named = {e.get("name"): e for e in root.iter() if e.get("name")}
    for column, number in rows[7].items():
        element, attribute, *place = column.split(".")
        if element == "parameter":
            continue
        words = named[element].attrib[attribute].split()
        words[int(place[0])] = repr(number)
        named[element].set(attribute, " ".join(words))
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    loops = mujoco_poses.connections(mujoco, model)
    assert max(differences(mujoco, model, loops, machine, table[7])) < 1e-9


def test_a_platform_that_hinges_hold_is_refused(oed, tmp_path):
    head = sample.result(a3_head.machine, a3_head.machine.nominal)
    folder = sample.save(tmp_path / "d", head)
    for form in ("mjcf", "urdf"):
        code, _, err = oed("compensate", folder, "--to", form)
        assert code == 2
        assert f"{form} cannot drive a3_head: its platform must be held by legs" in err
