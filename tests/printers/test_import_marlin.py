"""`oed import marlin`: what each version of the firmware does with its words.

The right values come from least squares over the oracle's delta, which shares no code
with the importer; logs have invented numbers.
"""

from pathlib import Path

import numpy as np
import pytest
from oracles.firmware import fit, marlin, marlin_g33, rrf
from oracles.firmware.geometry import Delta, Probe, contact, delta, spiral

import oed
from pkm_studies.base import InputError
from pkm_studies.commands import main
from printers import delta_printer
from printers.delta_printer import compensate, endstops, fitted, nominal, said, take

REAL = delta(125.63, 250.0, [210.31, 329.74, 90.0], [300.42, 299.71, 300.13])
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
BED = OLD_LOG.partition("Z0.00\n")[2]
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
NEW = "FIRMWARE_NAME:Marlin 2.1.2 (Github)\nM92 X80.00 Y80.00 Z80.00\n"
NEW += "M665 L250 R125 H300 A0 B0 C0\n"


# -- B of M665 -------------------------------------------------------------------------
def test_a_calibration_radius_is_no_trim_of_a_rod(tmp_path):
    study, imported = take("marlin", {"log": OLD_LOG}, tmp_path)
    assert [nominal(study)[f"arm{i}_mm"] for i in (1, 2, 3)] == [217.0] * 3
    assert "B70.00 is the radius of calibration" in said(imported)
    value = fitted(study)
    # by scipy over an independent delta: radius 98.180, endstops 337.099, 336.749, 337.650
    assert value["radius"] == pytest.approx(98.180, abs=5e-3)
    stops = [value[f"endstop{i}"] for i in (1, 2, 3)]
    assert stops == pytest.approx([337.099, 336.749, 337.650], abs=5e-3)
    text = compensate(study, "marlin")
    assert "for Marlin 1.1.0 to 1.1.9" in text
    (geometry,) = [words for name, words in rrf.gcode(text) if name == "M665"]
    assert not {"A", "B", "C"} & set(geometry)


@pytest.mark.parametrize(("lines", "meaning", "arm2"), [
    ("M665 B0.25\nfirmware_version = 1.1.9\n", "calibration radius", 250.0),
    ("M665 B0.25\nfirmware_version = 2.0.5\n", "not read", 250.0),
    ("M665 B0.25\nfirmware_version = 2.0.6\n", "rod trim", 250.25),
    ("M665 B0.25\nFIRMWARE_NAME:Marlin 1.1.0 (Github)\n", "calibration radius", 250),
    ("M665 B0.25\nFIRMWARE_NAME:Marlin 1.1.0-RC8 (Github)\n", "rod trim", 250.25),
    ("M665 B70\n", "calibration radius", 250.0),
    ("M665 A0 B0.25 C0\n", "rod trim", 250.25),
])  # fmt: skip
def test_what_b_is(lines, meaning, arm2, tmp_path):
    log = f"M665 L250 R125 H300\nM666 X0 Y0 Z0\n{lines}home_height_mm = 300\n{BED}"
    if "RC8" in lines:
        log = log.replace(" H300", "")
    study, _ = take("marlin", {"log": log}, tmp_path)
    assert nominal(study)["arm2_mm"] == arm2
    controller = oed.load_study(study).controller
    assert controller.m665_b == meaning


def test_a_version_that_does_not_read_b_says_so(tmp_path):
    """M665 B70 of a user changes nothing there: neither a rod nor the radius of G33."""
    log = marlin.Marlin205("M665 L250 R125 H300\nM666 X0 Y0 Z0")
    text = log.m115() + log.m503() + "Send: M665 B70\n"
    study, imported = take("marlin", {"log": text + BED}, tmp_path)
    assert "M665 B70 changes nothing: Marlin 2.0.0 to 2.0.5" in said(imported)
    assert nominal(study)["arm2_mm"] == 250.0
    report = marlin_g33.g33(log, REAL, Probe(), 80.0, "P3 V0").replace(
        "at radius:80.00", ""
    )
    with pytest.raises(InputError, match="probe_radius_mm = 80"):
        take("marlin", {"log": text + report}, tmp_path / "g33")


def test_a_b_that_could_be_any_is_asked_for(tmp_path):
    log = "M665 L250 R125 H300 B0.25\nM666 X0 Y0 Z0\nBed X: 0 Y: 0 Z: 0.1\n"
    with pytest.raises(InputError, match=r"line 1, M665 B.*firmware_version = 2\.1\.2"):
        take("marlin", {"log": log}, tmp_path)


