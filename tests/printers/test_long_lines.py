"""Lines of a printer's files that are longer than any that it writes."""

import time

import pytest

from pkm_printers import facts, gcode, klipper_config
from pkm_studies.base import InputError

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
