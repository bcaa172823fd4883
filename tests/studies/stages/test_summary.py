"""What the terminal and the first page say: summaries, accuracy of each component."""

import re
from typing import Any

import pytest
import report_fixture
import report_fixture_plan

from oed.result import StudyResult
from pkm_reports import sections, text
from pkm_reports.blocks import Block, Notice, Table
from pkm_reports.sections import answer, measure
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
    table = table_of(measure.measure_blocks(result), "in their order")
    titles = [column.title for column in table.columns]
    z = titles.index("z [mm]")
    heights = [float(row[z]) for row in table.rows]
    assert heights == pytest.approx([pose.command["z_mm"] for pose in poses])
    assert [row[titles.index("Set-up")] for row in table.rows] == [
        pose.setup for pose in poses
    ]


def spread(rms: float, unit: str) -> dict[str, Any]:
    return {"rms": rms, "p95": 2.0 * rms, "max": 3.0 * rms, "unit": unit}


def result(changes: dict[str, tuple[float, float]]) -> StudyResult:
    """A result whose components have these rms errors, before and after."""
    raw = report_fixture.bare()
    full = report_fixture.sample()["prediction"]
    units = {name: full["unit"][name] for name in changes}
    components = {
        name: {
            "compensatable": True, "before": spread(before, units[name]),
            "after": spread(after, units[name]), "known": spread(after, units[name]),
            "budget": {},
        }
        for name, (before, after) in changes.items()
    }  # fmt: skip
    after = {name: end for name, (_, end) in changes.items()}
    unmodelled = {
        "effect": "pitch_accumulation", "about": "", "expected": "10 um", "size": after,
        "with_it": {name: 11.5 * value for name, value in after.items()},
        "far": {name: 345.0 * value for name, value in after.items()},
        "remedy": "measure each joint's travel",
    }  # fmt: skip
    usual = {
        "effects": ["pitch_accumulation", "backlash"],
        "unmodelled": {"z": 1300.0, "psi": 240.0, "theta": 15.2},
        "fitted": dict.fromkeys(after, 7.1),
    }
    counted = {
        name: component | {"after": spread(usual["unmodelled"][name], units[name])}
        for name, component in components.items()
    }
    line = {
        "source": "noise of ball_bar", "kind": "instrument", "share": after,
        "size": after,
        "halved": {name: 0.5 * value for name, value in after.items()},
    }  # fmt: skip
    raw["prediction"] = {
        **full, "mode": "plan", "components": components, "unit": units, "map": [],
        "realised": None,
        "budget": {
            "predicted": after,
            "lines": [line],
            "unmodelled": [unmodelled],
            "usual": usual | {"components": counted},
        },
    }  # fmt: skip
    return report_fixture.result_of(raw)


@pytest.mark.parametrize(("changes", "words"), [
    ({"z": (1208.0, 97.2), "psi": (223.0, 223.1)},
     "reduce the rms error over the workspace, zeroed at home: z from 1208 to"
     " 97.2 um, and to leave as it is: psi 223 arcsec."),
    ({"z": (223.0, 223.0), "psi": (5.0, 5.0)},
     "leave the rms error over the workspace, zeroed at home as it is: z 223 um; psi 5 arcsec."),
    ({"z": (10.0, 5.0), "psi": (5.0, 7.0)},
     "zeroed at home: z from 10 to 5 um, and to increase it: psi from 5 to 7 arcsec."),
])  # fmt: skip
def test_what_does_not_change_is_not_reduced(changes, words):
    (sentence,) = [
        sentence
        for sentence in headline.sentences(result(changes))
        if sentence.startswith("Compensation is predicted to ")
    ]
    assert sentence.endswith(words)


CHANGES = {"z": (1208.0, 97.2), "psi": (3488.0, 20.6), "theta": (403.0, 1.31)}


def test_the_terminal_and_the_report_have_one_accuracy(tmp_path):
    lines = headline.lines(result(CHANGES), tmp_path, verbose=False)
    (row,) = [line for line in lines if line.split()[:1] == ["z"]]
    assert row.split()[2:4] == ["1208", "1300"]
    printed = "\n".join(lines)
    assert "97.2" not in printed  # geometry alone, which no machine is
    assert "z 1300 um" in printed
    assert "with usual effects at their expected sizes" in printed
    assert "What removes it: measure each joint's travel." in printed


def test_what_no_drive_corrects_is_said_on_the_first_page():
    full = report_fixture.sample()["prediction"]["components"]
    others = [name for name, c in full.items() if not c["compensatable"]]
    assert others
    raw = report_fixture.bare() | {"prediction": report_fixture.sample()["prediction"]}
    parts = sections.answer_parts(report_fixture.result_of(raw))
    (part,) = [part for part in parts if part.anchor == "how-accurate"]
    words = " ".join(getattr(block, "text", "") for block in part.blocks)
    (sentence,) = re.findall(r"No drive corrects (.*?):", words)
    assert re.split(", | and ", sentence) == others


def test_the_first_page_says_what_the_model_lacks():
    parts = {p.anchor: p for p in sections.answer_parts(result(CHANGES))}
    words = " ".join(getattr(block, "text", "") for block in parts["short"].blocks)
    plain = words.replace("\N{NO-BREAK SPACE}", " ")
    assert "pitch accumulation, counted at its usual size of 10 µm" in plain
    assert "What removes it: measure each joint's travel." in plain
    part = parts["how-accurate"]
    (table,) = [block for block in part.blocks if isinstance(block, Table)]
    titles = [column.title for column in table.columns]
    z = dict(zip(titles, table.rows[0], strict=True))
    assert z["Afterwards"] == "1300"
    assert "97.2" not in plain  # one accuracy a component
