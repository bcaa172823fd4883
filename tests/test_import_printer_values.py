"""Printers whose files have words that bend the fit where they are not understood.

The right values come from least squares over the oracle's firmware, which shares no code
with the importers; logs and configurations have invented numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from oracles.delta_firmware import Delta, Marlin, RepRapFirmware, commands, delta, touch
from scipy.optimize import least_squares

import oed
from oed import units
from pkm_studies.cli import main
from pkm_studies.errors import InputError
from pkm_studies.importers import session
from pkm_studies.importers.base import ImportedSession
from pkm_studies.result_folder import load_result

PLAIN = "\n[posterior]\nenabled = false\n[report]\nhtml = false\npdf = false\n"
NAMES = ("radius", "angle1", "angle2", "endstop1", "endstop2", "endstop3")


def write(folder: Path, files: dict[str, str]) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text)
    return [folder / name for name in files]


def take(
    kind: str, files: dict[str, str], folder: Path
) -> tuple[Path, ImportedSession]:
    """The study of an import, without samples and report."""
    paths = write(folder, files)
    study, imported = session.import_files(kind, paths, folder / "study", name="p")
    study.write_text(study.read_text() + PLAIN)
    return study, imported


def fitted(study: Path) -> dict[str, float]:
    """Fitted numbers in mm and deg."""
    section = oed.identify(oed.read_readings(oed.load_study(study))).section
    return {
        name: float(units.to_si(e.value, e.unit))
        / (units.DEG if name.startswith("angle") else 1e-3)
        for name, e in section.parameters.items()
    }


def least_squares_fit(
    travels: Sequence[np.ndarray],
    rod: float,
    start: Sequence[float],
    height: Callable[[np.ndarray], float] = lambda tool: tool[2],
    trim: Sequence[float] = (0.0, 0.0, 0.0),
) -> dict[str, float]:
    """Radius, two angles and endstops for which the tool is on the bed at all contacts."""

    def printer(p: np.ndarray) -> Delta:
        return delta(p[0] + np.asarray(trim), rod, [p[1], p[2], 90.0], p[3:])

    def misses(p: np.ndarray) -> list[float]:
        real = printer(p)
        return [height(real.tool(travel)) for travel in travels]

    return dict(zip(NAMES, least_squares(misses, start, x_scale=1e-3).x, strict=True))


def compensate(study: Path, kind: str, *options: str) -> str:
    """The text that a study's result gives for a firmware."""
    folder = study.parent
    assert main(["run", str(study), "--out", str(folder / "r"), "--quiet"]) == 0
    out = folder / f"export{len(list(folder.glob('export*')))}"
    call = ["compensate", str(folder / "r"), "--to", kind, "--out", str(out), *options]
    assert main(call) == 0
    return out.read_text()


# -- Marlin ----------------------------------------------------------------------------

OLD_LOG = """\
Recv: echo:Endstop adjustment:
Recv: echo:  M666 X-0.45 Y0.00 Z-0.90
Recv: echo:Delta settings: L<diagonal_rod> R<radius> H<height> B<calibration radius>
Recv: echo:  M665 L217.00 R97.89 H336.70 S100.00 B70.00 X-0.11 Y1.10 Z0.00
Recv: Bed X: 0.00 Y: 0.00 Z: -0.02
Recv: Bed X: -60.62 Y: -35.00 Z: 0.12
Recv: Bed X: 60.62 Y: -35.00 Z: 0.04
Recv: Bed X: 0.00 Y: 70.00 Z: 0.03
Recv: Bed X: 60.62 Y: 35.00 Z: -0.01
Recv: Bed X: -60.62 Y: 35.00 Z: 0.07
Recv: Bed X: -0.00 Y: -70.00 Z: 0.13
Recv: Bed X: -30.31 Y: -17.50 Z: 0.04
Recv: Bed X: 30.31 Y: -17.50 Z: -0.00
Recv: Bed X: 0.00 Y: 35.00 Z: -0.02
"""
RC_LOG = """\
echo:Endstop adjustment (mm):
echo:  M666 X0.00 Y-0.30 Z-0.10
echo:Delta settings: L=diagonal_rod, R=radius, S=segments_per_second, ABC=diagonal_rod_trim_tower_[123]
echo:  M665 L230.00 R110.00 S60.00 A0.00 B0.00 C0.20
echo:Home offset (mm):
echo:  M206 X0.00 Y0.00 Z-0.80
Bed X: 0.00 Y: 0.00 Z: 0.02
Bed X: -60.62 Y: -35.00 Z: -0.11
Bed X: 60.62 Y: -35.00 Z: 0.13
Bed X: 0.00 Y: 70.00 Z: 0.21
"""


