"""Checks of readings against the table of blunders, and against correct sessions."""

import itertools

import blunder_machines as machines
import numpy as np
import pytest
from blunder_table import BLUNDERS, CHANGES, ROWS, page_rows
from blunder_tables import LAWS

from oed.checks import Severity

#: blunders that the default suite executes, of each kind; the nightly one executes all,
#: and tests/oed/checks undoes each kind of mistake
QUICK = {
    "columns of one line exchanged",
    "one reading off by 50 sigma",
    "computed, not measured",
    "sign of x",
    "a clock of 12 hours",
    "two set-ups at the same times",
}
CASES = [
    pytest.param(b, marks=() if b.name in QUICK else pytest.mark.slow, id=b.name)
    for b in BLUNDERS
]


@pytest.mark.parametrize("blunder", CASES)
def test_blunder(blunder):
    law = "smoothed" if blunder.name == "smoothed readings" else "white"
    rows = machines.readings(blunder.machine, 0, law)
    checked = machines.check(blunder.machine, blunder.make(rows))
    sentences = [f.sentence for f in checked.findings]
    if not blunder.sentence:
        assert not sentences
        return
    assert blunder.is_named(sentences), sentences
    named = {row for finding in checked.findings for row in finding.rows}
    assert set(blunder.rows) <= named


#: laws of noise in turn, one for each machine
IN_TURN = dict(zip(machines.MACHINES, itertools.cycle(LAWS), strict=False))


@pytest.mark.parametrize(("machine", "law"), IN_TURN.items())
def test_no_false_alarm(machine, law):
    """Of heavy tails, a remark may name a far reading; it is no alarm."""
    checked = machines.check(machine, machines.readings(machine, 0, law))
    alarms = [f for f in checked.findings if f.severity < Severity.REMARK]
    assert not alarms, [f.sentence for f in alarms]
    assert law == "t4" or not checked.findings


def test_the_page_lists_every_blunder():
    assert sorted(name for name, *_ in page_rows()) == sorted(CHANGES)
    assert CHANGES.keys() >= ROWS.keys()


def test_misfits_that_are_no_noise_are_not_blamed_on_it():
    """Readings of another machine: 600 times the noise and more."""
    rng = np.random.default_rng(5)
    rows = machines.readings("delta", 0)
    heights = rows["setup"] == "probe"
    rows.loc[heights, "height_mm"] += rng.uniform(-20.0, 20.0, heights.sum())
    checked = machines.check("delta", rows)
    assert checked.bad_fit
    assert all("understated" not in f.sentence for f in checked.findings)
