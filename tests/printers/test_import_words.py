"""Every word that a firmware documents is read, listed with its cost, or refused.

The lists of words are written from the firmwares' documentation: Klipper's configuration
reference, the G-code dictionary of RepRapFirmware, Marlin's pages of G-codes.
"""

import functools
import re
from pathlib import Path

import pytest

from pkm_studies.base import InputError
from pkm_studies.importers import ImportedSession, import_files

# -- one file of each firmware that has everything an import needs ----------------------
STEPPER = """\
[stepper_{}]
microsteps: 16
rotation_distance: 40
full_steps_per_rotation: 200
gear_ratio: 10:10
position_endstop: 300.0
arm_length: 250.0
angle: {}
"""
KLIPPER = (
    """\
[printer]
kinematics: delta
delta_radius: 125.0
"""
    + "".join(map(STEPPER.format, "abc", (210, 330, 90)))
    + """[probe]
[bltouch]
[delta_calibrate]
radius: 90
manual_height0: 0.1
manual_height0_pos: 24000,24000,24000
distance0: 60
distance0_pos1: 24000,24000,24000
distance0_pos2: 27000,23000,23000
"""
    + "".join(
        f"height{k}: 0.0\nheight{k}_pos: {24000 + 10 * k},24000,{24000 - 10 * k}\n"
        for k in range(7)
    )
)
PLACES = [(0, 0), (60, 0), (-60, 0), (0, 60), (0, -60), (40, 40), (-40, -40)]
RRF = {
    "config.g": "M665 L250.0 R125.0 H300.0 B110 X0.1 Y0.2 Z0.3\n"
    "M666 X0.3 Y-0.2 Z-0.1 A0.2 B0.1\nM669 K3\nM558 K0 P5\nG31 K0 X3 Y4 Z1.1 P500\n",
    "bed.g": "".join(
        f"G30 P{k} X{x} Y{y} Z-99999\n" for k, (x, y) in enumerate(PLACES)
    ),
    "log.txt": "G32 bed probe heights: 0.01 0.02 0.03 0.04 0.05 0.06 0.07, mean 0.0\n",
}
BED = "".join(f"Bed X: {x}.00 Y: {y}.00 Z: 0.1{k}\n" for k, (x, y) in enumerate(PLACES))
NEW_MARLIN = (
    "FIRMWARE_NAME:Marlin 2.1.2 (Github)\necho:  M92 X80.00 Y80.00 Z80.00 E97.00\n"
    "echo:  M665 L250.00 R125.00 H300.00 S100.00 X0.10 Y0.20 Z0.30 A0.1 B0.2 C0.3\n"
    "echo:  M666 X-0.30 Y-0.20 Z-0.10\necho:  M851 X1.00 Y2.00 Z-1.25\n"
) + BED
OLD_MARLIN = (
    "FIRMWARE_NAME:Marlin 1.1.8 (Github)\n"
    "echo:  M665 L250.00 R125.00 H300.00 S100.00 B70.00 X0.10 Y0.20 Z0.30\n"
    "echo:  M666 X-0.30 Y-0.20 Z-0.10\necho:  M851 Z-1.25\n"
) + BED
REPORT = (
    "M92 X80 Y80 Z80\nM665 L250.00 R125.00 H300.00 S100.00 X0.1 Y0.2 Z0.3 A0 B0 C0\nM666 X-0.3 Y0 Z0\n"
    "M851 X5.00 Y2.00 Z-1.25\nG33 P4 V0\nChecking... AC at radius:80.00\n"
    ".Height:300.10    Ex:-0.30  Ey:-0.10  Ez:+0.00    Radius:125.20\n"
    ".Tower angle :    Tx:+0.11  Ty:+0.22  Tz:+0.33\n"
    ".      c:+0.01     x:+0.20   y:-0.10   z:+0.05\n"
    ".                 yz:+0.03  zx:-0.04  xy:+0.11\n"
)


# -- the words that each documents ------------------------------------------------------
def listed(text: str) -> list[str]:
    return text.split()


