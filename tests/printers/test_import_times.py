"""Logs whose lines carry times: read in the order of time, or refused."""

import re
import time
from pathlib import Path

import numpy as np
import pytest

from pkm_printers import facts, gcode, klipper_config
from pkm_studies.base import InputError

#: an answer before calibration, then the one after it, with seconds between them
OLD, NEW = "M665 L215 R105 H250 X0 Y0 Z0", "M665 L215 R104 H251 X0 Y0 Z0"
STOPS, PROBE = "M666 X-1 Y-2 Z-3", "M851 X0 Y0 Z-0.2"
POINTS = [
    (80.0 * np.cos(a), 80.0 * np.sin(a)) for a in np.radians(np.arange(0, 360, 45))
]
BED = [f"Bed X: {x:.2f} Y: {y:.2f} Z: 0.0{k}" for k, (x, y) in enumerate(POINTS)]
LOG = [OLD, STOPS, PROBE, *BED[::-1], NEW, *BED]


def stamped(form: str, lines: list[str], start: float = 36000.0) -> list[str]:
    """Lines with times a minute apart."""
    written = []
    for k, line in enumerate(lines):
        minutes, seconds = divmod(int(start + 60 * k), 60)
        hours, minutes = divmod(minutes, 60)
        day = 24 + hours // 24
        clock = f"{hours % 24:02d}:{minutes:02d}:{seconds:02d}"
        half = f"{hours % 12 or 12}:{minutes:02d} {'AM' if hours % 24 < 12 else 'PM'}"
        written.append(form.format(day=day, clock=clock, half=half) + line)
    return written


FORMS = [
    "{day}.11.2026, {clock}\t", "2026-11-{day} {clock},123 - Recv: ",
    "11/{day}/2026, {half} ", "[{clock}] ", "{clock}.250 > ",
]  # fmt: skip


@pytest.mark.parametrize("start", [36000.0, 85800.0], ids=["morning", "over midnight"])
@pytest.mark.parametrize("form", FORMS)
def test_a_marlin_log_with_the_newest_line_first_is_the_log_in_order(
    form, start, oed, tmp_path
):
    lines = stamped(form, LOG, start)
    for name, content in (("a", lines), ("b", lines[::-1])):
        (tmp_path / f"{name}.log").write_text("\n".join(content))
        code, out, err = oed(
            "import", "marlin", tmp_path / f"{name}.log", "--out", tmp_path / name,
            "--name", "q",
        )  # fmt: skip
        assert code == 0, err
        assert ("newest line stands first" in out) == (name == "b")
    rows = [(tmp_path / n / "q.readings.csv").read_text() for n in "ab"]
    assert rows[0] == rows[1]
    study = (tmp_path / "b" / "q.study.toml").read_text()
    assert re.findall(r"(?:radius|endstop1)_mm = ([\d.]+)", study) == ["104.0", "252.0"]


def test_times_that_rise_and_fall_are_refused_with_the_line(tmp_path):
    lines = stamped(FORMS[0], LOG)
    (tmp_path / "a.log").write_text("\n".join([*lines[5:], *lines[:5]]))
    fallen = f"line {len(lines) - 4}"
    with pytest.raises(InputError, match="rise and fall") as error:
        gcode.read([tmp_path / "a.log"])
    assert fallen in str(error.value)


def test_lines_without_a_time_go_with_the_one_above(tmp_path):
    (tmp_path / "a.log").write_text("top\n10:02\nc\nd\n10:01\na\n10:01\nb")
    text = [line.text for line in gcode.read([tmp_path / "a.log"])]
    assert text == ["top", "10:01", "b", "10:01", "a", "10:02", "c", "d"]


def test_logs_of_several_days_are_read_by_their_dates(tmp_path):
    for day in ("25", "24"):
        (tmp_path / f"{day}.log").write_text(f"2026-11-{day} 10:00:00 {day}")
    (tmp_path / "config.g").write_text("M665")
    files = [tmp_path / name for name in ("25.log", "config.g", "24.log")]
    read = [Path(line.file).name for line in gcode.read(files)]
    assert read == ["24.log", "config.g", "25.log"]