# -- M666 ------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("version", "wanted"),
    [
        # up to 2.0.5 any value lowers the tower; later only one of more than six steps
        ("1.1.0", [300.07, 300.0, 300.3]),
        ("2.1.2", [300.0, 300.0, 300.3]),
    ],
)
def test_a_small_value_makes_no_move_in_later_versions(version, wanted, tmp_path):
    log = f"FIRMWARE_NAME:Marlin {version} (Github)\nM92 X80 Y80 Z80\nM665 L250 R125 H300\n"
    log += "M666 X-0.07 Y0 Z-0.30\nM851 Z0\n" + BED
    study, imported = take("marlin", {"log": log}, tmp_path)
    assert endstops(study) == pytest.approx(wanted)
    assert ("M666 X-0.07 counts as 0" in said(imported)) == (version == "2.1.2")


@pytest.mark.parametrize(("old", "new", "remedy"), [
    ("M92 X80.00 Y80.00 Z80.00\n", "", "the line M92 X80 Y80 Z80"),
    (NEW, "M665 L250 R125 H300\n", "firmware_version = 2.1.2"),
])  # fmt: skip
def test_a_small_value_of_an_unknown_printer_is_asked_for(old, new, remedy, tmp_path):
    log = (NEW + "M666 X-0.30 Y-0.07 Z0\n" + BED).replace(old, new)
    with pytest.raises(InputError, match=rf"M666 Y.*{remedy}"):
        take("marlin", {"log": log}, tmp_path)


@pytest.mark.parametrize("version", marlin.VERSIONS, ids=lambda v: v.version)
def test_a_value_above_zero_does_what_the_version_does(version, tmp_path):
    """It is ignored, makes no move, or moves H; the oracle's switches are the right ones."""
    compiled = {} if version.has_height else {"home_height": 300.0}
    firmware = version("M665 L250 R125 H300\nM666 X-0.5 Y-0.4 Z-0.3", **compiled)
    log = firmware.m115() + firmware.m503()
    typed = "M666 X0.30 Y-0.20 Z-0.10\n"
    log += f"Send: {typed}echo:?M666 offsets must be <= 0\n"
    log += BED if version.has_height else BED + "home_height_mm = 300\n"
    study, _ = take("marlin", {"log": log}, tmp_path)
    firmware.apply(typed)
    # height of the nozzle with each carriage at its switch
    wanted = firmware.home() - np.sqrt(firmware.arms**2 - firmware.words["R"] ** 2)
    assert endstops(study) == pytest.approx(list(wanted))
    unknown = log.replace(f"Marlin {version.version}", "").replace(firmware.heading, "")
    if version.b_word == "none":
        with pytest.raises(InputError, match=r"M666 X.*firmware_version = 2\.1\.2"):
            take("marlin", {"log": unknown}, tmp_path / "unknown")


# -- home ------------------------------------------------------------------------------
@pytest.mark.parametrize("version", marlin.VERSIONS, ids=lambda v: v.version)
def test_home_is_where_the_version_has_it(version, tmp_path):
    """Contacts without noise: the fit finds the real switches, M851 Z and all."""
    compiled = {} if version.has_height else {"home_height": 300.0}
    firmware = version(
        "M665 L250 R125 H300 X0.1 Y-0.2 Z0.1\nM666 X-0.5 Y-0.4 Z-0.3\nM851 Z-2.5",
        **compiled,
    )
    log = firmware.m115() + firmware.m503()
    log += firmware.g30(REAL, Probe(z=2.5), spiral(24, 90.0), digits=5)
    log += "" if version.has_height else "home_height_mm = 300\n"
    study, _ = take("marlin", {"log": log}, tmp_path)
    delta_printer.with_known_noise(study, 1.0)
    value, angle3 = fitted(study), firmware.angles[2]
    start = delta(125.0, 250.0, firmware.angles, [300.0] * 3)
    places = spiral(24, 90.0)
    z = contact(firmware, REAL, Probe(z=2.5), places)
    wanted = fit.numbers(
        fit.fit(firmware.travel(np.column_stack([places, z])), start, 2.5)
    )
    assert nominal(study)["angle3_deg"] == pytest.approx(angle3)
    for name, number in wanted.items():
        assert value[name] == pytest.approx(number, abs=2e-3), name


