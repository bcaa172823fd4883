"""Repeated readings of a log give the noise; an assumed one is the last resort.

Right values by the definition: sums of squares about the mean of each place, over the
degrees of freedom.
"""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from oracles.firmware import marlin, rrf
from oracles.firmware.geometry import Probe, delta, spiral
from oracles.firmware.klipper import Klipper, example

from pkm_studies.commands import main
from pkm_studies.results import load_result
from printers.delta_printer import said, take

REAL = delta(125.4, 250.0, [210.3, 329.8, 90.0], [300.2, 299.9, 300.1])
CONFIG = "M665 L250 R125 H300 B110 X0 Y0 Z0\nM666 X0 Y0 Z0\nG31 X0 Y0 Z0\n"
PLACES = spiral(12, 90.0)
SIGMA = 0.012


def spread(groups: np.ndarray) -> float:
    """Pooled standard deviation of readings (places, n) by place."""
    return float(np.sqrt(groups.var(axis=1, ddof=1).mean()))


def noise(study: Path) -> dict[str, float]:
    return tomllib.loads(study.read_text())["noise"]


def rrf_files(passes: int, between: str = "") -> dict[str, str]:
    """Files of a printer that probed all points so often."""
    firmware, rng = rrf.RepRapFirmware(CONFIG), np.random.default_rng(1)
    bed_file, probe = rrf.bed_file(PLACES), Probe(sigma=SIGMA)
    logs = [firmware.g32(bed_file, REAL, probe, rng) for _ in range(passes)]
    return {"config.g": CONFIG, "bed.g": bed_file, "log.txt": between.join(logs)}


def heights_of(log: str) -> np.ndarray:
    """Heights (points, passes) of a log."""
    lines = [
        row.split(": ")[1].split(",")[0] for row in log.splitlines() if ": " in row
    ]
    return np.array([line.split() for line in lines], float).T


def test_passes_of_one_geometry_are_repeated_readings(tmp_path):
    files = rrf_files(3)
    study, imported = take("rrf", files, tmp_path)
    right = 1e3 * spread(heights_of(files["log.txt"]))
    assert noise(study)["height_um"] == pytest.approx(right, abs=1e-3)
    assert "assumed" not in noise(study)
    assert len(imported.rows) == 36
    assert f"at 12 places spread by {right:.3g} um, with 24 degrees" in said(imported)
    main(["run", str(study), "--out", str(tmp_path / "r"), "--quiet"])
    result = load_result(tmp_path / "r")
    value = result.goodness.noise["reading probe.height"].value
    assert value == pytest.approx(1e3 * SIGMA, rel=0.35)


@pytest.mark.parametrize("between", ["M665 R125.1\n", "G31 X1\n"])
def test_passes_of_other_geometries_are_left_out(between, tmp_path):
    study, imported = take("rrf", rrf_files(3, between), tmp_path)
    assert len(imported.rows) == 12
    assert "Not read: 2 earlier lines of heights" in said(imported)
    assert noise(study)["assumed"]
    assert "no place was probed twice, so 100 um is assumed" in said(imported)


def test_stops_at_one_place_are_repeated_readings(tmp_path):
    """G30 S-1; a move begins another place."""
    groups = np.array([[1.602, 1.611, 1.595, 1.607], [1.702, 1.690, 1.711, 1.697]])
    lines = "G1 X50\n".join(
        "".join(f"G30 S-1\nStopped at height {v:.3f} mm\n" for v in group)
        for group in groups
    )
    files = rrf_files(1)
    study, _ = take("rrf", files | {"log.txt": lines + files["log.txt"]}, tmp_path)
    assert noise(study)["height_um"] == pytest.approx(1e3 * spread(groups), abs=1e-3)


def marlin_log(lines: str) -> str:
    firmware = marlin.Marlin("M665 L250 R125 H300\nM666 X-0.2 Y-0.2 Z-0.2")
    heights = firmware.g30(REAL, Probe(sigma=SIGMA), PLACES, np.random.default_rng(2))
    return firmware.m115() + firmware.m503() + lines + heights


SINGLE = [0.0113, 0.0125, 0.0041, 0.0219, 0.0080, 0.0142]


@pytest.mark.parametrize("verbose", [False, True])
def test_the_test_of_a_probe_gives_its_noise(verbose, tmp_path):
    """M48 prints the root of the mean square deviation, and its readings with V4."""
    lines = f"M48 P{len(SINGLE)}\nM48 Z-Probe Repeatability Test\n"
    if verbose:
        count = len(SINGLE)
        rows = enumerate(SINGLE, start=1)
        lines += "".join(f"{k} of {count}: z: {v:.4f} Mean: 0.01\n" for k, v in rows)
    lines += f"Standard Deviation: {np.std(SINGLE):.6f}\n"
    study, _ = take("marlin", {"log": marlin_log(lines)}, tmp_path)
    right = 1e3 * np.std(SINGLE, ddof=1)
    assert noise(study)["height_um"] == pytest.approx(right, abs=2e-3)


def test_samples_of_klipper_s_console_give_the_noise_of_a_saved_height(tmp_path):
    """A saved height is the mean of the probe's samples."""
    rng = np.random.default_rng(3)
    firmware = Klipper(example(125, 250, 300) + "[probe]\nsamples: 4\n")
    firmware.calibrate(REAL, Probe(sigma=SIGMA / 2.0), PLACES, rng)
    groups = 2.0 + SIGMA * rng.normal(size=(12, 4)).round(3)
    console = "".join(
        f"// probe at {x:.3f},{y:.3f} is z={v:.6f}\n"
        for (x, y), group in zip(PLACES, groups, strict=True)
        for v in group
    )
    files = {"printer.cfg": firmware.text(), "console.txt": console}
    study, imported = take("klipper", files, tmp_path)
    right = 1e3 * spread(groups)
    assert noise(study)["height_um"] == pytest.approx(right / 2.0, abs=1e-3)
    assert f"spread by {right:.3g} um, with 36 degrees of freedom" in said(imported)


def test_three_readings_are_too_few_for_a_noise(tmp_path):
    lines = "1 of 3: z: 0.011\n2 of 3: z: 0.015\n3 of 3: z: 0.010\n"
    study, imported = take("marlin", {"log": marlin_log(lines)}, tmp_path)
    assert noise(study)["assumed"]
    assert "with 2 degrees of freedom, too few to stand for the noise" in said(imported)