def test_a_calibration_radius_is_no_trim_of_a_rod(tmp_path: Path) -> None:
    study, imported = take("marlin", {"log": OLD_LOG}, tmp_path)
    nominal = oed.load_study(study).machine.nominal
    assert [nominal[f"arm{i}_mm"] for i in (1, 2, 3)] == [217.0] * 3
    assert any("B70.00 is the radius of calibration" in s for s in imported.statements)
    value = fitted(study)
    # by scipy over an independent delta: radius 98.180, endstops 337.099, 336.749, 337.650
    assert value["radius"] == pytest.approx(98.180, abs=5e-3)
    stops = [value[f"endstop{i}"] for i in (1, 2, 3)]
    assert stops == pytest.approx([337.099, 336.749, 337.650], abs=5e-3)
    text = compensate(study, "marlin")
    assert "for Marlin 1.1.1 to 2.0.5" in text
    (geometry,) = [w for name, w in commands(text) if name == "M665"]
    assert not {"A", "B", "C"} & set(geometry)


@pytest.mark.parametrize(
    ("lines", "meaning", "arm2"),
    [
        ("M665 B0.25\nfirmware_version = 2.0.5\n", "calibration radius", 250.0),
        ("M665 B0.25\nfirmware_version = 2.0.6\n", "rod trim", 250.25),
        ("M665 B0.25\nFIRMWARE_NAME:Marlin 1.1.9\n", "calibration radius", 250.0),
        ("M665 B70\n", "calibration radius", 250.0),
        ("M665 A0 B0.25 C0\n", "rod trim", 250.25),
    ],
)
def test_what_b_is(lines: str, meaning: str, arm2: float, tmp_path: Path) -> None:
    log = f"M665 L250 R125 H300\nM666 X0 Y0 Z0\n{lines}{OLD_LOG.split('Z0.00', 1)[1]}"
    study, _ = take("marlin", {"log": log}, tmp_path)
    loaded = oed.load_study(study)
    assert loaded.machine.nominal["arm2_mm"] == arm2
    assert loaded.controller is not None
    assert loaded.controller.m665_b == meaning


def test_a_b_that_could_be_either_is_asked_for(tmp_path: Path) -> None:
    log = "M665 L250 R125 H300 B0.25\nM666 X0 Y0 Z0\nBed X: 0 Y: 0 Z: 0.1\n"
    with pytest.raises(InputError, match=r"line 1, M665 B.*firmware_version = 2\.0\.5"):
        take("marlin", {"log": log}, tmp_path)


def test_a_printer_without_home_height_says_what_to_give(tmp_path: Path) -> None:
    with pytest.raises(InputError) as raised:
        take("marlin", {"log": RC_LOG}, tmp_path)
    for words in ("home_height_mm = 250", "MANUAL_Z_HOME_POS", "M206 Z is added"):
        assert words in str(raised.value)
    study, _ = take("marlin", {"log": RC_LOG + "home_height_mm = 250\n"}, tmp_path)
    nominal = oed.load_study(study).machine.nominal
    # 250 - 0.8, and the switches above it by the adjustments
    stops = [nominal[f"endstop{i}_mm"] for i in (1, 2, 3)]
    assert stops == pytest.approx([249.2, 249.5, 249.3])
    assert nominal["arm3_mm"] == 230.2
    with pytest.raises(InputError, match="did you mean home_height_mm"):
        take("marlin", {"log": RC_LOG + "home_heigth_mm = 250\n"}, tmp_path / "b")
    moved = RC_LOG.replace("M206 X0.00", "M206 X1.50") + "home_height_mm = 250\n"
    with pytest.raises(InputError, match=r"M206 X.*home is off the middle"):
        take("marlin", {"log": moved}, tmp_path / "c")