def test_z_of_m665_turns_the_towers_of_some_versions(tmp_path):
    """Up to 1.1.5 it is taken off X and Y, later it is the third tower's angle."""
    log = "M665 L250 R125 H300 X0.3 Y-0.2\nM666 X0 Y0 Z0\nM665 Z0.5\n" + BED
    angles = {"1.1.5": [209.8, 329.3, 90.0], "1.1.8": [210.3, 329.8, 90.5]}
    for version, wanted in angles.items():
        text = f"firmware_version = {version}\n{log}"
        study, _ = take("marlin", {"log": text}, tmp_path / version)
        values = nominal(study)
        assert [values[f"angle{i}_deg"] for i in (1, 2, 3)] == pytest.approx(wanted)


def test_a_probe_that_moves_the_height_is_logged_once(tmp_path):
    log = "firmware_version = 1.1.5\nM851 Z-2.5\nM665 L250 R125 H300\nM666 X0 Y0 Z0\n"
    take("marlin", {"log": log + BED}, tmp_path / "a")
    with pytest.raises(InputError, match=r"M851 Z.*changes M665 H with M851 Z"):
        take("marlin", {"log": log + "M851 Z-2.2\n" + BED}, tmp_path / "b")


def test_a_printer_without_home_height_says_what_to_give(tmp_path):
    with pytest.raises(InputError) as raised:
        take("marlin", {"log": RC_LOG}, tmp_path)
    for words in ("home_height_mm = 250", "MANUAL_Z_HOME_POS", "M206 Z is added"):
        assert words in str(raised.value)
    study, _ = take("marlin", {"log": RC_LOG + "home_height_mm = 250\n"}, tmp_path)
    # 250 - 0.8, and the switches above it by the adjustments
    assert endstops(study) == pytest.approx([249.2, 249.5, 249.3])
    assert nominal(study)["arm3_mm"] == 230.2
    with pytest.raises(InputError, match="did you mean home_height_mm"):
        take("marlin", {"log": RC_LOG + "home_heigth_mm = 250\n"}, tmp_path / "b")
    moved = RC_LOG.replace("M206 X0.00", "M206 X1.50") + "home_height_mm = 250\n"
    with pytest.raises(InputError, match=r"M206 X.*home is off the middle"):
        take("marlin", {"log": moved}, tmp_path / "c")


def test_a_command_that_sets_one_number_lacks_the_others(tmp_path):
    """Not its home height first, which a version may not have."""
    log = "Send: M665 R124.5\nSend: M666 X0 Y0 Z0\n" + BED
    with pytest.raises(
        InputError, match=r"line 1, M665 L.*M665 has no L; give the full"
    ):
        take("marlin", {"log": log}, tmp_path)


def test_a_printer_without_home_height_is_not_written(tmp_path, capsys):
    """Its M665 has no H, unless it has a newer firmware by now."""
    log = RC_LOG + "home_height_mm = 250\n" + BED
    study, _ = take("marlin", {"log": log}, tmp_path)
    result = str(tmp_path / "r")
    main(["run", str(study), "--out", result, "--quiet"])
    call = ["compensate", result, "--to", "marlin", "--force"]
    assert main(call) == 2
    assert "Marlin 1.1.0-RC8 or earlier has no M665 H" in capsys.readouterr().err
    assert main([*call, "--firmware", "2.0.6"]) == 0


def test_a_height_that_is_not_known_stays_that_of_the_firmware(tmp_path):
    """Without version H may count to the probe: Marlin gets it back, others a word on it."""
    places = spiral(20, 90.0)
    log = "M665 L250 R125 H300\nM666 X-0.5 Y-0.4 Z-0.3\nM851 X0 Y0 Z-2.5\n"
    log += marlin.Marlin(log).g30(REAL, Probe(z=2.5), places, digits=5)
    study, imported = take("marlin", {"log": log}, tmp_path)
    assert "its height is taken as M665 H" in said(imported)
    printed = marlin.Marlin(log).apply(compensate(study, "marlin"))
    reached = REAL.over_bed(printed.travel(np.column_stack([places, 0 * places[:, 0]])))
    assert np.abs(reached).max() < 2e-3
    for kind in ("rrf", "klipper"):
        assert "set the height anew before you print" in compensate(study, kind)


