"""`oed import klipper`: the block that SAVE_CONFIG wrote, and positions that are stale."""

import numpy as np
import pytest
from oracles.firmware.geometry import Probe, delta, spiral
from oracles.firmware.klipper import HEADER, Klipper, example

from pkm_studies.base import InputError
from printers.delta_printer import nominal, take

REAL = delta(110.3, 250.0, [210.3, 329.8, 90.0], [260.2, 259.7, 260.3])


def printer() -> Klipper:
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
    text = printer().text()
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
    study, _ = take("klipper", {"printer.cfg": printer().text() + "\n\n"}, tmp_path)
    assert nominal(study)["radius_mm"] == 110.0


@pytest.mark.parametrize(
    ("factor", "words"), [(2.0, "below.*2 times"), (0.5, "above.*0.5 times")]
)
@pytest.mark.parametrize("stale", ["distance", "height"])
def test_positions_saved_with_other_steps_are_named_at_import(
    stale, factor, words, tmp_path
):
    firmware = printer()
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
    text = printer().text().replace("angle = 330", "angle = 210")
    with pytest.raises(InputError, match="the arms cannot reach this position"):
        take("klipper", {"printer.cfg": text}, tmp_path)


def test_another_machine_is_refused_with_the_way_in(tmp_path):
    text = example().replace("kinematics: delta", "kinematics: winch")
    with pytest.raises(InputError, match=r"line 2, \[printer\] kin.*take `columns`"):
        take("klipper", {"printer.cfg": text}, tmp_path)
