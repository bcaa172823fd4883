"""A delta whose bed leans and whose effector tilts, with a probe beside the nozzle.

From the files of RepRapFirmware to the lines that are pasted into config.g. The printer is
the oracle's, with six rods: it shares no code with the toolkit.
"""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from oracles.firmware import rrf
from oracles.firmware.geometry import Probe, delta, disc, spiral
from oracles.firmware.klipper import Klipper, example, parse
from oracles.firmware.six_rods import SixRods
from shipped_models import delta_printer

import oed
from pkm_studies.base import InputError
from pkm_studies.commands import main
from pkm_studies.results import load_result
from printers.delta_printer import compensate, said, take, with_known_noise

NOISE, LEAN, REACH = 0.015, 3.5e-3, 100.0
PROBE = np.array([25.0, 0.0, -1.5])  #: tip of the probe from the nozzle, mm
CONFIG = "M669 K3\nM665 L300.0 R150.0 H350.0 B120 X0 Y0 Z0\nM666 X0 Y0 Z0 A0 B0\n"
PLACES = spiral(24, REACH)


def printer(rng: np.random.Generator) -> SixRods:
    """A printer of 0.05 mm parts over 50 mm, whose bed leans in any direction."""
    direction = rng.uniform(0.0, 2.0 * np.pi)
    return SixRods(
        radius=150.0 + rng.normal(0.0, 0.5),
        arm=300.0,
        angles=np.array([210.0, 330.0, 90.0]) + np.append(rng.normal(0.0, 0.2, 2), 0.0),
        endstops=350.0 + rng.normal(0.0, 0.4, 3),
        turns=rng.normal(0.0, 1e-3, 3),
        pairs=rng.normal(0.0, 0.05, 3),
        lean=LEAN * np.array([np.cos(direction), np.sin(direction)]),
    )


def files_of(real: SixRods, rng: np.random.Generator) -> dict[str, str]:
    """config.g, bed.g and the log of ten stops in the middle and one G32."""
    firmware = rrf.RepRapFirmware(CONFIG)
    height = real.trigger_height(firmware, PROBE)
    config = CONFIG + f"G31 P500 X{PROBE[0]:g} Y{PROBE[1]:g} Z{height:.4f}\n"
    firmware = rrf.RepRapFirmware(config)
    z = real.contacts(firmware, PROBE, PLACES - PROBE[:2])
    heights = z - firmware.offset[2] + rng.normal(0.0, NOISE, len(z))
    cells = " ".join(f"{h:.3f}" for h in heights)
    stops = height + rng.normal(0.0, NOISE, 10)
    log = "".join(f"G30 S-1\nStopped at height {v:.3f} mm\n" for v in stops)
    log += f"G32 bed probe heights: {cells}, mean 0.0, deviation from mean 0.1\n"
    return {"config.g": config, "bed.g": rrf.bed_file(PLACES), "log.txt": log}


def bed_error(real: SixRods, text: str) -> float:
    """Root mean square height, mm, of the nozzle over the bed where z = 0 is commanded."""
    places = disc(REACH, 15)
    points = np.column_stack([places, np.zeros(len(places))])
    nozzle, _ = real.poses(rrf.RepRapFirmware(text).travel(points))
    return float(np.sqrt((real.over_bed(nozzle) ** 2).mean()))


def realised(real: SixRods, text: str, study: Path) -> np.ndarray:
    """Root mean square errors (3,), mm, on the study's grid, zeroed at home, z of the bed."""
    table = tomllib.loads(study.read_text())
    axes = [table["prediction"][f"{name}_mm"] for name in "xyz"]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    home = [0.0, 0.0, table["machine"]["home"]["z_mm"]]
    points = np.vstack([grid, home])
    nozzle, _ = real.poses(rrf.RepRapFirmware(text).travel(points))
    errors = np.column_stack([nozzle[:, :2], real.over_bed(nozzle)]) - points
    return np.sqrt(((errors[:-1] - errors[-1]) ** 2).mean(axis=0))


def calibrated(seed: int, folder: Path) -> tuple[float, np.ndarray, np.ndarray]:
    """Error of the bed, realised and predicted errors (3,) of one printer, mm."""
    rng = np.random.default_rng(seed)
    real = printer(rng)
    study, _ = take("rrf", files_of(real, rng), folder)
    text = compensate(study, "rrf")
    prediction = load_result(folder / "study" / "r").prediction
    assert prediction is not None
    predicted = [1e-3 * prediction.components[name].after.rms for name in "xyz"]
    return bed_error(real, text), realised(real, text, study), np.array(predicted)


def test_one_import_and_one_paste_bring_the_bed_within_twice_the_noise(tmp_path):
    bed, errors, predicted = calibrated(1, tmp_path)
    assert bed < 2.0 * NOISE
    assert (errors < 2.5 * predicted).all()


# -- the choice of factors, and what few heights hide ----------------------------------
#: a level printer of the oracle's deltas, whose bed leans
LEANING = delta(150.3, 300.0, [210.2, 329.9, 90.0], [350.2, 349.8, 350.1], (0.0, -LEAN))


def files_with(places: np.ndarray, line: str = "") -> dict[str, str]:
    """Files of one G32, its log with a line that a user added."""
    config = CONFIG + "G31 X0 Y0 Z0.7\n"
    firmware, bed_file = rrf.RepRapFirmware(config), rrf.bed_file(places)
    probe = Probe(z=0.7, sigma=0.005)
    log = firmware.g32(bed_file, LEANING, probe, np.random.default_rng(4))
    return {"config.g": config, "bed.g": bed_file, "log.txt": line + log}


