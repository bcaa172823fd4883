"""Printers with errors, from the simulated firmware's log to its calibrated bed.

A firmware of the oracle probes a printer whose geometry it does not know. What it logs
is imported and fitted, the export is read back by the same firmware, and then bed and
distances of the printer are within twice the noise of the readings.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from oracles.delta_firmware import (
    Delta,
    Klipper,
    Marlin,
    RepRapFirmware,
    Travel,
    delta,
    touch,
)

from pkm_studies.cli import main

NOISE = 0.02  # mm
REACH = 90.0
#: the printer as it is; the arms are those that its firmware has
ARMS = (250.4, 250.1, 249.9)
PLAIN = "\n[posterior]\nenabled = false\n[report]\nhtml = false\npdf = false\n"


def printer(arms: Sequence[float] | float = 250.0) -> Delta:
    return delta(125.63, arms, [210.31, 329.74, 90.0], [300.42, 299.71, 300.13])


def rings(count: int = 108) -> np.ndarray:
    """The middle and three rings of places (n, 2)."""
    places = [(0.0, 0.0)]
    for radius in (REACH / 3.0, REACH / 1.5, REACH):
        for angle in np.arange(count) * 2.0 * np.pi / count + radius:
            places.append((radius * np.cos(angle), radius * np.sin(angle)))
    return np.round(places, 2)


def calibrate(
    tmp_path: Path, kind: str, files: dict[str, str], *options: str
) -> tuple[str, str]:
    """The study of an import, and the text that `oed compensate` writes for it."""
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    paths = [str(tmp_path / name) for name in files]
    folder = tmp_path / "study"
    assert main(["import", kind, *paths, "--out", str(folder), "--name", "p"]) == 0
    study = folder / "p.study.toml"
    text = study.read_text()
    study.write_text(text + PLAIN)
    result = str(tmp_path / "result")
    assert main(["run", str(study), "--out", result, "--quiet"]) == 0
    out = tmp_path / "export"
    assert main(["compensate", result, "--to", kind, "--out", str(out), *options]) == 0
    return text, out.read_text()


def check_bed_and_distances(
    travel: Travel, real: Delta, lean: Sequence[float] = (0, 0)
) -> None:
    """Commands at z = 0 touch the bed, and are as far from each other as commanded.

    lean  (2,) rise of the bed along x and y
    """
    places = rings(7)
    wanted = np.column_stack([places, np.zeros(len(places))])
    reached = np.array([real.tool(travel(point)) for point in wanted])
    height = reached[:, 2] - reached[:, :2] @ np.asarray(lean)
    assert np.abs(height).max() < 2.0 * NOISE
    pairs = np.triu_indices(len(places), 1)
    distances = [
        np.linalg.norm(p[pairs[0], :2] - p[pairs[1], :2], axis=1)
        for p in (reached, wanted)
    ]
    # heights alone give the longest of these to 0.9 times the noise of 325 readings
    assert np.sqrt(np.mean((distances[0] - distances[1]) ** 2)) < 2.0 * NOISE


# -- Klipper ---------------------------------------------------------------------------

CONFIG = """\
[printer]
kinematics: delta
max_velocity: 300
delta_radius: 125.0
[stepper_a]
microsteps: 16
rotation_distance: 40
position_endstop: 300.0
arm_length: 250.0
angle: 210
[stepper_b]
microsteps: 16
rotation_distance: 40
position_endstop: 300.0
arm_length: 250.0
angle: 330
[stepper_c]
microsteps: 16
rotation_distance: 40
position_endstop: 300.0
arm_length: 250.0
angle: 90
[probe]
z_offset: 1.5
x_offset: 20
[delta_calibrate]
radius: 90
"""


def test_klipper(tmp_path: Path, rng: np.random.Generator) -> None:
    """Heights and distances of an object, at positions in steps; arms are fitted too."""
    firmware, real = Klipper.of(CONFIG), printer(ARMS)
    step, lines = firmware.step(), []

    def saved(name: str, point: tuple[float, float, float]) -> str:
        steps = ",".join(f"{v / step:.3f}" for v in firmware.travel(point))
        return f"#*# {name} = {steps}"

    lifted = Delta(real.radius, real.arm, real.angle, real.endstop - 1.5)
    for k, (x, y) in enumerate(rings(8)):
        z = touch(firmware.travel, lifted, x, y) + NOISE * rng.normal()
        lines += [f"#*# height{k} = 1.5", saved(f"height{k}_pos", (x, y, z))]
    for k, angle in enumerate(np.radians(np.arange(0, 360, 15))):
        end = (REACH * np.cos(angle), REACH * np.sin(angle), 0.0)
        start = (-end[0], -end[1], 0.0) if k % 2 else (0.0, 0.0, 0.0)
        ends = [real.tool(firmware.travel(point)) for point in (start, end)]
        length = np.linalg.norm(ends[1] - ends[0]) + NOISE * rng.normal()
        lines += [
            f"#*# distance{k} = {length:.3f}",
            saved(f"distance{k}_pos1", start),
            saved(f"distance{k}_pos2", end),
        ]
    text = CONFIG + "\n#*# [delta_calibrate]\n" + "\n".join(lines) + "\n"
    _, export = calibrate(tmp_path, "klipper", {"printer.cfg": text})
    firmware.update(export)
    check_bed_and_distances(firmware.travel, real)


# -- RepRapFirmware --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("tilt", "offset"),
    [("", ""), (" A0.60 B-0.35", ""), ("", "X23 Y-11"), (" A0.60 B-0.35", "X23 Y-11")],
    ids=["plain", "tilt", "offset", "both"],
)
@pytest.mark.parametrize("rods", ["250.000", "250.400:250.100:249.900"])
def test_reprapfirmware(
    rods: str, tilt: str, offset: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    """With bed tilt, and with the probe beside the nozzle."""
    firmware = RepRapFirmware()
    config = (
        f"M665 L{rods} R125.00 H300.00 B110 X0 Y0 Z0\nM666 X0.3 Y-0.2 Z-0.1{tilt}\n"
    )
    if offset:
        config += f"M558 P5 F120\nG31 P500 {offset} Z1.2\n"
    firmware.execute(config)
    real = printer([float(v) for v in rods.split(":")] if ":" in rods else 250.0)
    places = rings()
    bed = "".join(
        f"G30 P{k} X{x:.2f} Y{y:.2f} Z-99999\n" for k, (x, y) in enumerate(places)
    )
    files = {"config.g": config, "bed.g": bed}
    files["log.txt"] = firmware.probe_all(real, places, NOISE, rng, firmware.tilt)
    _, export = calibrate(tmp_path, "rrf", files)
    # what config.g says after its M665 and M666 are replaced, from the factory's numbers
    printed = RepRapFirmware()
    printed.execute(export)
    check_bed_and_distances(printed.travel, real, firmware.tilt)
    assert printed.bed == 110.0
    assert printed.tilt == pytest.approx(firmware.tilt)


# -- Marlin ----------------------------------------------------------------------------


@pytest.mark.parametrize("version", ["1.1.8", "2.0.5", "2.0.6", "2.1.2"])
def test_marlin(version: str, tmp_path: Path, rng: np.random.Generator) -> None:
    """With the probe beside the nozzle where M851 has X and Y; rods by tower from 2.0.6."""
    firmware = Marlin(version)
    firmware.execute("M665 L250 R125 H299.5 X0 Y0 Z0\nM666 X-0.3 Y0 Z-0.15\n")
    firmware.execute("M665 B70" if firmware.b == "radius" else "M665 A0.4 B0.1 C-0.1")
    if not version.startswith("1."):
        firmware.probe = {"X": -18.0, "Y": 25.0}
    real = printer(ARMS if firmware.b == "trim" else 250.0)
    log = firmware.settings() + firmware.probe_all(real, rings(), NOISE, rng)
    study, export = calibrate(tmp_path, "marlin", {"printer.log": log})
    assert f'version = "{version}"' in study
    calibrated = firmware.b == "radius"
    assert ("for Marlin 1.1.1 to 2.0.5" in export) == calibrated
    assert ("for Marlin 2.0.6 or later" in export) != calibrated
    firmware.execute(export)
    assert firmware.stored
    if calibrated:
        assert firmware.m["B"] == 70.0  # the radius of calibration stays
    check_bed_and_distances(firmware.travel, real)
