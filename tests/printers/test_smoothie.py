"""`oed import smoothie` and `--to smoothie`: a firmware written anew reads and prints both.

After LinearDeltaSolution.cpp, Endstops.cpp and the strategies of G29 of Smoothieware: a
carriage at its switch counts as that of the nozzle at Z + M206 Z, less its trim.
"""

import re

import numpy as np
import pytest
from oracles.firmware import fit, rrf
from oracles.firmware.geometry import (
    BASE,
    Probe,
    bed,
    carriages,
    contact,
    delta,
    spiral,
    towers,
)

import oed
from pkm_studies.base import InputError
from pkm_studies.commands import main
from printers.delta_printer import compensate, said, take, with_known_noise

NOISE, REACH = 0.01, 90.0
PLACES = np.vstack([[[0.0, 0.0]], spiral(20, REACH)])
SETTINGS = """\
M665 L250.0000 R124.5000 A0.3000 B0.0000 C-0.2000 D0.1000 E0.0000 H0.0000 I0.1000 J0.0000 K-0.1000
;Home offset (mm):
M206 X0.00 Y0.00 Z-0.35
;Trim (mm):
M666 X-0.200 Y0.000 Z-0.400
;Max Z
M665 Z300.000
"""


class Smoothie:
    """Kinematics by the words of M503."""

    def __init__(self, text: str) -> None:
        self.words = {"M665": {}, "M666": {}, "M206": {"Z": 0.0}}
        for name, rest in re.findall(r"^(M665|M666|M206) (.*)$", text, re.MULTILINE):
            pairs = re.findall(r"([A-Z])([-\d.]+)", rest)
            self.words[name] |= {letter: float(value) for letter, value in pairs}

    def by_tower(self, letters: str) -> np.ndarray:
        return np.array([self.words["M665"].get(letter, 0.0) for letter in letters])

    def travel(self, points) -> np.ndarray:
        delta_words = self.words["M665"]
        feet = towers(
            delta_words["R"] + self.by_tower("ABC"), BASE + self.by_tower("DEH")
        )
        arms = delta_words["L"] + self.by_tower("IJK")
        height = delta_words["Z"] + self.words["M206"]["Z"]
        home = carriages([0.0, 0.0, height], feet, arms)[0]
        switches = home - [self.words["M666"][axis] for axis in "XYZ"]
        return switches - carriages(points, feet, arms)


def printer(trim=(0.3, 0.0, -0.2)):
    """A printer whose radii differ as the firmware knows, or otherwise."""
    arms = [250.1, 250.0, 249.9]
    return delta(
        124.8 + np.array(trim), arms, [210.3, 329.8, 90.0], [300.0, 299.4, 300.1]
    )


def log_of(firmware: Smoothie, real, form: str, line: str = "") -> str:
    """M503 and the heights of one of the forms; of a grid at the places of the probe."""
    rng = np.random.default_rng(2)
    z = contact(firmware, real, Probe(sigma=NOISE), PLACES, rng)
    rows = {
        "spiral": lambda x, y, h: f"PROBE: X{x:1.4f}, Y{y:1.4f}, Z{h - z[0]:1.4f}",
        "seven": lambda x, y, h: (
            f"X:{x:1.4f} Y:{y:1.4f} Z:{5.0 - h:1.4f} A:1.0000 B:1.0000 C:1.0000"
        ),
        "host": lambda x, y, h: f"Recv: X:{x:1.4f} Y:{y:1.4f} Z:{5.0 - h:1.4f}",
        "grid": lambda x, y, h: (
            f"Recv: DEBUG: X{x + 8.0:1.4f}, Y{y - 6.0:1.4f}, Z{h - z[0]:1.4f}"
        ),
        "escher": lambda x, y, h: f"X{x:1.4f} Y{y:1.4f} Z{h + 5.0:1.4f}",
    }
    lines = [rows[form](x, y, h) for (x, y), h in zip(PLACES, z, strict=True)]
    return SETTINGS + line + "\n".join([*lines, "max delta: 0.1", ""])


def test_a_grid_is_at_the_places_of_the_probe(tmp_path):
    """G31 prints where the probe was, G29 where the nozzle was; hosts write Recv: before."""
    firmware, real = Smoothie(SETTINGS), printer()
    rows = []
    for form, line in (("grid", "M565 X8.00 Y-6.00\nG31\n"), ("host", "G29\n")):
        log = log_of(firmware, real, form, line)
        _, imported = take("smoothie", {"log": log}, tmp_path / form)
        cells = [[float(row[f"{a}_mm"]) for a in "xyz"] for row in imported.rows]
        rows.append(np.array(cells))
    np.testing.assert_allclose(rows[0], rows[1], atol=2e-4)
    np.testing.assert_allclose(rows[0][:, :2], PLACES, atol=1e-4)


@pytest.mark.parametrize("form", ["spiral", "seven", "escher"])
def test_the_bed_is_flat_after_one_import_and_one_paste(form, tmp_path):
    firmware, real = Smoothie(SETTINGS), printer()
    log = log_of(firmware, real, form)
    study, imported = take("smoothie", {"log": log}, tmp_path)
    with_known_noise(study, 1e3 * NOISE)
    assert "radii 124.8, 124.5, 124.3 mm" in said(imported)
    z = contact(firmware, real, Probe(sigma=NOISE), PLACES, np.random.default_rng(2))
    travels = firmware.travel(np.column_stack([PLACES, z]))
    start = delta(124.5 + real.radius - 124.8, real.arms, [210.1, 330, 90], 300.0)
    best = fit.fit(travels, start, z[0])
    pasted = Smoothie(SETTINGS + compensate(study, "smoothie"))
    assert pasted.words["M206"] == {"X": 0.0, "Y": 0.0, "Z": -0.35}
    flat = bed(pasted, real, REACH) - bed(pasted, real, 0.1).mean()
    least = bed(best, real, REACH)
    assert np.ptp(flat) < max(2.0 * NOISE, 1.1 * np.ptp(least))


