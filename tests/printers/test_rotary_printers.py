"""Rotary deltas and five-bars of Klipper and RepRapFirmware: wrong numbers in, right ones out."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from oracles.firmware import rrf
from oracles.firmware.five_bar import FiveBar, five_bar
from oracles.firmware.geometry import disc, spiral
from oracles.firmware.rotary import KlipperRotary, Rotary, RrfRotary

from pkm_studies.base import InputError
from printers.delta_printer import compensate, nominal, said, take, with_known_noise

NOISE, REACH, TRIGGER = 0.01, 80.0, 2.5
PLACES = spiral(24, REACH)
GEARS = "gear_ratio: 107:16, 60:16\nmicrosteps: 16\n"
CONFIG = f"""\
[printer]
kinematics: rotary_delta
shoulder_radius: 33.9
shoulder_height: 412.9
[stepper_a]
{GEARS}position_endstop: 252
upper_arm_length: 170.000
lower_arm_length: 320.000
[stepper_b]
{GEARS}[stepper_c]
{GEARS}[probe]
z_offset: {TRIGGER}
[delta_calibrate]
radius: 80
"""
RRF_CONFIG = """\
M669 K10 U170 L320 H412.9 R33.9 A-60:45 B90 S100
M666 X0.5 Y-0.4 Z0.2
M558 P8 H5 F120
G31 P500 X0 Y0 Z2.5
"""


def real_printer(firmware: KlipperRotary | RrfRotary, **arms: np.ndarray) -> Rotary:
    """A printer off by what assembly leaves."""
    believed = firmware.geometry
    return dataclasses.replace(
        believed,
        radius=believed.radius + 0.5,
        height=believed.height - 1.2,
        limbs=believed.limbs + np.array([0.4, -0.3, 0.0]),
        switches=believed.switches + np.array([0.6, -0.5, 0.3]),
        **arms,
    )


def check_bed(firmware: KlipperRotary | RrfRotary, real: Rotary) -> None:
    """The bed is within twice the noise of a reading, at the probe's height and at 0.

    Heights in one plane give the scale along z to some per mille.
    """
    points = np.pad(disc(REACH, 9), ((0, 0), (0, 1)))
    for height, mean in ((TRIGGER, 0.5 * NOISE), (0.0, 2.0 * NOISE)):
        points[:, 2] = height
        errors = firmware.errors(real, points)[:, 2]
        assert abs(errors.mean()) < mean
        assert errors.std() < NOISE


def klipper_text(text: str = CONFIG) -> str:
    """A configuration with saved heights."""
    firmware = KlipperRotary(text)
    rng = np.random.default_rng(1)
    firmware.calibrate(real_printer(firmware), PLACES, TRIGGER, NOISE, rng)
    return firmware.text()


def test_klipper_heights_put_the_bed_right(tmp_path):
    text = klipper_text()
    firmware = KlipperRotary(text)
    real = real_printer(firmware)
    points = np.pad(disc(REACH, 9), ((0, 0), (0, 1)))
    assert np.ptp(firmware.errors(real, points)[:, 2]) > 1.0
    study, imported = take("klipper", {"printer.cfg": text}, tmp_path)
    assert len(imported.rows) == len(PLACES)
    with_known_noise(study, 1e3 * NOISE)
    export = compensate(study, "klipper")
    assert "shoulder_radius" in export
    check_bed(firmware.apply(export), real)


def test_klipper_distances_give_the_arms(tmp_path):
    """Heights and distances of one printer: places are right as well."""
    firmware = KlipperRotary(CONFIG)
    arms = {"upper": np.array([170.3, 169.8, 170.1]), "lower": np.full(3, 320.4)}
    real, rng = real_printer(firmware, **arms), np.random.default_rng(2)
    firmware.calibrate(real, PLACES, TRIGGER, NOISE, rng)
    ends = np.pad(spiral(40, REACH), ((0, 0), (0, 1))).reshape(20, 2, 3)
    firmware.analyze(real, ends, 0.02, rng)
    study, imported = take("klipper", {"printer.cfg": firmware.text()}, tmp_path)
    assert "20 distances" in said(imported)
    with_known_noise(study, 1e3 * NOISE)
    firmware.apply(compensate(study, "klipper"))
    check_bed(firmware, real)
    plane = np.pad(disc(REACH, 5), ((0, 0), (0, 1)))
    tools = plane + firmware.errors(real, plane)
    scale = np.linalg.norm(tools - tools.mean(0)) / np.linalg.norm(
        plane - plane.mean(0)
    )
    assert scale == pytest.approx(1.0, abs=2e-4)


def rrf_files(config: str = RRF_CONFIG) -> dict[str, str]:
    firmware = RrfRotary(config)
    log = firmware.g32(
        real_printer(firmware), PLACES, TRIGGER, NOISE, np.random.default_rng(3)
    )
    return {"config.g": config, "bed.g": rrf.bed_file(PLACES), "log.txt": log}


def test_reprapfirmware_heights_put_the_bed_right(tmp_path):
    files = rrf_files()
    firmware = RrfRotary(RRF_CONFIG)
    study, imported = take("rrf", files, tmp_path)
    assert "24 points of contact" in said(imported)
    assert "G31 X Y Z;" in said(imported)
    assert {row["height_mm"] for row in imported.rows} == {"2.5"}
    assert nominal(study)["endstop1_deg"] == pytest.approx(45.5)
    with_known_noise(study, 1e3 * NOISE)
    export = compensate(study, "rrf")
    assert "A-60:45 B90 S100" in export
    assert "M500 stores two decimals" in export
    check_bed(RrfRotary(RRF_CONFIG, export), real_printer(firmware))


def test_one_firmware_takes_what_the_other_measured(tmp_path):
    """Klipper's limbs at 30, 150 and 270 degrees are those of RepRapFirmware, turned."""
    text = klipper_text()
    study, _ = take("klipper", {"printer.cfg": text}, tmp_path)
    with_known_noise(study, 1e3 * NOISE)
    export = compensate(study, "rrf")
    check_bed(RrfRotary(export), real_printer(KlipperRotary(text)))


