"""Printers with errors, from the firmware's log to their calibrated beds.

A firmware of the oracle probes a printer whose geometry it does not know. What it logs is
imported and fitted, and the export is read back by the same firmware. Bed and distances of
the printer are then as good as least squares over the oracle's delta can make them.
"""

from pathlib import Path

import numpy as np
import pytest
from oracles.firmware import fit, marlin, marlin_g33, rrf
from oracles.firmware.geometry import (
    Delta,
    Firmware,
    Probe,
    bed,
    delta,
    distances,
    spiral,
)
from oracles.firmware.klipper import Klipper, example

from printers.delta_printer import compensate, take, with_known_noise

REACH, NOISE = 90.0, 0.01
ANGLES, STOPS = [210.3, 329.8, 90.0], [260.2, 259.7, 260.3]
#: arms that firmwares with one length, and with a length for each tower, have
ALIKE, BY_TOWER = [250.0] * 3, [250.2, 249.85, 250.1]
PLACES = spiral(16, REACH)


def imported(kind: str, files: dict[str, str], folder: Path) -> Path:
    """The study of an import, its noise known to be that of the probe."""
    study, _ = take(kind, files, folder)
    with_known_noise(study, 1e3 * NOISE)
    return study


def calibrate(kind: str, files: dict[str, str], folder: Path) -> str:
    """What `oed compensate` writes for the files of a printer."""
    return compensate(imported(kind, files, folder), kind)


def printer(arms=ALIKE, tilt=(0.0, 0.0)) -> Delta:
    return delta(110.3, arms, ANGLES, STOPS, tilt)


def check(firmware: Firmware, real: Delta, best: Delta | None) -> None:
    """Bed and distances are within twice the noise, or as good as least squares."""
    least = (0.0, 0.0)
    if best is not None:
        least = (np.ptp(bed(best, real, REACH)), reach_error(best, real))
    assert np.ptp(bed(firmware, real, REACH)) <= max(2 * NOISE, 1.1 * least[0])
    assert abs(bed(firmware, real, REACH).mean()) < NOISE
    # heights alone give the longest of these distances badly
    assert reach_error(firmware, real) <= max(2 * NOISE, 1.1 * least[1])


def reach_error(firmware: Firmware, real: Delta) -> float:
    return float(np.abs(distances(firmware, real, REACH)).max())


# -- Klipper ---------------------------------------------------------------------------
def test_klipper(tmp_path):
    """Heights of independent noise: Klipper's fit of the file is no better."""
    firmware = Klipper(example(probe=(20, -5, 2.5)))
    real, probe = printer(), Probe(20, -5, 2.5, NOISE)
    firmware.calibrate(real, probe, spiral(18, REACH), np.random.default_rng(1))
    best = firmware.fitted()
    firmware.apply(calibrate("klipper", {"printer.cfg": firmware.text()}, tmp_path))
    check(firmware, real, best)


def test_klipper_with_distances(tmp_path):
    """Arms are fitted too; heights and distances have noises of their own."""
    firmware, real = Klipper(example(probe=(0, 0, 2.5))), printer(BY_TOWER)
    rng = np.random.default_rng(1)
    firmware.calibrate(real, Probe(z=2.5, sigma=NOISE), spiral(24, REACH), rng)
    firmware.analyze(real, 0.02, rng, objects=3)
    best = firmware.fitted()
    firmware.apply(calibrate("klipper", {"printer.cfg": firmware.text()}, tmp_path))
    check(firmware, real, best)


def test_klipper_of_a_fork_that_trims_radii(tmp_path):
    """delta_radius_offset: a radius for each tower in, and out."""
    text = example(probe=(0, 0, 2.5))
    for tower, trim in zip("abc", (0.4, -0.3, 0.1), strict=True):
        head = f"[stepper_{tower}]"
        text = text.replace(head, f"{head}\ndelta_radius_offset: {trim}")
    firmware = Klipper(text)
    real = delta(110.3 + np.array([0.4, -0.3, 0.1]), 250.0, ANGLES, STOPS)
    probe = Probe(z=2.5, sigma=NOISE)
    firmware.calibrate(real, probe, spiral(18, REACH), np.random.default_rng(2))
    export = calibrate("klipper", {"printer.cfg": firmware.text()}, tmp_path)
    assert "delta_radius_offset: -0.300000" in export
    check(firmware.apply(export), real, None)


