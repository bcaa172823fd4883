"""`oed compensate --to c`, `mjcf` and `urdf`: compiled, assembled, beside an oracle."""

import csv
import ctypes
import shutil
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import compensation_sample as sample
import numpy as np
import pytest
from oracles import delta_trilateration, mujoco_poses
from shipped_models import (
    a3_head,
    cables_planar,
    five_bar,
    hexapod,
    linear_delta,
    rotary_delta,
)

from oed.mechanism import Kinematics
from oed.model import Machine

FLAGS = ("-std=c99", "-O2", "-Wall", "-Werror", "-shared", "-fPIC")


def library(source: Path, *includes: Path) -> ctypes.CDLL:
    """The compiled source; the test skips where there is no compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler: this system has no `cc`")
    target = source.with_suffix(".so")
    folders = [f"-I{folder}" for folder in includes]
    call = [compiler, *FLAGS, *folders, str(source), "-o", str(target), "-lm"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(target))


def pointer(row: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(row.ctypes.data)


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


POSES = 10_000
TOOL = np.array([0.01, -0.02, 0.03])
OK, NOT_ASSEMBLED, OTHER_MODE = 0, 1, 2
#: what LinuxCNC declares, as far as the module needs it
HEADERS = {
    "rtapi.h": "#define EXPORT_SYMBOL(name) extern int pkm_test_##name\n",
    "rtapi_app.h": "#define MODULE_LICENSE(text) extern int pkm_test_license\n",
    "hal.h": "static int hal_init(const char *n) { return n[0] != 0; }\n"
    "static int hal_ready(int id) { return id; }\n"
    "static void hal_exit(int id) { (void)id; }\n",
    "kinematics.h": "typedef struct { double x, y, z; } PmCartesian;\n"
    "typedef struct { PmCartesian tran; double a, b, c, u, v, w; } EmcPose;\n"
    "typedef enum { KINEMATICS_BOTH = 4 } KINEMATICS_TYPE;\n"
    "typedef unsigned long KINEMATICS_FORWARD_FLAGS;\n"
    "typedef unsigned long KINEMATICS_INVERSE_FLAGS;\n"
    "#define KINS_NOT_SWITCHABLE\n",
}


def commands(machine: Machine, rng: np.random.Generator) -> np.ndarray:
    low, high = np.array([[c.lower, c.upper] for c in machine.command]).T
    middle, half = 0.5 * (low + high), 0.4 * (high - low)
    return middle + half * rng.uniform(-1.0, 1.0, (POSES, len(low)))


@pytest.mark.parametrize("machine", [
    linear_delta.machine,
    pytest.param(hexapod.machine, marks=pytest.mark.slow),
    a3_head.machine,
])  # fmt: skip
def test_ten_thousand_poses_are_those_of_python(machine, oed, tmp_path, rng):
    values = truth(machine, rng)
    c = library(written(oed, tmp_path / "d", machine, values, "c") / "compensation.c")
    values = stored(tmp_path / "d" / "compensation.h")
    kinematics, command = Kinematics(machine), commands(machine, rng)
    x, q = kinematics.inverse(command, values, TOOL)
    pose, joints = np.empty_like(x), np.empty_like(q)
    for row in zip(command, pose, joints, strict=True):
        at, to, out = (pointer(part) for part in row)
        assert c.pkm_inverse(at, pointer(TOOL), to, out) == OK
    assert np.abs(pose - x).max() < 1e-12
    assert np.abs(joints - q).max() < 1e-12
    start, reached = x + 1e-3, x + 1e-3
    again = command + 1e-3
    for row in zip(q, reached, again, strict=True):
        at, to, out = (pointer(part) for part in row)
        assert c.pkm_forward(at, pointer(TOOL), to, out) == OK
    expected = kinematics.forward(q, values, start)
    assert np.abs(reached - expected).max() < 1e-12
    by_python = kinematics.command_of_pose(expected, command + 1e-3, TOOL)
    assert np.abs(again - by_python).max() < 1e-12


def stored(header: Path) -> np.ndarray:
    """Parameters that the header states; result.json rounds a unit's conversion."""
    lines = header.read_text("utf-8").splitlines()
    rows = [line.split() for line in lines if line.startswith(" * parameter ")]
    return np.array([float(row[4]) for row in rows])


def test_a_redundant_machine_settles_where_python_puts_it(oed, tmp_path, rng):
    machine = cables_planar.machine
    values = truth(machine, rng)
    c = library(written(oed, tmp_path / "d", machine, values, "c") / "compensation.c")
    values = stored(tmp_path / "d" / "compensation.h")
    kinematics, command = Kinematics(machine), commands(machine, rng)[:200]
    x, q = kinematics.inverse(command, values)
    strained = q + 1e-3 * rng.standard_normal(q.shape)
    expected = kinematics.forward(strained, values, x)
    for joints, pose, wanted in zip(strained, x, expected, strict=True):
        assert c.pkm_forward(pointer(joints), None, pointer(pose), None) == OK
        assert np.abs(pose - wanted).max() < 1e-12


def test_what_cannot_be_assembled_is_a_code_and_changes_nothing(oed, tmp_path):
    machine = linear_delta.machine
    folder = written(oed, tmp_path / "d", machine, machine.nominal, "c")
    c = library(folder / "compensation.c")
    pose, joints, command = np.empty(3), np.empty(3), np.empty(3)
    c.pkm_home(pointer(pose), pointer(joints), pointer(command))
    assert command == pytest.approx(machine.home_command)
    kept = joints.copy()
    far = np.array([5.0, 0.0, 0.0])
    assert c.pkm_inverse(pointer(far), None, None, pointer(joints)) == NOT_ASSEMBLED
    assert (joints == kept).all()
    mirrored = pose + np.array([0.0, 0.0, 1.0])
    above = mirrored.copy()
    code = c.pkm_forward(pointer(joints), None, pointer(mirrored), None)
    assert code == OTHER_MODE
    assert (mirrored == above).all()


def test_the_linuxcnc_module_holds_the_identified_delta(oed, tmp_path, rng):
    machine = linear_delta.machine
    values = truth(machine, rng)
    folder = written(oed, tmp_path / "d", machine, values, "c")
    headers = tmp_path / "headers"
    headers.mkdir()
    for name, text in HEADERS.items():
        (headers / name).write_text(text, "utf-8")
    kins = library(folder / "compensation_kins.c", headers)
    assert kins.rtapi_app_main() == 0
    world, joints, back = np.zeros(9), np.empty(3), np.zeros(9)
    for command in commands(machine, rng)[:50]:
        world[:3] = 1e3 * command
        assert kins.kinematicsInverse(pointer(world), pointer(joints), None, None) == 0
        tool = delta_trilateration.nozzle(
            1e-3 * joints[None], values[0], values[1:4], values[4:7], values[7:]
        )
        assert np.abs(tool - command).max() < 1e-9
        assert kins.kinematicsForward(pointer(joints), pointer(back), None, None) == 0
        assert back == pytest.approx(world, abs=1e-9)
    world[:3] = 9e3, 0.0, 0.0
    assert kins.kinematicsInverse(pointer(world), pointer(joints), None, None) == -1
    kins.rtapi_app_exit.restype = None
    kins.rtapi_app_exit()


def test_angles_of_a_head_are_linuxcncs_axes(oed, tmp_path):
    machine = a3_head.machine
    folder = written(oed, tmp_path / "d", machine, machine.nominal, "c")
    text = (folder / "compensation_kins.c").read_text("utf-8")
    assert "Axes: Z is z, A is psi, B is theta; mm and degrees" in text
