"""Readings of printers: the noise that nobody measured, repeated and equal readings."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from oracles.firmware import marlin, rrf
from oracles.firmware.geometry import Delta, Probe, delta, spiral
from oracles.firmware.klipper import Klipper, example

from pkm_studies.commands import main
from pkm_studies.results import load_result
from printers.delta_printer import said, take

SETTINGS = "M665 L250 R125 H300\nM666 X-0.2 Y-0.2 Z-0.2"


def marlin_log(real: Delta, sigma: float, count: int, seed: int) -> str:
    firmware = marlin.Marlin(SETTINGS)
    rng = np.random.default_rng(seed)
    heights = firmware.g30(real, Probe(sigma=sigma), spiral(count, 90.0), rng, digits=3)
    return firmware.m115() + firmware.m503() + heights


# -- an assumed noise ------------------------------------------------------------------
@pytest.mark.parametrize(
    ("sigma", "count"), [(0.01, 18), (0.3, 18), (0.01, 10), (0.02, 60)]
)
def test_an_assumed_noise_follows_the_readings(sigma, count, tmp_path):
    """Independent readings: their scatter is estimated, and nothing that a run carries.

    The importer assumes 100 um. The predicted error follows the estimate.
    """
    real = delta(125.4, 250.0, [210.3, 329.8, 90.0], [300.2, 299.9, 300.1])
    log = marlin_log(real, sigma, count, seed=3)
    study, _ = take("marlin", {"log": log}, tmp_path)
    main(["run", str(study), "--out", str(tmp_path / "r"), "--quiet"])
    result = load_result(tmp_path / "r")
    assert set(result.goodness.noise) == {"reading probe.height"}
    record = result.goodness.noise["reading probe.height"]
    assert record.stated == 100.0
    # a scatter of so many degrees of freedom
    spread = 3.0 / np.sqrt(2.0 * (count - 6))
    assert abs(np.log(record.value / (1000.0 * sigma))) < 1.5 * spread
    z = result.prediction.components["z"].after
    assert 0.2 < z.rms / record.value < 2.0


def test_an_assumed_noise_that_is_stated_too_carries_what_is_stated(tmp_path):
    real = delta(125.4, 250.0, [210.3, 329.8, 90.0], [300.2, 299.9, 300.1])
    study, _ = take("marlin", {"log": marlin_log(real, 0.02, 40, 1)}, tmp_path)
    text = study.read_text()
    study.write_text(text.replace("assumed = true", "assumed = true\ncarried = 0.3"))
    main(["run", str(study), "--out", str(tmp_path / "r"), "--quiet"])
    result = load_result(tmp_path / "r")
    assert "carried" in result.goodness.noise


def test_an_assumed_noise_is_said_first(tmp_path):
    """Where few readings cannot test it; and not where many estimate it."""
    real = delta(125.4, 250.0, [210.3, 329.8, 90.0], [300.2, 299.9, 300.1])
    for count, is_said in ((7, True), (40, False)):
        folder = tmp_path / str(count)
        study, _ = take("marlin", {"log": marlin_log(real, 0.1, count, 0)}, folder)
        if is_said:
            study.write_text(study.read_text().replace("html = false", "html = true"))
        assert main(["run", str(study), "--out", str(folder / "r"), "--quiet"]) == 0
        headline = load_result(folder / "r").headline
        sentence = "The noise of the readings (height 100 um) is an assumption"
        assert headline[0].startswith(sentence) == is_said
    page = (tmp_path / "7" / "r" / "report.html").read_text("utf-8")
    assert "is an assumption" in page.split('id="short"')[1][:1000]


# -- readings that an importer wrote itself ---------------------------------------------
def test_no_display_is_frozen_in_clean_imports(tmp_path, capsys):
    """Printers of all firmwares, two of three calibrated to the last digit."""
    rng = np.random.default_rng(3)
    for number, kind in enumerate(("rrf", "marlin", "klipper")):
        error = 0.0 if number < 2 else 0.3
        real = delta(
            125.0 + error * rng.normal(),
            250.0,
            [210.0 + error * rng.normal(), 330.0, 90.0],
            300.0 + error * rng.normal(size=3),
        )
        files = clean_files(kind, real, rng)
        study, _ = take(kind, files, tmp_path / str(number))
        capsys.readouterr()
        assert main(["check", str(study)]) == 0
        said = capsys.readouterr().out.splitlines()
        assert not [line for line in said if line.startswith(" ")], (kind, said)


def clean_files(kind: str, real: Delta, rng: np.random.Generator) -> dict[str, str]:
    places, probe = spiral(13, 80.0), Probe(sigma=0.01)
    if kind == "marlin":
        firmware = marlin.Marlin(SETTINGS)
        log = firmware.m115() + firmware.m503()
        return {"log": log + firmware.g30(real, probe, places, rng)}
    if kind == "rrf":
        config = "M665 L250 R125 H300 B110 X0 Y0 Z0\nM666 X0 Y0 Z0\nG31 X0 Y0 Z0\n"
        bed = rrf.bed_file(places)
        log = rrf.RepRapFirmware(config).g32(bed, real, probe, rng)
        return {"config.g": config, "bed.g": bed, "log.txt": log}
    printer = Klipper(example(125, 250, 300))
    printer.calibrate(real, probe, places, rng)
    section = printer.saved["delta_calibrate"]
    # two probes with different offsets: groups of equal readings
    for k in range(0, len(places), 2):
        point = [*places[k], 1.5 + probe.sigma * rng.normal()]
        section[f"height{k}"] = "1.5"
        steps = real.travel([point])[0] / printer.step
        section[f"height{k}_pos"] = ",".join(f"{v:.3f}" for v in steps)
    return {"printer.cfg": printer.text()}


def test_a_display_that_is_frozen_is_still_named(tmp_path, capsys):
    """Heights that were read at commanded places, and do not change."""
    study = tmp_path / "a.study.toml"
    study.write_text(
        'schema = 1\nname = "a"\n[machine]\nmodel = "linear_delta"\n[[setup]]\n'
        'name = "s"\ninstrument = "height_probe"\n[readings]\nfiles = ["a.csv"]\n'
    )
    rows = [
        f"s,1,{k},{10 * (k % 5)},{5 * k},{1 + 0.2 * k:.1f},{1.02 + 0.2 * min(k, 6):.4f}"
        for k in range(12)
    ]
    header = "setup,run,order,x_mm,y_mm,z_mm,height_mm"
    (tmp_path / "a.csv").write_text("\n".join([header, *rows, ""]))
    main(["check", str(study)])
    assert "a frozen display?" in "".join(capsys.readouterr())


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


def marlin_log_of(lines: str) -> str:
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
    study, _ = take("marlin", {"log": marlin_log_of(lines)}, tmp_path)
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
    study, imported = take("marlin", {"log": marlin_log_of(lines)}, tmp_path)
    assert noise(study)["assumed"]
    assert "with 2 degrees of freedom, too few to stand for the noise" in said(imported)