# -- RepRapFirmware --------------------------------------------------------------------
CONFIG = """\
M665 L{rods} R110.0 H260.0 B100.0 X0 Y0 Z0
M666 X0 Y0 Z0{tilt}
M558 P8 C"zprobe.in" H10 F300 T6000
G31 P500 X{x:g} Y{y:g} Z2.5
"""
STORED = "M665 L250 R110.1 H260.05 B100 X0.05 Y-0.04 Z0\nM666 X0.1 Y-0.05 Z-0.05\n"
CASES = {
    "both": ({"tilt": " A0.40 B-0.30", "x": 23, "y": -7}, ALIKE, (0.004, -0.003)),
    "plain": ({}, ALIKE, (0, 0)),
    "rods": ({"rods": "250.2:249.85:250.1", "x": 23}, BY_TOWER, (0, 0)),
}


@pytest.mark.parametrize("case", CASES)
def test_reprapfirmware(case, tmp_path):
    """With bed tilt and the probe beside the nozzle, and with rods by tower."""
    values, arms, tilt = CASES[case]
    values = {"rods": "250.0", "tilt": "", "x": 0, "y": 0, **values}
    real, config = printer(arms, tilt), CONFIG.format(**values)
    probe = Probe(values["x"], values["y"], 2.5, NOISE)
    # a probe beside the nozzle triggers over another place of a bed that leans
    probe.z -= real.tilt @ [probe.x, probe.y]
    check_rrf({"config.g": config}, real, probe, tmp_path)


def test_reprapfirmware_with_stored_values(tmp_path):
    """M501 reads them after config.g: the export is for their file."""
    config = CONFIG.format(rods="250", tilt="", x=0, y=0).replace("R110.0", "R109.0")
    files = {"config.g": config + "M501\n", "config-override.g": STORED}
    probe = Probe(z=2.5, sigma=NOISE)
    export = check_rrf(files, printer(), probe, tmp_path)
    assert "for config-override.g of RepRapFirmware 3" in export
    assert "M501 reads config-override.g after config.g" in export


def check_rrf(files: dict[str, str], real: Delta, probe: Probe, folder: Path) -> str:
    """The export, put where it says; the stored values are read after config.g."""
    firmware = rrf.RepRapFirmware(*files.values())
    bed_file = rrf.bed_file(PLACES)
    log = firmware.g32(bed_file, real, probe, np.random.default_rng(1))
    nozzle = PLACES - firmware.offset[:2]
    heights = np.array(log.split(": ")[1].split(",")[0].split(), float)
    travels = firmware.travel(np.column_stack([nozzle, heights]))
    endstops = firmware.height + firmware.adjust
    start = delta(firmware.radius, firmware.rods, firmware.angles, endstops, real.tilt)
    given = files | {"bed.g": bed_file, "log.txt": log}
    export = calibrate("rrf", given, folder)
    *before, last = files
    # the file that the export names has its lines in place of the old ones
    texts = [files[name] for name in before] + [
        export if before else files[last] + export
    ]
    printed = rrf.RepRapFirmware(*texts)
    assert printed.bed == 100.0
    best = rrf.RepRapFirmware(*texts)
    fitted = fit.fit(travels, start, leaning=True)
    best.tilt = fitted.tilt
    best.radius, best.height = fitted.radius[0], fitted.endstops.mean()
    best.adjust = fitted.endstops - best.height
    best.lean = fitted.angles - [210.0, 330.0, 90.0]
    check(printed, real, best)
    return export


# -- Marlin ----------------------------------------------------------------------------
SETTINGS = "M665 L250 R110 H260\nM666 X-0.5 Y-0.4 Z-0.3\nM851 X18 Y-8 Z-2.5\n"


def set_up(version: type[marlin.Marlin], settings: str) -> marlin.Marlin:
    """A firmware with the settings that it prints itself."""
    compiled = {} if version.has_height else {"home_height": 260.0}
    firmware = version(settings, probe_xy=(18, -8), **compiled)
    return version(firmware.m503(), probe_xy=(18, -8), **compiled)