# -- geometry that changes, and what is compiled in ------------------------------------
@pytest.mark.parametrize(
    "form", ["Bed x: {} y: {} z: {}", "Bed Position X: {} Y: {} Z: {}"]
)
def test_points_are_read_as_old_versions_print_them(form, tmp_path):
    points = [("0.00", "0.00", "-0.276"), ("-38.97", "-22.50", "-0.236")]
    points += [(f"{60.0 - 20 * k:.2f}", "-45.00", f"-0.1{k}0") for k in range(6)]
    settings = "M665 L269.5 R136.2 H270 A0 B0 C0\nM666 X-0.5 Y-0.9 Z-0.4\nM851 Z-0.2\n"
    log = settings + "\n".join(form.format(*point) for point in points)
    _, imported = take("marlin", {"a.log": log}, tmp_path)
    rows = [tuple(row[f"{axis}_mm"] for axis in "xyz") for row in imported.rows]
    assert rows == [tuple(repr(float(v)) for v in point) for point in points]


def test_points_of_another_geometry_are_left_out(tmp_path):
    places = spiral(9, 80.0)
    log = ""
    for radius, probe_z in ((125.0, -2.5), (125.5, -2.5), (125.5, -2.2)):
        firmware = marlin.Marlin(f"M665 L250 R{radius} H300\nM851 X0 Y0 Z{probe_z}")
        log += firmware.m503() + firmware.g30(REAL, Probe(z=2.5), places)
    study, imported = take("marlin", {"log": log}, tmp_path)
    assert nominal(study)["radius_mm"] == 125.5
    assert len(imported.rows) == len(places)
    assert "18 points that were probed with another" in said(imported)


def test_trims_of_the_radii_are_given_in_a_line_and_stay(tmp_path):
    """The firmware has compiled trims: one radius is fitted, and written without them."""
    trim = np.array([0.35, 0.0, -0.2])
    firmware = marlin.Marlin("M665 L250 R125 H300\nM666 X-0.3 Y-0.3 Z-0.3", trim=trim)
    real = delta(125.63 + trim, 250.0, REAL.angles, REAL.endstops)
    log = firmware.m115() + firmware.m503() + "radius_trim_mm = 0.35, 0, -0.2\n"
    log += firmware.g30(real, Probe(), spiral(25, 95.0), digits=6)
    study, _ = take("marlin", {"log": log}, tmp_path)
    nominal_trims = [nominal(study).get(f"trim{i}_mm", 0.0) for i in (1, 2, 3)]
    assert nominal_trims == pytest.approx(trim)
    text = compensate(study, "marlin")
    assert "trims of the radii by tower stay in the firmware: 0.35, 0, -0.2 mm" in text
    printed = marlin.Marlin(text, trim=trim)
    points = np.array([(0, 0, 0), (80, 0, 0), (-50, 60, 0), (0, -85, 0), (40, 70, 20)])
    assert np.abs(real.tool(printed.travel(points)) - points).max() < 0.01


# -- G33 -------------------------------------------------------------------------------
def check_fit(study: Path, wanted: Delta, tolerance: float) -> None:
    value = fitted(study)
    for name, number in fit.numbers(wanted).items():
        assert value[name] == pytest.approx(number, abs=tolerance), name


def test_heights_of_g33_belong_to_the_geometry_that_it_had_set(tmp_path):
    """M503 above a calibrating G33 prints what its second iteration no longer has."""
    firmware = marlin.Marlin("M665 L250 R125 H300\nM666 X0 Y0 Z0")
    change = "M665 H299.6 R125.4 X0.2 Y-0.15 Z-0.05\nM666 X-0.2 Y0 Z-0.4\n"
    log = firmware.m115() + firmware.m503()
    log += marlin_g33.g33(firmware, REAL, Probe(), 80.0, "P4 V3", [change], digits=5)
    study, imported = take("marlin", {"log": log}, tmp_path)
    values = nominal(study)
    assert values["radius_mm"] == 125.4
    angles = [values[f"angle{i}_deg"] for i in (1, 2, 3)]
    assert angles == pytest.approx([210.2, 329.85, 89.95])
    assert "Not read: 1 earlier reports of G33." in said(imported)
    turned = delta(125.63, 250.0, REAL.angles - 0.05, REAL.endstops)
    check_fit(study, turned, 5e-3)


@pytest.mark.parametrize("angles", [".             {}", ".Tower angle :  {}"])
def test_the_angles_of_g33_are_read_in_both_forms(angles, tmp_path):
    """Versions before 1.1.9 begin their line with words."""
    log = NEW + "M666 X-0.50 Y-0.40 Z-0.30\nG33 P3\nChecking... AC at radius:90.00\n"
    log += ".Height:257.19  Ex:-0.51  Ey:+0.00  Ez:-0.61  Radius:110.29\n"
    log += angles.format("  Tx:+0.28  Ty:-0.25  Tz:-0.02\n")
    log += ".      c:+0.00   x:+0.00   y:+0.01   z:-0.01\n"
    log += ".               yz:-0.02  zx:-0.01  xy:+0.01\n"
    study, _ = take("marlin", {"log": log}, tmp_path)
    values = nominal(study)
    towers = [values[f"angle{i}_deg"] for i in (1, 2, 3)]
    assert towers == pytest.approx([210.28, 329.75, 89.98])


