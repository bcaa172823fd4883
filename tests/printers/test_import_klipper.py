"""`oed import klipper`: printers of an oracle and real ones, to Klipper's own words."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles.delta_trilateration import travel_to
from oracles.firmware.geometry import Probe, delta, spiral
from oracles.firmware.klipper import HEADER, Klipper, example
from oracles.klipper_cost import Delta, cost

import oed
from oed import units
from pkm_studies.base import InputError
from pkm_studies.commands import main
from pkm_studies.importers import import_files
from printers.delta_printer import nominal, take

ARMS = (217.0, 217.0, 217.0)
RADIUS = 98.0  #: radius of a printer that no study describes, mm, and its true geometry
TRUE = Delta(98.6, ARMS, np.radians([210.3, 329.8, 90.0]), (251.4, 250.7, 250.9))
STEP = 40.0 / (200.0 * 16.0)
POINTS = [(0.0, 0.0)] + [
    (70.0 * np.cos(a), 70.0 * np.sin(a)) for a in np.radians(np.arange(0, 360, 45))
]


def printer(heights: list[str]) -> str:
    """A printer.cfg with these lines in the block [delta_calibrate]."""
    steppers = "\n".join(
        f"[stepper_{tower}]\nmicrosteps: 16  # a comment\nrotation_distance = 40\n"
        for tower in "abc"
    )
    return f"""\
[printer]
kinematics: delta
#delta_radius: 120
[gcode_macro PARK]
gcode:
    G1 X{{ 3 + 4 }} ; radius: 3
{steppers}
[delta_calibrate]
radius: 70
#*# <---------------------- SAVE_CONFIG ---------------------->
#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated.
#*#
#*# [printer]
#*# delta_radius = {RADIUS}
#*#
#*# [stepper_a]
#*# arm_length = 217.0
#*# position_endstop = 251.0
#*#
#*# [delta_calibrate]
""" + "\n".join(f"#*# {line}" for line in heights)


def readings_of_truth() -> list[str]:
    """The saved block: contact at 12.5 mm, at the steps of the true printer."""
    lines = []
    for k, (x, y) in enumerate(POINTS):
        travels = travel_to((x, y, 12.5), *TRUE)
        steps = ",".join(f"{travel / STEP:.6f}" for travel in travels)
        lines += [f"height{k} = 12.5", f"height{k}_pos = {steps}"]
    return lines


def test_a_printer_comes_in_and_its_true_geometry_comes_out(tmp_path, capsys):
    (tmp_path / "printer.cfg").write_text(printer(readings_of_truth()))
    code = main(
        ["import", "klipper", str(tmp_path / "printer.cfg"), "--out", str(tmp_path)]
    )
    assert code == 0
    files = [
        str(tmp_path / f"printer.{kind}") for kind in ("study.toml", "readings.csv")
    ]
    assert main(["check", *files]) == 0
    # a probe touches at one height: no copies
    assert "equal to the last digit" not in "".join(capsys.readouterr())
    study = oed.load_study(tmp_path / "printer.study.toml")
    estimate = oed.identify(oed.read_readings(study)).section.parameters
    value = {n: float(units.to_si(e.value, e.unit)) for n, e in estimate.items()}
    # the priors of 5 mm and 2 deg pull by some um and 0.1 mrad
    assert value["radius"] == pytest.approx(units.MM * TRUE.radius, abs=5e-5)
    assert value["angle1"] == pytest.approx(TRUE.angle[0], abs=3e-4)
    assert value["endstop2"] == pytest.approx(units.MM * TRUE.endstop[1], abs=5e-5)


@pytest.mark.parametrize(
    "name", ["flsun_sr_cupsster", "flsun_v400_fzechert", "flsun_v400_phnxdrgn"]
)
def test_real_printers_reach_the_cost_of_klipper(name, shared_data, tmp_path):
    """SAVE_CONFIG stores the geometry of Klipper's own least-squares fit."""
    config = shared_data / "klipper_delta" / f"{name}.cfg"
    path, imported = import_files("klipper", [config], tmp_path)
    study = oed.load_study(path)
    section = oed.identify(oed.read_readings(study)).section
    kinds = {"radius": "mm", "arm": "mm", "angle": "deg", "endstop": "mm"}
    values = {
        name: float(units.to_si(study.machine.nominal[f"{name}_{unit}"], unit))
        for stem, unit in kinds.items()
        for name in ([stem] if stem == "radius" else [f"{stem}{i}" for i in (1, 2, 3)])
    }
    fitted = values | {
        name: float(units.to_si(entry.value, entry.unit))
        for name, entry in section.parameters.items()
    }
    heights, distances = _readings(imported.rows)
    reference = cost(_saved(config), heights, distances)
    own = cost(_delta(fitted), heights, distances)
    assert own <= 1.05 * reference
    assert own >= 0.99 * reference  # Klipper's is the least there is