def log_of(firmware: marlin.Marlin) -> str:
    """What it prints of itself, and what a user adds."""
    log = firmware.m115() + firmware.m503()
    if not firmware.probe_has_xy:
        log += "probe_offset_mm = 18, -8\n"
    return log if firmware.has_height else log + "home_height_mm = 260\n"


@pytest.mark.parametrize("version", marlin.VERSIONS[1:], ids=lambda v: v.version)
def test_marlin(version, tmp_path):
    """The probe beside the nozzle and below it; rods by tower where a version has them."""
    rods = version.b_word == "rod"
    arms = BY_TOWER if rods else ALIKE
    settings = SETTINGS + ("M665 A0.2 B-0.15 C0.1\n" if rods else "M665 B70\n")
    firmware, real = set_up(version, settings), printer(arms)
    probe, rng = Probe(18, -8, 2.5, NOISE), np.random.default_rng(1)
    log = log_of(firmware) + firmware.g30(real, probe, PLACES, rng)
    best = best_of(firmware, log)
    export = calibrate("marlin", {"printer.log": log}, tmp_path)
    firmware.apply(export)
    assert firmware.stored
    if version.b_word == "radius":
        assert firmware.words["B"] == 70.0  # the radius of calibration stays
    check(firmware, real, best)


def best_of(firmware: marlin.Marlin, log: str) -> Delta:
    """Least squares over the printed heights."""
    rows = np.array([[float(v) for v in line.split()[2::2]] for line in bed_lines(log)])
    lift = firmware.probe_z if firmware.reads_to_bed else 0.0
    places = rows - [*firmware.probe[:2], lift]
    start = delta(110.0, firmware.arms, firmware.angles, STOPS)
    return fit.fit(firmware.travel(places), start, -firmware.probe_z)


def bed_lines(log: str) -> list[str]:
    return [line for line in log.splitlines() if line.startswith("Bed X:")]


@pytest.mark.parametrize(("words", "offset"), [
    ("P4 V0", False), ("P3 V0 O", True), ("P7 V0", False), ("P8 V0", False),
    ("P10 V0 O", True),
])  # fmt: skip
def test_marlin_g33(words, offset, tmp_path):
    """Means over rings of places count as such; with O the probe is on the places."""
    x, y = (23.0, -5.0) if offset else (0.0, 0.0)
    firmware = marlin.Marlin(
        f"M665 L250 R110 H260\nM666 X-0.5 Y-0.4 Z-0.3\nM851 X{x} Y{y} Z-2.5"
    )
    real, probe = printer(), Probe(x, y, 2.5)
    log = log_of(firmware)
    log += marlin_g33.g33(firmware, real, probe, 80.0, words, digits=4)
    firmware.apply(calibrate("marlin", {"printer.log": log}, tmp_path))
    # without noise: as points, these means bend the bed by 70 um. The priors pull seven
    # readings of an assumed noise of 100 um by some um
    assert np.ptp(bed(firmware, real, 80.0)) < 6e-3
    assert np.abs(distances(firmware, real, 80.0)).max() < 0.03


# -- from one firmware to another ------------------------------------------------------
def test_the_height_at_home_holds_on_another_firmware(tmp_path):
    """Marlin counts H to the probe, or goes further from the switches; others do not."""
    real = printer()
    for version in (marlin.Marlin118, marlin.Marlin205, marlin.Marlin):
        firmware = set_up(version, SETTINGS)
        probe = Probe(18, -8, 2.5)
        log = log_of(firmware) + firmware.g30(real, probe, PLACES, digits=4)
        folder = tmp_path / version.version
        config = calibrate_as("rrf", log, folder)
        printed = rrf.RepRapFirmware(config)
        assert np.abs(bed(printed, real, REACH)).max() < 2e-3
        newest = marlin.Marlin("M665 L1 R1 H1\nM851 X18 Y-8 Z-2.5")
        newest.apply(calibrate_as("marlin", log, folder, "--firmware", "2.1.2"))
        assert np.abs(bed(newest, real, REACH)).max() < 2e-3


def calibrate_as(kind: str, log: str, folder: Path, *options: str) -> str:
    """The export for another firmware than that of a Marlin log."""
    study = folder / "study" / "p.study.toml"
    if not study.exists():
        study = imported("marlin", {"printer.log": log}, folder)
    return compensate(study, kind, *options)
