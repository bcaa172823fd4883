"""Times as one says them, and the readings that they have room for."""

import pytest

from pkm_studies import catalogue
from pkm_studies.base import InputError, Location
from pkm_studies.drafts import read_time, write_draft
from pkm_studies.study import Study
from pkm_studies.user_code import Origin


@pytest.mark.parametrize(("text", "hours"), [
    ("90", 1.5), ("90 min", 1.5), ("two days", 16.0), ("1,5 h", 1.5), ("2d", 16.0),
    ("half a day", 4.0), ("a half hour", 0.5), ("a week", 40.0),
    ("two and a half hours", 2.5), ("One Hour", 1.0),
])  # fmt: skip
def test_a_time_as_one_says_it(text, hours):
    """By hand; a day has eight hours at the machine, a week five days."""
    assert read_time(text) == pytest.approx(3600.0 * hours)


@pytest.mark.parametrize("text", ["soon", "", "-3 h", "3 parsecs", "1e9 h" * 20])
def test_what_is_no_time_is_refused(text):
    with pytest.raises(InputError, match="two days"):
        read_time(text)


def test_a_draft_has_the_readings_of_its_time(tmp_path):
    """Mounting and readings by the instrument's own times, counted here."""
    origin = Origin(tmp_path)
    tool = catalogue.instrument("pose_tracker_position", origin, Location("test"))
    seconds = tool.cost.setup + 40.5 * tool.cost.reading
    path = write_draft("timed", "delta", "pose_tracker_position", origin, seconds)
    design = Study.load(path).design
    assert design.size == 40


def test_too_short_a_time_is_refused(tmp_path):
    with pytest.raises(InputError, match="too short"):
        write_draft("timed", "delta", "pose_tracker_position", Origin(tmp_path), 60.0)
    assert list(tmp_path.iterdir()) == []