def _saved(config: Path) -> Delta:
    """The geometry in the block of SAVE_CONFIG, whether or not it is in use."""
    lines = [line[4:] for line in config.read_text().splitlines() if line[:3] == "#*#"]
    block = "\n".join(lines)

    def numbers(key: str) -> list[float]:
        return [float(v) for v in re.findall(rf"^{key} = (.*)$", block, re.M)]

    (radius,) = numbers("delta_radius")
    angles = np.radians(numbers("angle")).tolist()
    return Delta(radius, numbers("arm_length"), angles, numbers("position_endstop"))


def _delta(values: Mapping[str, float]) -> Delta:
    """The oracle's delta, in mm and rad, from SI values by parameter."""
    lengths = {
        stem: [values[f"{stem}{i}"] / units.MM for i in (1, 2, 3)]
        for stem in ("arm", "endstop")
    }
    angles = [values[f"angle{i}"] for i in (1, 2, 3)]
    radius = values["radius"] / units.MM
    return Delta(radius, lengths["arm"], angles, lengths["endstop"])


def _readings(rows: Sequence[Mapping[str, str]]) -> tuple[list[Any], list[Any]]:
    """Heights and distances of imported rows, as the cost takes them."""
    probed = [row for row in rows if row["setup"] == "probe"]
    pairs = [row for row in rows if row["setup"] == "calliper"]
    heights = [(float(row["height_mm"]), _travels(row)) for row in probed]
    distances = [
        (float(second["length_mm"]), _travels(first), _travels(second))
        for first, second in zip(pairs[::2], pairs[1::2], strict=True)
    ]
    return heights, distances


def _travels(row: Mapping[str, str]) -> list[float]:
    return [float(row[f"q{i}_mm"]) for i in (1, 2, 3)]


def test_a_value_above_the_saved_block_is_the_one_in_use(tmp_path):
    """As klippy/configfile.py: saved values that are written above are stripped."""
    text = printer(readings_of_truth()).replace(
        "#delta_radius: 120", "delta_radius: 99"
    )
    (tmp_path / "printer.cfg").write_text(text)
    path, imported = import_files("klipper", [tmp_path / "printer.cfg"], tmp_path)
    assert oed.load_study(path).machine.nominal["radius_mm"] == 99.0
    line = text.splitlines().index("delta_radius: 99") + 1
    (sentence,) = [s for s in imported.statements if "does not use the saved" in s]
    assert f"delta_radius is 99, as line {line} has it" in sentence
    assert "98.0 of line" in sentence


@pytest.mark.parametrize(("old", "new", "words"), [
    ("kinematics: delta", "kinematics: corexy", "line 2, [printer] kinematics"),
    ("delta_radius = 98.0", "delta_radius = wide", "a number is wanted here"),
    ("delta_radius = 98.0", "delta_radius = 300", "not longer than the delta's"),
    ("height3_pos = ", "height3_pos = 1,", "3 numbers are wanted here"),
    ("height3_pos = ", "height3_was = ", "[delta_calibrate] height3_pos: missing"),
    ("#*# [delta_calibrate]", "#*# [other]", "run DELTA_CALIBRATE"),
    ("rotation_distance = 40", "", "give the file that has it as well"),
    ("microsteps: 16", "microsteps: 0", "must be above 0"),
])  # fmt: skip
def test_bad_files_name_line_and_remedy(old, new, words, tmp_path):
    text = printer(readings_of_truth())
    assert old in text
    (tmp_path / "printer.cfg").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as raised:
        import_files("klipper", [tmp_path / "printer.cfg"], tmp_path / "out")
    assert words in str(raised.value)
    assert not (tmp_path / "out").exists()


def test_nothing_is_overwritten(tmp_path):
    (tmp_path / "printer.cfg").write_text(printer(readings_of_truth()))
    readings = tmp_path / "printer.readings.csv"
    readings.write_text("mine")
    with pytest.raises(InputError, match="importing overwrites nothing"):
        import_files("klipper", [tmp_path / "printer.cfg"], tmp_path)
    assert readings.read_text() == "mine"