@pytest.mark.parametrize(("before", "after", "problem"), [
    ("rotary_delta", "polar", r"line 2, \[printer\] kinematics.*no delta"),
    ("shoulder_radius: 33.9", "delta_radius: 9", r"line 3, \[printer\] delta_radius"),
    ("microsteps: 16", "microsteps: 16\nrotation_distance: 40", r"rotation_distance.*no such option"),
    ("position_endstop: 252", "position_endstop: 2000", "line 8.*do not reach"),
    ("gear_ratio: 107:16, 60:16", "", r"\[stepper_a\] gear_ratio.*missing"),
    ("gear_ratio: 107:16", "gear_ratio: 214:16", "its steps are .* times those"),
])  # fmt: skip
def test_what_klipper_does_not_take_is_refused(before, after, problem, tmp_path):
    text = klipper_text().replace(before.replace(": ", " = "), after)
    with pytest.raises(InputError, match=problem):
        take("klipper", {"printer.cfg": text}, tmp_path)


@pytest.mark.parametrize(("before", "after", "problem"), [
    ("K10", "K4", "line 1, M669 K.*none of linear delta"),
    ("H412.9", "H412.9:413.2:412.9", "line 1, M669 H.*one height"),
    ("U170", "U170:170", "line 1, M669 U.*2 numbers, where 1 or 3 belong"),
    ("U170 ", "", "M669 U.*has no U"),
    ("B90", "W90", "line 1, M669 W.*does not know this word"),
    ("M558", "M665 R100\nM558", "line 3, M665.*of linear deltas"),
    ("M666 X0.5", "M666 A1", "line 2, M666 A.*does not know"),
])  # fmt: skip
def test_what_the_model_has_not_is_refused(before, after, problem, tmp_path):
    files = {"bed.g": rrf.bed_file(PLACES), "log.txt": "G32 bed probe heights: 0\n"}
    files["config.g"] = RRF_CONFIG.replace(before, after, 1)
    with pytest.raises(InputError, match=problem):
        take("rrf", files, tmp_path)


def test_factors_are_those_of_the_firmware(tmp_path):
    files = rrf_files()
    study, _ = take("rrf", files | {"more.txt": "factors = 4\n"}, tmp_path / "a")
    fixed = re.search(r"fixed = \[(.*)\]", study.read_text())[1]
    assert '"radius"' in fixed
    assert '"height"' not in fixed
    with pytest.raises(InputError, match="firmwares fit 3, 4, 5, 7 factors"):
        take("rrf", files | {"more.txt": "factors = 8\n"}, tmp_path / "b")


