"""Hangprinters of three to five anchors: motors and places in, the firmware's numbers out."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from oracles.firmware.hangprinter import Hangprinter, hangprinter

import oed
from pkm_studies.base import InputError
from pkm_studies.importers import import_files
from printers.delta_printer import PLAIN, compensate

ANCHORS = {
    3: "N3 A0:-2000:2400 B1800:1000:2400 C-1800:1000:2400 P900",
    4: "N4 A0:-1620:-150 B1272.8:1272.8:-150 C-1403:810:-150 D0:0:2350 P900",
    5: "N5 A0:-1600:-120 B1600:0:-120 C0:1600:-120 D-1600:0:-120 I0:0:2400 P900",
}
SPOOLS = {
    3: "R75:75:75 U2:2:2 O1:1:1 H255:255:255 L20:20:20",
    4: "R75:75:75:75 U2:2:2:4 O2:2:2:2 H255:255:255:255 L20:20:20:20 W1.5 T20",
    5: "R65:65:65:65:65 U2:2:2:2:4 O1:1:1:1:1 H100:100:100:100:100 L20:20:20:20:20",
}
SHIFT, CAMERA, LINE = np.array([4.0, -6.0, 3.0]), 0.2, 0.05
SETTINGS = """\
estimate = false
read_x_mm = 0.2
read_y_mm = 0.2
read_z_mm = 0.2
{gaps}
[readings]
"""


def config(count: int, more: str = "") -> str:
    return f"M669 K6 {ANCHORS[count]}\nM666 Q0.05 {SPOOLS[count]}{more}\n"


def real_printer(believed: Hangprinter) -> Hangprinter:
    """A printer off by what a tape measures."""
    rng = np.random.default_rng(7)
    return dataclasses.replace(
        believed,
        anchors=believed.anchors + rng.uniform(-15.0, 15.0, believed.anchors.shape),
        spools=believed.spools + rng.uniform(-0.5, 0.5, len(believed.spools)),
        buildup=1.2 * believed.buildup,
    )


def places(seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(
        [-400, -400, 0], [400, 400, 1200], (count, 3)
    )


def taken(text: str, folder: Path, motors: np.ndarray, forces=None) -> Path:
    """The study of motor angles (n, m), deg, and of places that a camera sees."""
    rng, seen = np.random.default_rng(8), places(1, 30)
    seen = seen + SHIFT + CAMERA * rng.normal(size=seen.shape)
    letters = list("ABCDI"[: motors.shape[1]])
    header = letters if forces is None else [*letters, *(f"F{k}" for k in letters)]
    cells = motors if forces is None else np.hstack([motors, forces])
    for name, head, rows in (
        ("motors.csv", header, cells),
        ("places.csv", list("xyz"), seen),
    ):
        table = [",".join(head), *(",".join(map(repr, row)) for row in rows.tolist())]
        (folder / name).write_text("\n".join(table))
    (folder / "config.g").write_text(text)
    paths = [folder / name for name in ("config.g", "motors.csv", "places.csv")]
    study, _ = import_files("hangprinter", paths, folder / "study", name="p")
    spare = motors.shape[1] - 3
    gaps = {0: [], 1: ["gap_mm"], 2: ["gap1_mm", "gap2_mm"]}[spare]
    head, _, rest = study.read_text().partition("assumed = true")
    known = SETTINGS.format(gaps="\n".join(f"{gap} = {LINE}" for gap in gaps))
    end = rest.partition("[readings]")[2] + PLAIN + '[identify]\neffects = "none"\n'
    study.write_text(head + known + end)
    return study


@pytest.mark.parametrize("count", ANCHORS)
def test_the_firmware_gets_numbers_that_put_it_right(count, tmp_path):
    text = config(count)
    believed = hangprinter(text)
    real, check = real_printer(believed), places(2, 12)
    rng = np.random.default_rng(9)
    turns = np.array([real.motors(place) for place in places(1, 30)])
    turns += np.degrees(LINE / 75.0 * 2.0 * 12.75) * rng.normal(size=turns.shape)
    before = [real.place(believed.motors(place)) - place for place in check]
    export = compensate(taken(text, tmp_path, turns), "rrf")
    firmware = hangprinter(export)
    assert firmware.buildup == pytest.approx(real.buildup, rel=0.1)
    after = np.array([real.place(firmware.motors(place)) - place for place in check])
    assert np.sqrt((np.array(before) ** 2).mean()) > 2.0
    assert np.sqrt((after**2).mean()) < 3.0 * CAMERA
    assert "P900" in export
    assert "+4." in export.split("the origin is")[1]


def test_forces_take_the_flex_out(tmp_path):
    """Columns FA to FD with S of M666: places agree as without any force."""
    text = config(4, " S40000")
    believed = hangprinter(text)
    forces = np.random.default_rng(3).uniform(10.0, 60.0, (30, 4))
    pairs = zip(places(1, 30), forces, strict=True)
    turns = np.array([believed.motors(place, force) for place, force in pairs])
    study = taken(text, tmp_path, turns, forces)
    # the model has one compliance a line: Y over U d is that of the origin
    stiffness = oed.load_study(study).machine.geometry["stiffness_N"]
    wires = np.linalg.norm(believed.anchors - believed.anchors[3], axis=1)
    share = wires / (believed.folds * np.linalg.norm(believed.anchors, axis=1))
    assert stiffness == pytest.approx(40000.0 / (1.0 + share))
    section = oed.identify(oed.read_readings(oed.load_study(study))).section
    assert section.rms_before["read_x"] < 9000.0
    assert section.rms_after["read_x"] < 2e3 * CAMERA
    bare = tmp_path / "bare"
    bare.mkdir()
    without = oed.identify(oed.read_readings(oed.load_study(taken(text, bare, turns))))
    assert without.section.rms_after["gap"] > 3.0 * section.rms_after["gap"]


def test_three_lines_need_places(tmp_path):
    (tmp_path / "config.g").write_text(config(3))
    (tmp_path / "m.csv").write_text("A,B,C\n9000,0,0\n0,9000,0\n")
    paths = [tmp_path / "config.g", tmp_path / "m.csv"]
    with pytest.raises(InputError, match="three lines alone say nothing"):
        import_files("hangprinter", paths, tmp_path / "out", name="h")
