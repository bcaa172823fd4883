"""What a file says of its columns."""

from pathlib import Path

from shipped_models import prs_spindle

from oed.instrument import Instrument
from pkm_studies import catalogue
from pkm_studies.base import Location
from pkm_studies.resolve import conventions


def instrument(name: str) -> Instrument:
    return catalogue.instrument(name, Path(), Location("catalogue"))


def test_columns_of_a_file_are_stated_above_its_header():
    m = prs_spindle.machine
    tool = instrument("pose_tracker")
    header = [
        "setup", "run", "order", "alpha_deg", "q1_mm", "read_alpha_mrad", "time_s",
    ]  # fmt: skip
    lines = conventions.readings_comments(m, {"t": tool}, header)
    assert lines[0].startswith("base frame: ")
    stated = {line.partition(": ")[0] for line in lines}
    assert {"alpha_deg", "q1_mm", "read_alpha_mrad"} <= stated
    both = {"a": instrument("ball_bar"), "b": instrument("calliper")}
    (line,) = [
        line
        for line in conventions.readings_comments(m, both, ["length_mm"])
        if line.startswith("length_mm")
    ]
    assert "a: distance from the cup" in line
    assert "b: distance between the tool points" in line
