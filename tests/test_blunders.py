"""Checks of readings against the table of blunders, and against correct sessions."""

from __future__ import annotations

import re
from pathlib import Path

import blunders
import numpy as np
import pytest
from blunders import BLUNDERS, Blunder

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "blunders.md"
#: blunders that the default suite executes; the nightly one executes all
QUICK = {
    "um in a column of mm",
    "columns exchanged",
    "readings one row late",
    "two rows exchanged",
    "one reading off by 50 sigma",
    "computed, not measured",
}
CASES = [
    pytest.param(b, marks=() if b.name in QUICK else pytest.mark.slow, id=b.name)
    for b in BLUNDERS
]


def readings_of(machine: str, seed: int) -> blunders.Readings:
    if machine == "a3":
        return blunders.a3_readings(seed)
    return blunders.planar_readings(seed)


@pytest.mark.parametrize("blunder", CASES)
def test_blunder(blunder: Blunder) -> None:
    readings = blunder.make(readings_of(blunder.machine, 0))
    checked = blunders.check(blunder.machine, readings)
    if not blunder.sentence:
        assert not checked.findings
        return
    named = [f for f in checked.findings if blunder.sentence in f.sentence]
    assert named, [f.sentence for f in checked.findings]
    rows = {row for finding in checked.findings for row in finding.rows}
    assert set(blunder.rows) <= rows


@pytest.mark.parametrize("machine", ["a3", "planar"])
@pytest.mark.parametrize(
    "seeds",
    [range(2), pytest.param(range(2, 100), marks=pytest.mark.slow, id="nightly")],
)
def test_no_false_alarm(machine: str, seeds: range) -> None:
    for seed in seeds:
        checked = blunders.check(machine, readings_of(machine, seed))
        assert not checked.findings, (seed, [f.sentence for f in checked.findings])


def test_the_page_lists_every_blunder() -> None:
    text = PAGE.read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| (.+?) \| (.+?) \|", text, re.MULTILINE)
    assert [name for _, name, _ in rows] == [b.name for b in BLUNDERS]
    shown = [sentence for _, _, sentence in rows]
    assert shown == [b.sentence or "nothing: it cannot be seen" for b in BLUNDERS]
    assert len(rows) == 24


def test_an_outlier_leaves_the_other_readings() -> None:
    """The pull of a reading is its error over what the others predict it to."""
    readings = blunders.a3_readings(3)
    y = readings.y.copy()
    y[17] += 50 * blunders.SIGMA
    checked = blunders.check("a3", readings.with_y(y))
    assert checked.set_aside == (17,)
    assert checked.outliers is not None
    assert checked.outliers.errors[0] == pytest.approx(25e-6, abs=3e-6)
    assert not np.isin(17, checked.outliers.solution.session.values["row"] - 2)