def test_a_printer_without_home_height_is_not_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its M665 has no H, unless it has a newer firmware by now."""
    log = RC_LOG + "home_height_mm = 250\n" + OLD_LOG.partition("Z0.00\nRecv: Bed")[2]
    study, _ = take("marlin", {"log": log}, tmp_path)
    result = str(tmp_path / "r")
    main(["run", str(study), "--out", result, "--quiet"])
    call = ["compensate", result, "--to", "marlin", "--force"]
    assert main(call) == 2
    assert "Marlin 1.1.0 or earlier has no M665 H" in capsys.readouterr().err
    assert main([*call, "--firmware", "2.0.6"]) == 0


def g33_log(real: Delta) -> str:
    """A calibrating G33 of two iterations, at radius 80."""
    firmware = Marlin("2.1.2")
    firmware.execute("M665 L250 R125 H300\nM666 X0 Y0 Z0")
    angles = {"x": 210, "y": 330, "z": 90, "yz": 30, "zx": 150, "xy": 270}
    text = firmware.settings() + "G33 V2\nChecking... AC at radius:80.00\n"
    changes = ["", "M665 H299.60 R125.40 X0.20 Y-0.15\nM666 X-0.20 Y0 Z-0.40"]
    for change in changes:
        firmware.execute(change)
        a, m = firmware.adjust, firmware.m
        text += (
            f".Height:{m['H']:.2f}    Ex:{a['X']:+.2f}  Ey:{a['Y']:+.2f}  Ez:{a['Z']:+.2f}"
            f"    Radius:{m['R']:.2f}\n.Tower angle :    Tx:{m['X']:+.2f}"
            f"  Ty:{m['Y']:+.2f}  Tz:{m['Z']:+.2f}\n"
        )
        z = {"c": touch(firmware.travel, real, 0.0, 0.0)}
        for name, angle in angles.items():
            x, y = 80 * np.cos(np.radians(angle)), 80 * np.sin(np.radians(angle))
            z[name] = touch(firmware.travel, real, x, y)
        text += f".      c:{z['c']:+.6f}     x:{z['x']:+.6f}   y:{z['y']:+.6f}"
        text += (
            f"   z:{z['z']:+.6f}\n.             yz:{z['yz']:+.6f}  zx:{z['zx']:+.6f}"
        )
        text += f"  xy:{z['xy']:+.6f}\n"
    return text


def test_heights_of_g33_belong_to_the_geometry_that_it_had_set(tmp_path: Path) -> None:
    """M503 above a calibrating G33 prints what its second iteration no longer has."""
    real = delta(125.63, 250.0, [210.31, 329.74, 90.0], [300.42, 299.71, 300.13])
    study, imported = take("marlin", {"log": g33_log(real)}, tmp_path)
    assert oed.load_study(study).machine.nominal["radius_mm"] == 125.4
    assert "Not read: 1 earlier reports of G33." in imported.statements
    value = fitted(study)
    assert value["radius"] == pytest.approx(125.63, abs=5e-3)
    stops = [value[f"endstop{i}"] for i in (1, 2, 3)]
    assert stops == pytest.approx(list(real.endstop), abs=5e-3)


def test_points_of_another_geometry_are_left_out(tmp_path: Path) -> None:
    firmware = Marlin("2.1.2")
    real = delta(125.63, 250.0, [210.31, 329.74, 90.0], [300.42, 299.71, 300.13])
    places = [(80 * np.cos(a), 80 * np.sin(a)) for a in np.arange(0, 6.3, 0.7)]
    rng, log = np.random.default_rng(0), ""
    for radius in (125.0, 125.5):
        firmware.execute(f"M665 L250 R{radius} H300\nM666 X0 Y0 Z0")
        log += firmware.settings() + firmware.probe_all(real, places, 0.0, rng)
    study, imported = take("marlin", {"log": log}, tmp_path)
    assert oed.load_study(study).machine.nominal["radius_mm"] == 125.5
    assert len(imported.rows) == len(places)
    assert any(
        "9 points that were probed with another" in s for s in imported.statements
    )


def test_trims_of_the_radii_are_given_in_a_line_and_stay(tmp_path: Path) -> None:
    """The firmware has compiled trims: one radius is fitted, and written without them."""
    trim = np.array([0.35, 0.0, -0.2])
    firmware = delta(125.0 + trim, 250.0, [210.0, 330.0, 90.0], [300.0] * 3)
    real = delta(125.63 + trim, 250.0, [210.31, 329.74, 90.0], [300.42, 299.71, 300.13])
    places = [(0.0, 0.0)]
    places += [
        (r * np.cos(a), r * np.sin(a)) for r in (50, 95) for a in np.arange(0, 6, 0.5)
    ]
    log = "M665 L250.00 R125.00 H300.00 X0 Y0 Z0 A0 B0 C0\nM666 X0 Y0 Z0\n"
    log += "radius_trim_mm = 0.35, 0, -0.2\n"
    for x, y in places:
        z = touch(firmware.travel, real, x, y)
        log += f"Bed X: {x:.6f} Y: {y:.6f} Z: {z:.6f}\n"
    study, _ = take("marlin", {"log": log}, tmp_path)
    assert oed.load_study(study).machine.model == "delta"
    text = compensate(study, "marlin")
    assert "trims of the radii by tower stay in the firmware: 0.35, 0, -0.2 mm" in text
    printed = Marlin("2.1.2")
    printed.execute(text)
    got = printed.geometry()
    got.radius = got.radius + trim
    points = [(0, 0, 0), (80, 0, 0), (-50, 60, 0), (0, -85, 0), (40, 70, 20)]
    reached = np.array([real.tool(got.travel(p)) for p in points])
    assert np.abs(reached - points).max() < 0.01


# -- RepRapFirmware --------------------------------------------------------------------

RRF_CONFIG = """\
M574 X2 Y2 Z2 S1
M665 L241.987 R124.309 H260.519 B120 X0 Y0 Z0
M666 X0.73 Y0.06 Z-0.80
M558 P1 H5 F120
G31 X23 Y0 Z1.5 P500
"""
RRF_PLACES = (
    "0 80,69.28 40,69.28 -40,0 -80,-69.28 -40,-69.28 40,0 40,34.64 -20,-34.64 -20,0 0"
)
RRF_LOG = (
    "G32 bed probe heights: -0.152 -0.456 0.170 1.264 1.261 0.463 -0.047 0.186 0.764"
    " 0.256, mean 0.371, deviation from mean 0.545\n"
)
TILT_CONFIG = """\
M665 L260.0 R131.5 H210.0 B105.0 X-0.200 Y0.200 Z0.000
M666 X-1.36 Y1.11 Z0.25 A0.60 B-0.35
"""
TILT_PLACES = (
    "0 100,86.6 50,86.6 -50,0 -100,-86.6 -50,-86.6 50,0 50,43.3 -25,-43.3 -25,0 0"
)
TILT_LOG = "G32 bed probe heights: 0.071 0.092 0.094 0.061 0.029 0.044 0.015 0.028 -0.007 -0.007\n"


def bed_file(places: str) -> str:
    lines = [place.split() for place in places.split(",")]
    return "".join(f"G30 P{k} X{x} Y{y} Z-99999\n" for k, (x, y) in enumerate(lines))


def contacts(
    config: str, places: str, log: str
) -> tuple[RepRapFirmware, list[np.ndarray]]:
    """The firmware, and the carriages' travels at its contacts."""
    firmware = RepRapFirmware()
    firmware.execute(config)
    heights = [float(v) for v in log.split(": ")[1].split(",")[0].split()]
    at = [
        np.array(place.split(), float) - firmware.probe for place in places.split(",")
    ]
    pairs = zip(at, heights, strict=True)
    return firmware, [firmware.travel((*place, z)) for place, z in pairs]