def test_a_maslow_log_takes_the_last_value_in_time(oed, tmp_path):
    anchors = {"tlX": 0, "tlY": 2000, "trX": 3000, "trY": 2000, "brX": 3000}
    at = np.array([[0, 2000], [3000, 2000], [3000, 0], [0, 0]])
    sleds = [(x, y) for x in (1000, 1500, 2000) for y in (700, 1000, 1300)]
    waypoints = ",".join(
        "{"
        + ",".join(
            f"{c}:{np.hypot(*(at[k] - sled)):.3f}"
            for k, c in enumerate(("tl", "tr", "br", "bl"))
        )
        + "}"
        for sled in sleds
    )
    lines = [f"$/Maslow_{k}={v}" for k, v in (anchors | {"tlX": 77}).items()]
    lines += [f"CLBM:[{waypoints}]", "$/Maslow_tlX=0"]
    log = tmp_path / "m.log"
    log.write_text("\n".join(stamped("{clock} ", lines)[::-1]))
    code, out, err = oed("import", "maslow", log, "--out", tmp_path / "o")
    assert code == 0, err
    assert "anchors tl 0, 2000;" in out


def test_a_console_of_reprap_firmware_gives_the_geometry_of_its_heights(oed, tmp_path):
    delta = (
        "Diagonals 288.100:288.100:288.100, delta radius {}, homed height {}, bed radius"
        " 105.0, X 0.243, Y -0.178, Z 0.000"
    )
    stops = "Endstop adjustments X{} Y-0.18 Z-0.03, tilt X0.00% Y0.00%"
    day = "24.11.2026, 10:0{}:00\t{}"
    log = [
        *(
            day.format(9, "M98"),
            "G32 bed probe heights: 0.01 0.02 0 0.01 0 0 0, mean 0",
        ),
        *(day.format(6, "M666"), stops.format("0.21")),
        *(day.format(5, "M665"), delta.format("124.601", "261.082")),
        *(day.format(4, "G32"), "Calibrated 6 factors using 10 points"),
        *(day.format(2, "M666"), stops.format("1.00")),
        *(day.format(1, "M665"), delta.format("126.000", "261.000")),
    ]
    (tmp_path / "log.txt").write_text("\n".join(log))
    points = [f"G30 P{k} X{x:.2f} Y{y:.2f}" for k, (x, y) in enumerate(POINTS[:7])]
    (tmp_path / "bed.g").write_text("\n".join(points))
    files = [tmp_path / "log.txt", tmp_path / "bed.g"]
    code, out, err = oed("import", "rrf", *files, "--out", tmp_path / "o")
    assert code == 0, err
    # 261.082 + sqrt(288.1^2 - 124.601^2) less the same root: the adjustment alone
    assert "radius 124.601 mm" in out
    assert "endstops at 261.292, 260.902, 261.052 mm" in out


SOON = 5.0  #: s; this took minutes where time grew with the square


def test_lines_of_blanks_and_brackets_take_no_longer_than_others(tmp_path):
    blanks = " " * 100_000
    printer = tmp_path / "printer.cfg"
    printer.write_text(f"[printer{blanks}x{blanks}\n[printer]\nkey{blanks}y\nz: 1\n")
    start = time.perf_counter()
    config = klipper_config.read([printer])
    assert config.number("printer", "z") == 1.0
    line = gcode.TextLine(f"probe_radius_mm = 8{blanks}0{blanks}", "log", 1)
    with pytest.raises(InputError, match="not a finite number"):
        facts.numbers([line])
    open_brackets = gcode.TextLine("G1 A{" * 20_000, "log", 1)
    assert len(list(gcode.commands([open_brackets]))) == 20_000
    assert time.perf_counter() - start < SOON