def test_letters_of_g32_choose_what_is_fitted(tmp_path):
    """Radii by tower too."""
    firmware, real = Smoothie(SETTINGS), printer((0.6, 0.0, -0.2))
    log = log_of(firmware, real, "spiral", "G32 XYZRADE P20\n")
    study, _ = take("smoothie", {"log": log}, tmp_path)
    with_known_noise(study, 1e3 * NOISE)
    fixed = oed.load_study(study).machine.fixed
    assert {"trim2", "arm1", "angle3", "bed_slope_x"} <= set(fixed)
    assert not {"trim1", "radius", "angle1", "angle2", "endstop3"} & set(fixed)
    pasted = Smoothie(SETTINGS + compensate(study, "smoothie"))
    assert np.ptp(bed(pasted, real, REACH)) < 3.0 * NOISE


def lost_by_the_mean() -> float:
    """Spread, mm, of carriages' travels over the study's grid, by three radii or by one."""
    ends = np.linspace(-0.7 * REACH, 0.7 * REACH, 3)
    x, y, z = np.meshgrid(ends, ends, [0.0, 50.0])
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    radii = 124.8 + np.array([0.3, 0.0, -0.2])
    real = printer()
    one = delta(radii.mean(), real.arms, real.angles, real.endstops)
    return float(np.ptp(real.travel(points) - one.travel(points)))


def test_three_radii_are_refused_with_what_is_lost(tmp_path, capsys):
    log = log_of(Smoothie(SETTINGS), printer(), "spiral")
    study, _ = take("smoothie", {"log": log}, tmp_path)
    folder = tmp_path / "r"
    main(["run", str(study), "--out", str(folder), "--quiet"])
    capsys.readouterr()
    assert main(["compensate", str(folder), "--to", "klipper"]) == 2
    printed = capsys.readouterr().err
    assert "the towers have three: radius1" in printed
    lost = re.search(r"carriages are up to ([\d.]+) mm off", printed)
    assert float(lost[1]) == pytest.approx(lost_by_the_mean(), rel=0.25)


@pytest.mark.parametrize(("old", "new", "said_so"), [
    ("M665 Z300.000\n", "", "M665 has no Z"),
    ("PROBE: ", "probed ", "no probed points in it; log the answer of G29.1"),
    ("M665 L", "M665 W9 L", r"line 1, M665 W"),
    (SETTINGS, "EPR:3 881 215.0 Diagonal rod length [mm]\n", "line 1.*Repetier"),
])  # fmt: skip
def test_what_is_not_read_is_refused_with_its_reason(old, new, said_so, tmp_path):
    log = log_of(Smoothie(SETTINGS), printer(), "spiral")
    assert old in log
    with pytest.raises(InputError, match=said_so):
        take("smoothie", {"log": log.replace(old, new)}, tmp_path)


REPETIER = """\
EPR:3 11 100.0000 Steps per mm
EPR:3 153 300.000 Z max length [mm]
EPR:3 881 250.000 Diagonal rod length [mm]
EPR:3 885 124.500 Horizontal rod radius at 0,0 [mm]
EPR:1 893 20 Tower X endstop offset [steps]
"""


@pytest.mark.parametrize("kind", ["marlin", "rrf", "smoothie"])
def test_a_log_of_repetier_is_refused_by_name(kind, tmp_path):
    with pytest.raises(InputError, match="this is a log of Repetier, whose Z-probe"):
        take(kind, {"log.txt": REPETIER + "Z-probe:20.580 X:0.00 Y:0.00\n"}, tmp_path)


def test_numbers_of_repetier_come_in_as_those_of_reprapfirmware(tmp_path):
    """As the page on imports has them: endstop offsets in steps lower the towers."""
    offsets, steps = np.array([20, 0, 35]), 100.0
    real = delta(124.8, 250.0, [210.3, 329.8, 90.0], [300.35, 299.9, 300.2])
    # Repetier: a tower goes down by its offset, and is then that of the nozzle at Z max
    firmware = delta(124.5, 250.0, BASE, 300.0 + offsets / steps)
    probe, rng = Probe(sigma=NOISE), np.random.default_rng(4)
    distances = 15.0 - contact(firmware, real, probe, PLACES, rng)
    config = "M665 L250 R124.5 H300 X0 Y0 Z0\nM666 X0.2 Y0 Z0.35\nG31 X0 Y0 Z0\n"
    cells = " ".join(f"{distances[0] - d:.3f}" for d in distances)
    files = {
        "config.g": config,
        "bed.g": rrf.bed_file(PLACES),
        "log.txt": f"G32 bed probe heights: {cells}\nfactors = 6\n",
    }
    study, _ = take("rrf", files, tmp_path)
    with_known_noise(study, 1e3 * NOISE)
    printed = rrf.RepRapFirmware(compensate(study, "rrf"))
    assert np.ptp(bed(printed, real, REACH)) < 3.0 * NOISE