def test_nominal_numbers_of_another_printer_are_exit_1(tmp_path, capsys):
    """The readings fit, but only 30 mm from the endstops that the file states."""
    text = printer(readings_of_truth()).replace("= 251.0", "= 221.0")
    (tmp_path / "printer.cfg").write_text(text)
    path, _ = import_files("klipper", [tmp_path / "printer.cfg"], tmp_path)
    readings = str(tmp_path / "printer.readings.csv")
    plain = "\n[posterior]\nenabled = false\n[report]\nhtml = false\npdf = false\n"
    plain += '[identify]\neffects = "none"\n'
    path.write_text(path.read_text() + plain)
    out = str(tmp_path / "out")
    assert main(["identify", str(path), "--readings", readings, "--out", out]) == 1
    assert "numbers are those of another machine" in capsys.readouterr().err


def test_an_unknown_kind_is_refused(tmp_path):
    with pytest.raises(InputError, match="did you mean klipper"):
        import_files("kliper", [tmp_path / "a.cfg"], tmp_path)


REAL = delta(110.3, 250.0, [210.3, 329.8, 90.0], [260.2, 259.7, 260.3])


def probed_printer() -> Klipper:
    """A printer that DELTA_CALIBRATE probed without noise, and measured an object."""
    firmware = Klipper(example(probe=(20, -5, 2.5)))
    firmware.calibrate(REAL, Probe(20, -5, 2.5), spiral(12, 90.0))
    firmware.analyze(REAL, 0.0, np.random.default_rng(0))
    return firmware


@pytest.mark.parametrize(("old", "new", "words"), [
    ("#*# height3 = 2.5", "height3 = 2.5", "height3 = 2.5: Klipper drops the whole"),
    ("#*# height3 = 2.5", "#*#height3 = 2.5", "beginning with #*# and a blank"),
    ("#*# DO NOT EDIT", "#*# EDIT", "below its three lines of heading"),
    ("[probe]", "#*# [probe]", "#*# [probe]: Klipper drops the whole"),
    (HEADER, "", "below its three lines of heading"),
])  # fmt: skip
def test_a_block_that_klipper_drops_is_refused(old, new, words, tmp_path):
    text = probed_printer().text()
    assert old in text
    edited = text.replace(old, new)
    # the oracle's Klipper does not have the block either
    assert "height3" not in Klipper(edited).options.get("delta_calibrate", {}) or (
        "[probe]" in words
    )
    with pytest.raises(InputError) as raised:
        take("klipper", {"printer.cfg": edited}, tmp_path)
    assert words in str(raised.value)


def test_blank_lines_after_the_block_are_no_edit(tmp_path):
    study, _ = take(
        "klipper", {"printer.cfg": probed_printer().text() + "\n\n"}, tmp_path
    )
    assert nominal(study)["radius_mm"] == 110.0


@pytest.mark.parametrize(
    ("factor", "words"), [(2.0, "below.*2 times"), (0.5, "above.*0.5 times")]
)
@pytest.mark.parametrize("stale", ["distance", "height"])
def test_positions_saved_with_other_steps_are_named_at_import(
    stale, factor, words, tmp_path
):
    firmware = probed_printer()
    section = firmware.saved["delta_calibrate"]
    first = f"{stale}0_pos1" if stale == "distance" else "height0_pos"
    for key, steps in section.items():
        if key.startswith(stale) and "_pos" in key:
            moved = [factor * float(v) for v in steps.split(",")]
            section[key] = ",".join(f"{v:.3f}" for v in moved)
    text = firmware.text()
    line = next(k for k, v in enumerate(text.splitlines(), 1) if f" {first} =" in v)
    with pytest.raises(InputError, match=rf"line {line}, .*{first}.*{words}"):
        take("klipper", {"printer.cfg": text}, tmp_path)


def test_towers_at_one_angle_are_no_traceback(tmp_path):
    text = probed_printer().text().replace("angle = 330", "angle = 210")
    with pytest.raises(InputError, match="the arms cannot reach this position"):
        take("klipper", {"printer.cfg": text}, tmp_path)


def test_another_machine_is_refused_with_the_way_in(tmp_path):
    text = example().replace("kinematics: delta", "kinematics: winch")
    with pytest.raises(InputError, match=r"line 2, \[printer\] kin.*take `columns`"):
        take("klipper", {"printer.cfg": text}, tmp_path)
