"""A summary on the terminal has few lines, and hides nothing that a user must see."""

from typing import Any

import pytest
import report_fixture
import report_fixture_plan

from oed.result import StudyResult
from pkm_reports import text
from pkm_reports.blocks import Block, Notice, Table
from pkm_reports.sections import answer
from pkm_studies.commands import display
from pkm_studies.stages import headline

MET = {"claim": "rank", "wanted": "rank = 18", "measured": 18, "met": True}
UNMET = {"claim": "kappa", "wanted": "kappa <= 9", "measured": 12.5, "met": False}
WARNING = "a1x ended near a bound"
#: lines of a summary of a result with a table of six components and an unmet claim
MAX_LINES = 12


def sample(**changes: Any) -> StudyResult:
    """The full result of the fixture with its headline as the pipeline writes it."""
    raw = report_fixture.sample() | changes
    sentences = headline.sentences(report_fixture.result_of(raw))
    return report_fixture.result_of(raw | {"headline": sentences})


def held_out(channel: str, verdict: str) -> dict[str, Any]:
    return {
        "name": "blind", "channel": channel, "n": 9, "rms": 5.0, "rms_raw": 6.0,
        "unit": "um", "coverage": 0.89, "residuals": [], "half_widths": [],
        "predicted": 4.0, "rms_before": 70.0, "verdict": verdict,
        "words": f"{channel}: {verdict}",
    }  # fmt: skip


def test_a_summary_keeps_warnings_and_claims_that_are_not_met(tmp_path):
    result = sample(claims=[MET, UNMET], warnings=[WARNING])
    (tmp_path / "report.html").touch()
    short = headline.lines(result, tmp_path, verbose=False)
    assert len(short) <= MAX_LINES
    assert "Claim kappa: not met: kappa <= 9, measured 12.5" in short
    assert f"Warning: A{WARNING[1:]}." in short
    assert f"Report: {tmp_path / 'report.html'}" in short
    assert short[-1].startswith("Claims: 1 of 2 met. --verbose prints every sentence")


def test_verbose_prints_every_sentence(tmp_path):
    result = sample(claims=[MET])
    short = headline.lines(result, tmp_path, verbose=False)
    full = headline.lines(result, tmp_path, verbose=True)
    assert set(result.headline) <= set(full)
    assert "Claim rank: met: rank = 18, measured 18" in full
    assert not set(result.headline) <= set(short)


def test_a_contradiction_is_never_summed_up(tmp_path):
    sections = [held_out("x", "confirms"), held_out("y", "contradicts")]
    result = sample(held_out=sections)
    short = headline.lines(result, tmp_path, verbose=False)
    assert "y: contradicts." in short
    assert "x: confirms." not in short
    (line,) = [line for line in short if "Held-out readings" in line]
    assert "agree with the fit in 1 of 2 channels, in 1 better than with" in line


def test_readings_that_agree_do_not_read_as_a_failure(tmp_path):
    sections = [held_out(name, "agrees") for name in "xyzu"]
    lines = headline.lines(sample(held_out=sections), tmp_path, verbose=False)
    (line,) = [line for line in lines if "Held-out readings" in line]
    line = line[line.index("Held-out readings") :]
    assert "agree with the fit in 4 of 4 channels, in none better" in line
    assert "0 of 4" not in line
    assert line.count("%") == 2  # one share, for all have the same, of 95 %


def test_stages_of_a_plan_are_rows_with_a_column_for_each_accuracy():
    raw = report_fixture.bare() | {"plan": report_fixture_plan.plan(wanted=True)}
    plan = report_fixture.result_of(raw).plan
    printed = display.plan_lines(plan, verbose=False)
    last = plan.stages[-1]
    for value in last.accuracy.values():
        assert any(f"{value:.3g}" in line.split() for line in printed)
    assert all(len(line) <= 120 or not line.startswith(" ") for line in printed)
    named = [s.name for s in plan.compared]
    full = display.plan_lines(plan, verbose=True)
    assert sum(line.split(":")[0] in named for line in full) == len(named)


# -- the first page of the report ------------------------------------------------------
def table_of(blocks: list[Block], caption: str) -> Table:
    (table,) = [
        block
        for block in blocks
        if isinstance(block, Table) and caption in block.caption
    ]
    return table


def test_held_out_channels_are_rows_and_contradictions_notices():
    sections = [held_out(name, "confirms") for name in "xyz"]
    sections.append(held_out("a", "contradicts"))
    blocks = answer.accuracy_blocks(sample(held_out=sections))
    table = table_of(blocks, "Held-out readings of blind (9)")
    assert table.rows[0] == ["x [µm]", "4", "5", "70", text.percent(0.89)]
    assert len(table.rows) == 3
    assert any(isinstance(b, Notice) and "contradicts" in b.text for b in blocks)


def test_the_readings_stand_in_their_order():
    result = sample()
    poses = result.design.poses
    table = table_of(answer.measure_blocks(result), "in their order")
    titles = [column.title for column in table.columns]
    z = titles.index("z [mm]")
    heights = [float(row[z]) for row in table.rows]
    assert heights == pytest.approx([pose.command["z_mm"] for pose in poses])
    assert [row[titles.index("Set-up")] for row in table.rows] == [
        pose.setup for pose in poses
    ]
