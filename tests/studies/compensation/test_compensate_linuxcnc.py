"""`oed compensate --to linuxcnc` for deltas: the modules' formulas, written here from
LinuxCNC's documentation, drive the identified machine.
"""

import re
from collections.abc import Callable
from pathlib import Path

import compensation_sample as sample
import numpy as np
import pytest
from oracles import delta_trilateration, new_families
from scipy.spatial.transform import Rotation
from shipped_models import delta, linear_delta, pentapod, rotary_delta

from oed.model import Machine
from pkm_studies.compensation.formats import linuxcnc

Run = Callable[..., tuple[int, str, str]]


def exported(
    oed: Run, folder: Path, machine: Machine, values: np.ndarray
) -> tuple[dict[str, float], np.ndarray, float, str]:
    """Pins, joints at zero (3,), offset of z, and what the command prints."""
    sample.save(folder, sample.result(machine, values))
    code, out, err = oed("compensate", folder, "--to", "linuxcnc")
    assert code == 0, err
    hal = (folder / "compensation.hal").read_text("utf-8")
    ini = (folder / "compensation.ini").read_text("utf-8")
    pins = {k: float(v) for k, v in re.findall(r"setp (\S+) (\S+)", hal)}
    at_zero = np.array(re.findall(r"JOINT_AT_ZERO = (\S+)", ini), dtype=float)
    return pins, at_zero, float(re.findall(r"Z_OFFSET = (\S+)", hal)[0]), out


def largest_cost(out: str) -> float:
    """What the command states that the module cannot hold, um."""
    sentence = out[out.index("digits cost at most") :].split(" over ")[0]
    costs = re.findall(r"([\d.e+-]+) (um|mm)", sentence)
    assert len(costs) == 3
    return max(float(v) * {"um": 1.0, "mm": 1e3}[unit] for v, unit in costs)


def carriage_heights(pins: dict[str, float], points: np.ndarray) -> np.ndarray:
    """lineardeltakins: joint 0 at (0, R), then 210 and 330 degrees; mm."""
    r, rod = pins["lineardeltakins.R"], pins["lineardeltakins.L"]
    sine, cosine = 3**0.5 / 2, 0.5
    towers = np.array([[0, r], [-sine * r, -cosine * r], [sine * r, -cosine * r]])
    across = [np.linalg.norm(points[:, :2] - tower, axis=1) for tower in towers]
    return np.stack([points[:, 2] + (rod**2 - d**2) ** 0.5 for d in across], axis=1)


@pytest.mark.parametrize("machine", [linear_delta.machine, delta.machine])
def test_lineardeltakins_drives_the_identified_delta(machine, oed, tmp_path, rng):
    values, names = machine.nominal.copy(), [p.name for p in machine.parameters]
    for name, change in (("radius", 4e-4), ("arm", -6e-4)):
        values[[n.startswith(name) for n in names]] += change
    values[names.index("endstop1")] += 8e-4
    pins, at_zero, _, out = exported(oed, tmp_path / "d", machine, values)
    assert largest_cost(out) < 0.01
    points = np.column_stack([rng.uniform(-60, 60, (30, 2)), rng.uniform(5, 150, 30)])
    # joints 0, 1 and 2 are towers 3, 1 and 2
    travel = 1e-3 * (at_zero - carriage_heights(pins, points))[:, [1, 2, 0]]
    stems = [
        [v for v, n in zip(values, names, strict=True) if n.startswith(stem)]
        for stem in ("radius", "arm", "angle", "endstop")
    ]
    tool = delta_trilateration.nozzle(travel, stems[0][0], *map(np.array, stems[1:]))
    assert np.abs(1e3 * tool - points).max() < 1e-5


def knee_down(pins: dict[str, float], point: np.ndarray) -> np.ndarray:
    """rotarydeltakins: joint 0 swings in the plane of y and z, at -y; degrees."""
    radius = pins["rotarydeltakins.platformradius"]
    foot = pins["rotarydeltakins.footradius"]
    thigh = pins["rotarydeltakins.thighlength"]
    shin = pins["rotarydeltakins.shinlength"]
    angles = []
    for turn in (0.0, 2 * np.pi / 3, -2 * np.pi / 3):
        c, s = np.cos(turn), np.sin(turn)
        x, y, z = c * point[0] - s * point[1], s * point[0] + c * point[1], point[2]
        a = 0.5 * (x**2 + (y - foot) ** 2 + z**2 + thigh**2 - shin**2 - radius**2) / z
        b = (foot - radius - y) / z
        root = (thigh**2 * (b**2 + 1) - (a - b * radius) ** 2) ** 0.5
        knee = (radius + a * b + root) / (b**2 + 1)
        angles.append(np.degrees(np.arctan2(b * knee - a, knee - radius)))
    return np.array(angles)