def test_a_probe_beside_the_nozzle_touches_where_the_nozzle_is_not(
    tmp_path: Path,
) -> None:
    files = {"config.g": RRF_CONFIG, "bed.g": bed_file(RRF_PLACES), "log.txt": RRF_LOG}
    study, imported = take("rrf", files, tmp_path)
    assert [float(imported.rows[1][f"{k}_mm"]) for k in "xy"] == pytest.approx(
        [46.28, 40]
    )
    value = fitted(study)
    _, travels = contacts(RRF_CONFIG, RRF_PLACES, RRF_LOG)
    wanted = least_squares_fit(travels, 241.987, [124.3, 210, 330, 260, 260, 260])
    assert wanted["radius"] == pytest.approx(125.109, abs=1e-3)
    for name in NAMES:
        assert value[name] == pytest.approx(wanted[name], abs=0.02), name
    text = compensate(study, "rrf")
    printed = RepRapFirmware()
    printed.execute(text)
    real = delta(
        wanted["radius"], 241.987, [wanted["angle1"], wanted["angle2"], 90.0],
        [wanted[f"endstop{i}"] for i in (1, 2, 3)],
    )  # fmt: skip
    grid = [(x, y, 0.0) for x in (-70, 0, 70) for y in (-70, 0, 70)]
    bed = [real.tool(printed.travel(point))[2] for point in grid]
    assert np.ptp(bed) < 0.01
    assert printed.bed == 120.0


