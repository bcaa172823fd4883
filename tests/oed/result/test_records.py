"""What records say of themselves, and how they are read and written."""

import msgspec
import numpy as np
import pytest

from oed import result
from oed.result import (
    AnswerRecord,
    ComponentAccuracy,
    GapSection,
    GoodnessSection,
    SpreadRecord,
)
from oed.result.record import Record


def test_what_no_drive_corrects_is_judged_by_its_unknown_part():
    sizes = [SpreadRecord(k, k, k, "um") for k in (1.0, 2.0, 3.0)]
    driven = ComponentAccuracy(True, *sizes, {})
    free = ComponentAccuracy(False, *sizes, {})
    assert (driven.judged.rms, free.judged.rms) == (2.0, 3.0)


def test_what_readings_cannot_show_is_no_visible_probability():
    answer = AnswerRecord(["play"], 0.7, unseen=0.2)
    assert answer.visible == pytest.approx(0.5)


def test_every_record_is_frozen_and_refuses_unknown_fields():
    """An edited file is never read in part."""
    assert result.StudyResult in Record.__subclasses__()
    records = [r for r in Record.__subclasses__() if r.__module__.startswith("oed.")]
    assert len(records) > 60
    for record in records:
        assert record.__struct_config__.frozen
        assert record.__struct_config__.forbid_unknown_fields


def test_missing_numbers_are_null_in_the_file():
    section = GoodnessSection(None, 3.0, None, np.nan)
    plain = msgspec.json.decode(msgspec.json.encode(section))
    assert (plain["chi2"], plain["dof"], plain["p_high"]) == (None, 3.0, None)


def test_no_gap_is_reported_from_where_both_errors_cost_as_much():
    """P times a test in vain is (1 - P) times a missed gap."""
    missed, p = GapSection.MISSED_GAP_COST, GapSection.NO_GAP_PROBABILITY
    assert missed * (1.0 - p) == pytest.approx(p)