def test_a_report_of_g33_needs_the_radius_of_its_circle(tmp_path):
    """Its geometry is that of the moment, whatever the log has below."""
    firmware = marlin.Marlin("M665 L250 R125 H300\nM666 X0 Y0 Z0")
    report = marlin_g33.g33(firmware, REAL, Probe(), 80.0, "P3 V0")
    log = firmware.m115() + firmware.m503() + report
    bare = log.replace("at radius:80.00", "")
    with pytest.raises(InputError, match=r"line \d+.*probe_radius_mm"):
        take("marlin", {"log": bare}, tmp_path / "a")
    below = log + "M665 L250 R126.5 H299\nM666 X0 Y0 Z0\n"
    study, imported = take("marlin", {"log": below}, tmp_path / "b")
    assert nominal(study)["radius_mm"] == 125.0
    given = take("marlin", {"log": bare + "probe_radius_mm = 80\n"}, tmp_path / "c")
    assert given[1].rows == imported.rows
    with pytest.raises(InputError, match="answer of M503"):
        take("marlin", {"log": BED}, tmp_path / "d")


@pytest.mark.parametrize("points", range(2, 11))
def test_means_of_g33_become_heights_of_their_places(points, tmp_path):
    firmware = marlin.Marlin("M665 L250 R125 H300\nM666 X0 Y0 Z0")
    log = firmware.m115() + firmware.m503()
    log += marlin_g33.g33(firmware, REAL, Probe(), 80.0, f"P{points} V0", digits=6)
    _, imported = take("marlin", {"log": log}, tmp_path)
    places = np.array([[float(row[f"{k}_mm"]) for k in "xy"] for row in imported.rows])
    heights = [float(row["z_mm"]) for row in imported.rows]
    # what a probe reads at these places
    single = contact(firmware, REAL, Probe(), places)
    assert heights == pytest.approx(list(single), abs=1e-3)


def test_the_places_of_g33_are_those_of_the_probe_with_o(tmp_path):
    """The line that G33 prints when it begins has no words, and takes none away."""
    firmware = marlin.Marlin("M665 L250 R125 H300\nM666 X0 Y0 Z0\nM851 X23 Y-5 Z-2.5")
    for words, x in (("P3 V0 O", -23.0), ("P3 V0", 0.0)):
        log = firmware.m115() + firmware.m503()
        log += marlin_g33.g33(firmware, REAL, Probe(23, -5, 2.5), 80.0, words)
        _, imported = take("marlin", {"log": log}, tmp_path / words[-1])
        assert float(imported.rows[0]["x_mm"]) == pytest.approx(x)
    # a second G33 from the printer's menu has no O
    again = log + marlin_g33.g33(
        firmware, REAL, Probe(), 80.0, "P3", shown=False, changes=()
    )
    with pytest.raises(InputError, match="the log does not show P"):
        take("marlin", {"log": again}, tmp_path / "menu")


def test_g33_without_p_is_asked_for_where_it_matters(tmp_path):
    firmware = marlin.Marlin("M665 L250 R125 H300\nM666 X0 Y0 Z0")
    log = firmware.m115() + firmware.m503()
    report = marlin_g33.g33(firmware, REAL, Probe(), 80.0, "P3 V0", shown=False)
    with pytest.raises(InputError, match="add a line G33 P4 above the report"):
        take("marlin", {"log": log + report}, tmp_path / "a")
    take("marlin", {"log": log + "G33 P3 V0\n" + report}, tmp_path / "b")
    level = delta(125.0, 250.0, [210.0, 330.0, 90.0], [300.0] * 3)
    report = marlin_g33.g33(firmware, level, Probe(), 80.0, "P3 V0", shown=False)
    _, imported = take("marlin", {"log": log + report}, tmp_path / "c")
    assert "P is not in the log; that of P4 is as small" in said(imported)
    old = "firmware_version = 1.1.5\nM665 L250 R125 H300 B80\nM666 X0 Y0 Z0\nG33 P4\n"
    with pytest.raises(InputError, match=r"does not know for Marlin before 1\.1\.7"):
        take("marlin", {"log": old + report}, tmp_path / "d")