def test_the_tilt_of_the_bed_is_read_used_and_written_back(tmp_path: Path) -> None:
    files = {
        "config.g": TILT_CONFIG,
        "bed.g": bed_file(TILT_PLACES),
        "log.txt": TILT_LOG,
    }
    study, imported = take("rrf", files, tmp_path)
    assert any("M666 A and B raise z by 0.6 % of x" in s for s in imported.statements)
    value = fitted(study)
    firmware, travels = contacts(TILT_CONFIG, TILT_PLACES, TILT_LOG)
    lean = firmware.tilt
    wanted = least_squares_fit(
        travels,
        260.0,
        [131.5, 209.8, 330.2, 208.6, 211.1, 210.2],
        lambda tool: tool[2] - lean @ tool[:2],
    )
    for name in NAMES:
        assert value[name] == pytest.approx(wanted[name], abs=0.01), name
    text = compensate(study, "rrf")
    assert " A0.60 B-0.35\n" in text
    printed = RepRapFirmware()
    printed.execute(text)
    real = delta(
        wanted["radius"], 260.0, [wanted["angle1"], wanted["angle2"], 90.0],
        [wanted[f"endstop{i}"] for i in (1, 2, 3)],
    )  # fmt: skip
    grid = [(x, y, 0.0) for x in (-80, 0, 80) for y in (-80, 0, 80)]
    tools = np.array([real.tool(printed.travel(point)) for point in grid])
    assert np.ptp(tools[:, 2] - tools[:, :2] @ lean) < 0.005


def test_answers_and_stored_settings_of_rrf_count(tmp_path: Path) -> None:
    """config-override.g wins over config.g in any order, and the log's answers over both."""
    stored = (
        "M665 L242.5 R124.5 H260.519 B120 X0 Y0 Z0\nM666 X0.1 Y0 Z-0.1 A0.00 B0.00\n"
    )
    answers = (
        "Diagonals 243.000:243.000:243.000, delta radius 124.700, homed height 260.600, bed"
        " radius 120.0, X 0.100°, Y 0.200°, Z 0.000°\n"
        "Endstop adjustments X0.20 Y0.10 Z-0.30, tilt X0.10% Y0.00%\n"
    )
    base = {"bed.g": bed_file(RRF_PLACES), "log.txt": RRF_LOG}
    files = {"config-override.g": stored, "config.g": RRF_CONFIG, **base}
    study, _ = take("rrf", files, tmp_path / "a")
    assert oed.load_study(study).machine.nominal["radius_mm"] == 124.5
    files["log.txt"] = answers + RRF_LOG
    study, _ = take("rrf", files, tmp_path / "b")
    nominal = oed.load_study(study).machine.nominal
    assert nominal["radius_mm"] == 124.7
    assert nominal["arm2_mm"] == 243.0
    assert nominal["endstop1_mm"] == pytest.approx(260.8)
    assert nominal["angle2_deg"] == pytest.approx(330.2)
    assert "bed_slope_x_ppm = 1000.0" in study.read_text()
    files["log.txt"] = (
        "Z probe 0: current reading 0, threshold 500, trigger height 1.500, offsets X12.0"
        f" Y-3.0\n{RRF_LOG}"
    )
    _, imported = take("rrf", files, tmp_path / "c")
    assert float(imported.rows[0]["x_mm"]) == -12.0
    assert float(imported.rows[0]["y_mm"]) == 83.0


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        (
            "log.txt",
            "G32 bed",
            "Calibrated 6 factors using 10 points\nG32 bed",
            "config-override",
        ),
        ("bed.g", "G30 P3 X0 ", "G30 P3 ", "G30 X.*point 3 has no X"),
        ("log.txt", "0.764", "probing failed", "a point was not probed"),
        (
            "config.g",
            "G31 X23 Y0",
            "G31 T1 X9 Y0\nG31 T4 X23 Y0",
            "probe_offset_mm = x, y",
        ),
        ("config.g", "M558", "M669 K0\nM558", "this is no linear delta"),
        ("config.g", "L241.987", "L241.987:242:242:200", "not one or three"),
    ],
)
def test_files_of_rrf_that_mislead_are_refused(
    name: str, old: str, new: str, words: str, tmp_path: Path
) -> None:
    files = {"config.g": RRF_CONFIG, "bed.g": bed_file(RRF_PLACES), "log.txt": RRF_LOG}
    assert old in files[name]
    files[name] = files[name].replace(old, new)
    with pytest.raises(InputError, match=words):
        take("rrf", files, tmp_path)