def free(study: Path) -> set[str]:
    """Parameters that are identified."""
    machine = oed.load_study(study).machine
    names = {p.name for p in delta_printer.machine.parameters}
    return names - set(machine.fixed)


ENDSTOPS, ANGLES = {"endstop1", "endstop2", "endstop3"}, {"angle1", "angle2"}
ARMS, SLOPES = {"arm1", "arm2", "arm3"}, {"bed_slope_x", "bed_slope_y"}
FITTED = {
    3: ENDSTOPS,
    4: ENDSTOPS | {"radius"},
    6: ENDSTOPS | ANGLES | {"radius"},
    7: ENDSTOPS | ANGLES | {"radius"} | ARMS,
    8: ENDSTOPS | ANGLES | {"radius"} | SLOPES,
    9: ENDSTOPS | ANGLES | {"radius"} | ARMS | SLOPES,
}


@pytest.mark.parametrize("number", FITTED)
def test_a_line_chooses_the_factors(number, tmp_path):
    """As S of G30 does in RepRapFirmware."""
    line = f"factors = {number}\n"
    study, imported = take("rrf", files_with(PLACES, line), tmp_path)
    assert free(study) == FITTED[number]
    end = (
        "fitted."
        if number >= 8
        else "not fitted; a line factors = 8 in the log fits it."
    )
    assert f"it is {end}" in said(imported)


def test_factors_that_no_firmware_fits_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"line 1, factors.*fit 3, 4, 6, 7, 8, 9"):
        take("rrf", files_with(PLACES, "factors = 5\n"), tmp_path)


def test_a_lean_that_few_heights_hide_is_said_to_be_hidden(tmp_path):
    """Seven heights of one ring and the middle fit six factors and tell nothing of a lean."""
    angle = np.radians(60.0 * np.arange(6))
    ring = REACH * np.column_stack([np.cos(angle), np.sin(angle)])
    few = np.vstack([ring, [[0.0, 0.0]]])
    study, imported = take("rrf", files_with(few), tmp_path)
    assert "these 7 heights cannot tell a bed that leans" in said(imported)
    assert free(study) == FITTED[6]
    again, imported = take("rrf", files_with(PLACES), tmp_path / "more")
    assert free(again) == FITTED[8]
    shown = re.search(r"y ([-+][\d.]+) \+- ([\d.]+) %", said(imported))
    assert float(shown[1]) == pytest.approx(-100.0 * LEAN, abs=3.0 * float(shown[2]))
    assert float(shown[2]) < 0.1


def test_a_lean_goes_where_a_firmware_has_a_word_for_it(tmp_path, capsys):
    """Klipper's [bed_tilt] raises z as M666 A and B do; Marlin has none: what is lost."""
    study, _ = take("rrf", files_with(PLACES), tmp_path)
    rise = rrf.RepRapFirmware(compensate(study, "rrf")).tilt
    assert rise == pytest.approx([0.0, -LEAN], abs=6e-4)
    result = tmp_path / "study" / "r"
    assert main(["compensate", str(result), "--to", "klipper"]) == 0
    tilt = parse((result / "compensation.cfg").read_text())["bed_tilt"]
    written = [float(tilt[f"{axis}_adjust"]) for axis in "xy"]
    assert written == pytest.approx(rise, abs=1e-6)
    capsys.readouterr()
    assert main(["compensate", str(result), "--to", "marlin"]) == 2
    printed = capsys.readouterr().err
    # over the corners of the study's grid, 70 % of the probed radius
    lost = float(re.search(r"up to ([\d.]+) mm off", printed)[1])
    assert lost == pytest.approx(70.0 * np.abs(rise).sum(), abs=0.05)
    assert "shim the bed" in printed


# -- heights of the nozzle beside those of the probe -----------------------------------
def test_heights_of_klipper_s_nozzle_are_a_set_up_of_their_own(tmp_path):
    """Heights by hand tell the tilts of the effector from the lean of the bed."""
    real = printer(np.random.default_rng(5))
    real.pairs = np.array([0.4, -0.3, 0.1])  # 6 to 8 mrad, far beyond parts of 0.05 mm
    real.lean = np.zeros(2)
    firmware = Klipper(example(150, 300, 350, probe=(*PROBE[:2], 2.0)))
    trigger = real.trigger_height(firmware, PROBE)
    z = real.contacts(firmware, PROBE, PLACES)
    by_hand = real.contacts(firmware, np.zeros(3), PLACES)
    section = firmware.saved.setdefault("delta_calibrate", {})
    kinds = (("height", z, trigger), ("manual_height", by_hand, 0.0))
    for name, heights, at in kinds:
        commands = np.column_stack([PLACES, heights])
        for k, travel in enumerate(firmware.travel(commands)):
            section[f"{name}{k}"] = f"{at:g}"
            steps = travel / firmware.step
            section[f"{name}{k}_pos"] = ",".join(f"{v:.3f}" for v in steps)
    study, imported = take("klipper", {"printer.cfg": firmware.text()}, tmp_path)
    assert [row["setup"] for row in imported.rows] == ["probe"] * 24 + ["nozzle"] * 24
    text = study.read_text()
    assert text.count("tool_mm = [25.0, 0.0, 0.0]") == 1
    wide = '\n[[prior.tolerance]]\nparameters = ["pair*"]\nsigma_mrad = 10.0\n'
    study.write_text(text + wide)
    with_known_noise(study, 5.0)
    firmware.apply(compensate(study, "klipper"))
    places = np.column_stack([disc(REACH, 15), np.zeros(len(disc(REACH, 15)))])
    nozzle, _ = real.poses(firmware.travel(places))
    assert np.std(real.over_bed(nozzle)) < NOISE