PLACE_NOISE = 0.02
CONFIGS = {
    # in mode 1 both knees are behind their lines to the nozzle, in mode 2 both are outward
    "1": "M669 K9 X-50:50 Y0:0 P150:150 D200:200:0:0 L1 B60:30 A20:160:0:360:0:360\n",
    "2": "M669 K9 X-50:50 Y10:-10 P150:160 D200:210:0:0 L2 S100\n",
}
GRID = [complex(x, y) for x in (-60, -30, 0, 30, 60) for y in (180, 210, 240, 270)]


def real_linkage(believed: FiveBar) -> FiveBar:
    """A linkage off by what assembly leaves."""
    return dataclasses.replace(
        believed,
        centres=[
            believed.centres[0] + (0.4 - 0.3j),
            believed.centres[1] + (-0.2 + 0.5j),
        ],
        cranks=[believed.cranks[0] + 0.6, believed.cranks[1] - 0.4],
        struts=[believed.struts[0] - 0.5, believed.struts[1] + 0.7],
        switches=[believed.switches[0] + 0.8, believed.switches[1] - 0.5],
    )


def reached(firmware: FiveBar, real: FiveBar, places: list[complex]) -> np.ndarray:
    return np.array([real.tool(firmware.turns(place)) for place in places])


def table(config: str) -> str:
    """Places as a scanner with a frame of its own reads them."""
    rng, believed = np.random.default_rng(4), five_bar(config)
    tools = reached(believed, real_linkage(believed), GRID)
    read = tools * np.exp(0.03j) + (20 - 10j)
    read += PLACE_NOISE * (rng.normal(size=len(read)) + 1j * rng.normal(size=len(read)))
    rows = zip(GRID, read, strict=True)
    cells = (f"{c.real},{c.imag},{r.real:.4f},{r.imag:.4f}" for c, r in rows)
    return "\n".join(["x,y,read_x,read_y", *cells, ""])


def misfit(tools: np.ndarray, places: list[complex]) -> np.ndarray:
    """Distances from the places, after the best shift and turn."""
    wanted = np.array(places) - np.mean(places)
    turned = tools - tools.mean()
    turn = np.vdot(turned, wanted)
    return np.abs(turned * turn / abs(turn) - wanted)


@pytest.mark.parametrize("mode", CONFIGS)
def test_places_put_the_nozzle_right(mode, tmp_path):
    config = CONFIGS[mode]
    believed = five_bar(config)
    real = real_linkage(believed)
    assert misfit(reached(believed, real, GRID), GRID).max() > 0.5
    study, imported = take(
        "rrf", {"config.g": config, "m.csv": table(config)}, tmp_path
    )
    assert "20 places" in said(imported)
    known = "estimate = false\nread_x_mm = 0.02\nread_y_mm = 0.02\n[readings]"
    head, _, rest = study.read_text().partition("assumed = true")
    study.write_text(head + known + rest.partition("[readings]")[2])
    export = compensate(study, "rrf")
    between = [complex(x, y) for x in (-50, -10, 40) for y in (190, 225, 260)]
    for places in (GRID, between):
        tools = reached(five_bar(config + export), real, places)
        assert misfit(tools, places).max() < 2.0 * PLACE_NOISE
    kept = config.split("L1" if mode == "1" else "L2")[1].split("B60:30")[-1].strip()
    assert kept in export


@pytest.mark.parametrize(("before", "after", "problem"), [
    ("L1", "L3", "line 1, M669 L.*modes 1, 2 and 4"),
    ("D200:200:0:0", "D200:200:0:40", "line 1, M669 D.*beyond the joint"),
    ("D200:200:0:0", "D200", "line 1, M669 D.*1 numbers, where 2 or 4"),
    ("P150:150 ", "", "M669 has no P"),
    ("S100", "", "line 5, column x.*do not reach"),
    ("A20:", "U20:", "line 1, M669 U.*does not know this word"),
    ("M669 K9", "M666 X1\nM669 K9", "line 1, M666.*of linear deltas"),
])  # fmt: skip
def test_what_a_five_bar_has_not_is_refused(before, after, problem, tmp_path):
    rows = table(CONFIGS["1"])
    if before == "S100":
        rows = rows.replace("-60.0,270.0,", "-600.0,270.0,")
    files = {"config.g": CONFIGS["1"].replace(before, after), "m.csv": rows}
    with pytest.raises(InputError, match=problem):
        take("rrf", files, tmp_path)


def test_places_are_asked_for(tmp_path):
    with pytest.raises(InputError, match="one CSV with x, y, read_x, read_y"):
        take("rrf", {"config.g": CONFIGS["1"]}, tmp_path)