def test_a_height_that_was_typed_is_that_of_the_nozzle(tmp_path: Path) -> None:
    bed = bed_file(RRF_PLACES).replace("G30 P9 X0 Y0 Z-99999", "G30 P9 X0 Y0 Z0.256")
    files = {"config.g": RRF_CONFIG, "bed.g": bed, "log.txt": RRF_LOG}
    _, imported = take("rrf", files, tmp_path)
    assert float(imported.rows[9]["x_mm"]) == 0.0
    assert float(imported.rows[0]["x_mm"]) == -23.0


# -- Klipper ---------------------------------------------------------------------------


def klipper(points: dict[str, Sequence[float]], lengths: dict[str, float]) -> str:
    """A configuration with saved positions, in steps of 12.5 um, and their readings."""
    towers = "".join(
        f"[stepper_{t}]\nmicrosteps: 16\nrotation_distance: 40\narm_length: 236\n"
        f"position_endstop: 240.0\nangle: {a}\n"
        for t, a in zip("abc", (210, 330, 90), strict=True)
    )
    lines = [f"{k}: {v}" for k, v in lengths.items()]
    lines += [f"{k}: {','.join(f'{s:.3f}' for s in v)}" for k, v in points.items()]
    head = "[printer]\nkinematics: delta\ndelta_radius: 117.5\n"
    return head + towers + "[delta_calibrate]\nradius: 70\n" + "\n".join(lines) + "\n"


def saved_positions() -> tuple[dict[str, Sequence[float]], dict[str, float]]:
    firmware = delta(117.5, 236.0, [210.0, 330.0, 90.0], [240.0] * 3)
    points: dict[str, Sequence[float]] = {}
    values: dict[str, float] = {}
    for k, angle in enumerate([0.0, *np.arange(0, 6.2, np.pi / 3)]):
        r = 65.0 if k else 0.0
        place = (r * np.cos(angle), r * np.sin(angle), 0.05 * k)
        points[f"height{k}_pos"] = firmware.travel(place) / 0.0125
        values[f"height{k}"] = 0.0
        if k:
            points[f"distance{k - 1}_pos1"] = firmware.travel((0, 0, 0)) / 0.0125
            points[f"distance{k - 1}_pos2"] = firmware.travel((*place[:2], 0)) / 0.0125
            values[f"distance{k - 1}"] = 65.0 + 0.01 * k
    return points, values


@pytest.mark.parametrize(
    ("factor", "words"), [(2.0, "below.*2 times"), (0.5, "above.*0.5 times")]
)
@pytest.mark.parametrize("stale", ["distance", "height"])
def test_positions_saved_with_other_steps_are_named_at_import(
    stale: str, factor: float, words: str, tmp_path: Path
) -> None:
    points, values = saved_positions()
    take("klipper", {"a.cfg": klipper(points, values)}, tmp_path / "good")
    for key, steps in points.items():
        if key.startswith(stale):
            points[key] = factor * np.asarray(steps)
    text = klipper(points, values)
    first = f"{stale}0_pos1" if stale == "distance" else "height0_pos"
    line = next(
        k for k, v in enumerate(text.splitlines(), 1) if v.startswith(f"{first}:")
    )
    with pytest.raises(InputError, match=rf"line {line}, .*{first}.*{words}"):
        take("klipper", {"a.cfg": text}, tmp_path)