PRINTER = listed("""
    kinematics max_velocity max_accel minimum_cruise_ratio square_corner_velocity
    max_z_velocity max_z_accel minimum_z_position delta_radius print_radius
    max_accel_to_decel
""")
STEPPER = listed("""
    step_pin dir_pin enable_pin rotation_distance microsteps
    full_steps_per_rotation gear_ratio step_pulse_duration endstop_pin
    position_min position_endstop position_max homing_speed homing_retract_dist
    homing_retract_speed second_homing_speed homing_positive_dir arm_length angle
""")
CALIBRATE = listed("""
    radius speed horizontal_move_z height0 height0_pos manual_height0
    manual_height0_pos distance0 distance0_pos1 distance0_pos2
""")
PROBE = listed("""
    pin deactivate_on_each_sample x_offset y_offset z_offset speed samples
    sample_retract_dist lift_speed samples_result samples_tolerance
    samples_tolerance_retries activate_gcode deactivate_gcode
""")
SECTIONS = {
    "printer": PRINTER,
    "stepper_b": STEPPER,
    "delta_calibrate": CALIBRATE,
    "probe": PROBE,
    "bltouch": ["sensor_pin", "control_pin", "pin_move_time", "x_offset", "z_offset"],
}
RRF_WORDS = {
    "M665": "LRBHXYZ", "M666": "XYZAB", "M557": "XYRSPABC", "M558": "PCHFTABRSKIXYZUV",
    "G31": "PXYZCSTHK", "M669": "KXYST", "M579": "XYZ", "M851": "Z", "G29": "SPK",
    "G30": "PXYZHSK",
}  # fmt: skip
MARLIN_WORDS = {
    "M665": "HLRSXYZABC", "M666": "XYZ", "M851": "XYZ", "M206": "XYZPTABCUVW",
    "G29": "ACOQXYZWSEDHFBLRJVPTUKIN", "G30": "XYCE", "G33": "ACEPTVORSXYZF",
}  # fmt: skip
#: words whose number decides nothing that a study holds
ONLY_CHECKED = {
    "kinematics", "M669 K", "G31 K", "G30 K", "G30 P", "G30 Z", "G33 O", "G33 P", "M558 K",
    "M558 P",
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """For tests of single words, which read unchanged files once."""
    return tmp_path_factory.mktemp("words")


def read(kind: str, files: dict[str, str], folder: Path) -> ImportedSession:
    return read_once(kind, tuple(files.items()), folder / kind)


@functools.cache
def read_once(
    kind: str, files: tuple[tuple[str, str], ...], folder: Path
) -> ImportedSession:
    folder.mkdir(exist_ok=True)
    paths = []
    for name, text in files:
        (folder / name).write_text(text)
        paths.append(folder / name)
    number = len(list(folder.glob("out*")))
    return import_files(kind, paths, folder / f"out{number}", name="p")[1]


def outcome(
    kind: str, files: dict[str, str], folder: Path, group: str, key: str
) -> ImportedSession | None:
    """What was imported, if a word was read. Fails where nothing is said of it.

    None where it is listed or refused.
    """
    try:
        imported = read(kind, files, folder)
    except InputError as error:
        if key in str(error) and group.strip("[]") in str(error):
            return None
        raise
    general = re.sub(r"\d+", "<n>", key, count=1)
    for sentence in imported.statements:
        named = rf"{re.escape(group)}[^;:]*?[ ,]{re.escape(general)}(?![\w<])"
        if re.search(named, sentence):
            assert sentence.lstrip("# ") in imported.study.replace("\n#  ", "")
            return imported if sentence.startswith("Words read") else None
    raise AssertionError(f"{group} {key} is dropped in silence")


# -- Klipper ---------------------------------------------------------------------------
def with_option(section: str, key: str, value: str) -> str:
    """The configuration with one option set in its section."""
    before, head, after = KLIPPER.partition(f"[{section}]\n")
    options, following, others = after.partition("[")
    line = f"{key}: {value}"
    options, known = re.subn(rf"^{key}: .*$", lambda _: line, options, flags=re.M)
    if not known:
        options = f"{line}\n{options}"
    return before + head + options + following + others


@pytest.mark.parametrize(
    ("section", "key"), [(s, key) for s, keys in SECTIONS.items() for key in keys]
)
def test_every_option_of_klipper(section, key, folder):
    known = re.search(rf"\[{section}\][^\[]*?^{key}: (.*)$", KLIPPER, re.M)
    value = known[1] if known else "1.5"
    files = {"printer.cfg": with_option(section, key, value)}
    before = outcome("klipper", files, folder, f"[{section}]", key)
    assert (before is not None) == (known is not None)
    if before is None or key in ONLY_CHECKED:
        return
    # a word that is read changes what is imported
    number = re.search(r"\d+", value)
    other = f"{int(number[0]) + 1}{value[number.end() :]}"
    files = {"printer.cfg": with_option(section, key, other)}
    after = read("klipper", files, folder)
    assert (before.study, before.rows) != (after.study, after.rows)


def test_an_option_of_a_fork_is_refused(tmp_path):
    for section, key in (("printer", "delta_radius_a"), ("stepper_b", "radius_trim")):
        text = with_option(section, key, "0.2")
        with pytest.raises(
            InputError, match=rf"\[{section}\] {key} = 0.2: this importer"
        ):
            read("klipper", {"printer.cfg": text}, tmp_path)


def test_sizes_that_a_fork_changes_by_nothing_are_no_matter(tmp_path):
    """FLSun's printers have these two, at 0 as they come."""
    text = with_option("printer", "x_size_offset", "0")
    said = " ".join(read("klipper", {"printer.cfg": text}, tmp_path).statements)
    assert re.search(r"no part of the geometry: .*x_size_offset", said)
    text = with_option("printer", "x_size_offset", "0.2")
    with pytest.raises(
        InputError, match=r"x_size_offset = 0\.2: a fork of the firmware"
    ):
        read("klipper", {"printer.cfg": text}, tmp_path)


def test_a_value_that_goes_on_in_indented_lines(tmp_path):
    text = with_option("stepper_b", "gear_ratio", "\n   11:10,\n   1:1 # two stages")
    rows = read("klipper", {"printer.cfg": text}, tmp_path).rows
    whole = read("klipper", {"printer.cfg": KLIPPER}, tmp_path).rows
    assert float(rows[0]["q2_mm"]) == pytest.approx(float(whole[0]["q2_mm"]) / 1.1)


def test_a_position_without_its_height_is_named(tmp_path):
    text = KLIPPER.replace("height6: 0.0\n", "")
    with pytest.raises(InputError, match=r"height6_pos.*there is no height6 for it"):
        read("klipper", {"printer.cfg": text}, tmp_path)


def test_other_sections_and_files_are_listed(tmp_path):
    text = KLIPPER + "[skew_correction]\n[fan]\npin: x\n[include more/macros.cfg]\n"
    said = " ".join(read("klipper", {"printer.cfg": text}, tmp_path).statements)
    assert "[skew_correction] (line" in said
    assert "taken for no part of the geometry: [fan]" in said
    assert "[include more/macros.cfg] (line" in said
    given = {"printer.cfg": text, "macros.cfg": "[gcode_macro A]\ngcode:\n  G28\n"}
    assert "[include" not in " ".join(read("klipper", given, tmp_path).statements)


# -- commands --------------------------------------------------------------------------
def number_of(text: str, command: str, letter: str) -> str | None:
    line = re.search(rf"\b{command}\b([^\n;]*)", text)
    match = line and re.search(rf"\s{letter}(-?[\d.]+)", line[1])
    return match[1] if match else None


def changed(text: str, command: str, letter: str, value: str) -> str:
    """The text with a word of a command set, in its first line or in a new one."""
    if number_of(text, command, letter) is None:
        line = re.search(rf"\b{command}\b[^\n;]*", text)
        if line is None:
            return f"{command} {letter}{value}\n{text}"
        return f"{text[: line.end()]} {letter}{value}{text[line.end() :]}"
    return re.sub(
        rf"(\b{command}\b[^\n;]*?\s{letter})-?[\d.]+", rf"\g<1>{value}", text, count=1
    )


def check_word(
    kind: str,
    files: dict[str, str],
    where: str,
    command: str,
    letter: str,
    folder: Path,
) -> None:
    known = number_of(files[where], command, letter)
    given = files | {where: changed(files[where], command, letter, known or "0")}
    before = outcome(kind, given, folder, command, letter)
    name = f"{command} {letter}"
    if before is None or name in ONLY_CHECKED or known is None:
        return
    other = f"{float(known) - 0.25:g}"
    given = files | {where: changed(files[where], command, letter, other)}
    after = read(kind, given, folder)
    assert (before.study, before.rows) != (after.study, after.rows)


@pytest.mark.parametrize(
    ("command", "letter"), [(c, k) for c, keys in RRF_WORDS.items() for k in keys]
)
def test_every_word_of_reprapfirmware(command, letter, folder):
    where = "bed.g" if command == "G30" else "config.g"
    check_word("rrf", RRF, where, command, letter, folder)


@pytest.mark.parametrize(
    ("command", "letter"), [(c, k) for c, keys in MARLIN_WORDS.items() for k in keys]
)
def test_every_word_of_marlin(command, letter, folder):
    check_word("marlin", {"log": NEW_MARLIN}, "log", command, letter, folder)


@pytest.mark.parametrize("letter", "HLRSXYZB")
def test_every_word_of_an_older_marlin(letter, folder):
    check_word("marlin", {"log": OLD_MARLIN}, "log", "M665", letter, folder)


def test_the_radius_of_calibration_changes_no_length(tmp_path):
    imported = read("marlin", {"log": OLD_MARLIN}, tmp_path)
    assert "arm2_mm = 250.0\n" in imported.study
    assert 'm665_b = "calibration radius"' in imported.study


@pytest.mark.parametrize("word", [
    "c", "x", "y", "z", "yz", "zx", "xy", "Height", "Ex", "Ey", "Ez", "Radius", "Tx",
    "Ty", "Tz",
])  # fmt: skip
def test_every_number_of_a_g33_report(word, folder):
    """What G33 prints of its changes is the geometry of the heights below it."""
    before = read("marlin", {"log": REPORT}, folder)
    # no printer is lower than its bed
    value = "200.77" if word == "Height" else "-0.77"
    text = re.sub(rf"(?<![A-Za-z]){word}:[+-]?([\d.]+)", rf"{word}:{value}", REPORT)
    assert text != REPORT
    after = read("marlin", {"log": text}, folder)
    assert (before.study, before.rows) != (after.study, after.rows)


@pytest.mark.parametrize("letter", "DEFIJK")
@pytest.mark.parametrize("kind", ["rrf", "marlin"])
def test_radius_trims_of_forks_are_refused_by_name(kind, letter, tmp_path):
    if kind == "rrf":
        files = RRF | {"config.g": changed(RRF["config.g"], "M665", letter, "0.2")}
    else:
        files = {"log": changed(NEW_MARLIN, "M665", letter, "0.2")}
    with pytest.raises(InputError, match=rf"M665 {letter} .*radius_trim_mm = x, y, z"):
        read(kind, files, tmp_path)


@pytest.mark.parametrize(("kind", "command"), [
    ("marlin", "M666 D0.3"), ("marlin", "M665 Q2"), ("rrf", "M666 Q1"), ("rrf", "G20"),
])  # fmt: skip
def test_a_word_that_nobody_documents_is_refused(kind, command, tmp_path):
    files = RRF if kind == "rrf" else {"log": NEW_MARLIN}
    first = next(iter(files))
    with pytest.raises(InputError, match=command[:6].strip()):
        read(kind, files | {first: f"{command}\n{files[first]}"}, tmp_path)


def test_commands_without_blanks_and_with_text_are_read_whole(tmp_path):
    dense = RRF["config.g"].replace(
        "M665 L250.0 R125.0 H300.0", "M665 L250.0R126.5H300.0"
    )
    dense = dense.replace(
        "M558 K0 P5", 'M558 K0 P5 C"^zprobe.in" F{global.speed} M579 X1.0'
    )
    imported = read("rrf", RRF | {"config.g": dense}, tmp_path)
    assert "radius_mm = 126.5" in imported.study
    said = " ".join(imported.statements)
    assert "M558 K P;" in said
    assert "M558 C F;" in said
    assert "M579 X (line 4)" in said