def test_rotarydeltakins_drives_the_identified_delta(oed, tmp_path, rng):
    machine = rotary_delta.machine
    values, errors = machine.nominal.copy(), {}
    for name, change in {"zero1": 1e-3, "zero2": -2e-3, "zero3": 5e-4}.items():
        errors[name] = change
    errors |= {f"r{i}": 3e-4 for i in (1, 2, 3)} | {f"l{i}": -7e-4 for i in (1, 2, 3)}
    errors |= {f"b{i}z": 5e-4 for i in (1, 2, 3)}
    for name, change in errors.items():
        values[machine.index(name)] += change
    pins, at_zero, z, out = exported(oed, tmp_path / "d", machine, values)
    assert largest_cost(out) < 0.01
    for point in rng.uniform([-150, -150, -900], [150, 150, -600], (20, 3)):
        joints = np.radians(knee_down(pins, point - [0.0, 0.0, z]) - at_zero)
        tool = new_families.pose("rotary_delta", joints, errors, 1e-3 * point)
        assert np.abs(1e3 * tool - point).max() < 1e-4


def strut(pins: dict[str, float], k: int, world: np.ndarray) -> float:
    """pentakins: the length of strut k for x, y, z (mm), A and B (roll, pitch; rad)."""
    base = np.array([pins[f"pentakins.base.{k}.{a}"] for a in "xyz"])
    r, z = (pins[f"pentakins.effector.{k}.{a}"] for a in "rz")
    turn = Rotation.from_euler("xyz", [world[3], world[4], 0.0])
    at = turn.inv().apply(base - world[:3])
    return float(np.hypot(at[2] - z, np.hypot(at[0], at[1]) - r))


def test_pentakins_drives_the_identified_pentapod(oed, tmp_path, rng):
    machine = pentapod.machine
    names = [p.name for p in machine.parameters]
    sd = np.array([p.tolerance for p in machine.parameters])
    errors = dict(zip(names, sd * rng.standard_normal(len(sd)), strict=True))
    values = machine.nominal + np.array(list(errors.values()))
    folder = sample.save(tmp_path / "d", sample.result(machine, values))
    code, out, err = oed("compensate", folder, "--to", "linuxcnc")
    assert code == 0, err
    assert "digits cost at most" in out
    hal = (folder / "compensation.hal").read_text("utf-8")
    ini = (folder / "compensation.ini").read_text("utf-8")
    pins = {k: float(v) for k, v in re.findall(r"setp (\S+) (\S+)", hal)}
    zero = np.array(re.findall(r"STRUT_ZERO = (\S+)", ini), dtype=float)
    for _ in range(10):
        world = rng.uniform(-1, 1, 5) * [80, 80, 80, 0.2, 0.2]
        lengths = np.array([strut(pins, k, world) for k in range(5)])
        axis = Rotation.from_euler("xyz", [world[3], world[4], 0.0]).as_matrix()[:, 2]
        tilt = np.cross([0, 0, 1], axis) * np.arccos(axis[2]) / np.hypot(*axis[:2])
        start = np.r_[1e-3 * world[:3], tilt[:2]]
        pose = new_families.pose("pentapod", 1e-3 * (lengths - zero), errors, start)
        assert np.abs(pose - start).max() < 1e-7


def test_what_the_module_cannot_hold_is_stated(oed, tmp_path):
    values = rotary_delta.machine.nominal.copy()
    values[rotary_delta.machine.index("l1")] += 2e-3
    *_, out = exported(oed, tmp_path / "d", rotary_delta.machine, values)
    assert 100.0 < largest_cost(out) < 2000.0


def test_limbs_elsewhere_are_refused(oed, tmp_path):
    turned = delta.family.build({"angle": np.radians([0.0, 120.0, 240.0])})
    content = sample.result(turned, turned.nominal)
    text = content.study_text.replace(
        "[[setup]]", "[machine.geometry]\nangle_deg = [0, 120, 240]\n[[setup]]"
    )
    folder = sample.save(tmp_path / "d", sample.with_text(content, text))
    code, _, err = oed("compensate", folder, "--to", "linuxcnc")
    assert code == 2
    assert "the first of them at 90 or 270 degrees" in err


def test_the_frame_of_tripodkins_is_right_handed(rng):
    """Its base points are (0, 0), (Bx, 0) and (Cx, Cy), with Bx and Cy positive."""
    base, platform = rng.normal(size=(2, 3, 3))
    origin, axes = linuxcnc.tripod_frame(linuxcnc.Struts(base, platform, np.zeros(3)))
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    a, b, c = (base - platform - origin) @ axes.T
    assert [*a, *b[1:], c[2]] == pytest.approx([0.0] * 6, abs=1e-12)
    assert min(b[0], c[1]) > 0.0