def test_towers_at_one_angle_are_no_traceback(tmp_path: Path) -> None:
    text = klipper(*saved_positions()).replace("angle: 330", "angle: 210")
    with pytest.raises(InputError, match="the arms cannot reach this position"):
        take("klipper", {"a.cfg": text}, tmp_path)


# -- readings that an importer wrote itself ---------------------------------------------


@pytest.mark.parametrize(
    "count", [9, pytest.param(50, marks=pytest.mark.slow)], ids=["9", "50"]
)
def test_no_display_is_frozen_in_clean_imports(
    count: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Printers of all firmwares, two in five calibrated to the last digit."""
    rng = np.random.default_rng(3)
    for number in range(count):
        kind = ("rrf", "marlin", "klipper")[number % 3]
        error = 0.0 if number < 0.4 * count else 0.3
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
    places = [(0.0, 0.0)]
    places += [
        (r * np.cos(a), r * np.sin(a)) for r in (40, 80) for a in np.arange(0, 6, 1.05)
    ]
    places = np.round(places, 2)
    if kind == "marlin":
        firmware = Marlin("2.1.2")
        firmware.execute("M665 L250 R125 H300\nM666 X0 Y0 Z0")
        return {
            "log": firmware.settings() + firmware.probe_all(real, places, 0.01, rng)
        }
    if kind == "rrf":
        printer = RepRapFirmware()
        config = "M665 L250 R125 H300 B110 X0 Y0 Z0\nM666 X0 Y0 Z0\n"
        printer.execute(config)
        bed = bed_file(",".join(f"{x} {y}" for x, y in places))
        log = printer.probe_all(real, places, 0.01, rng)
        return {"config.g": config, "bed.g": bed, "log.txt": log}
    towers = "".join(
        f"[stepper_{t}]\nstep_distance: 0.01\narm_length: 250\nposition_endstop: 300\n"
        for t in "abc"
    )
    lines = [
        "[printer]\nkinematics: delta\ndelta_radius: 125",
        towers,
        "[delta_calibrate]",
    ]
    for k, (x, y) in enumerate(places):
        # two probes with different offsets: groups of equal readings
        height = 0.0 if k % 2 else 1.5
        steps = real.travel((x, y, height + 0.01 * rng.normal())) / 0.01
        lines.append(f"height{k}: {height}\nheight{k}_pos: {','.join(map(str, steps))}")
    return {"printer.cfg": "\n".join(lines) + "\nradius: 80\n"}


def test_an_assumed_noise_is_said_first(tmp_path: Path) -> None:
    """Where few readings cannot test it; and not where many estimate it."""
    real = delta(125.4, 250.0, [210.3, 329.8, 90.0], [300.2, 299.9, 300.1])
    rng = np.random.default_rng(0)
    firmware = Marlin("2.1.2")
    firmware.execute("M665 L250 R125 H300\nM666 X0 Y0 Z0")
    for count, said in ((7, True), (40, False)):
        angle, radius = 2.4 * np.arange(count), 90 * np.sqrt(np.arange(count) / count)
        places = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        log = firmware.settings() + firmware.probe_all(real, places, 0.1, rng)
        study, _ = take("marlin", {"log": log}, tmp_path / str(count))
        out = tmp_path / str(count) / "r"
        if said:
            study.write_text(study.read_text().replace("html = false", "html = true"))
        assert main(["run", str(study), "--out", str(out), "--quiet"]) == 0
        headline = load_result(out).headline
        sentence = "The noise of the readings (height 100 um) is an assumption"
        assert headline[0].startswith(sentence) == said
    page = (tmp_path / "7" / "r" / "report.html").read_text("utf-8")
    assert "is an assumption" in page.split('id="warnings"')[1][:1000]


def test_a_display_that_is_frozen_is_still_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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
