"""Sentences and table on the predicted accuracy say what becomes of each component."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import report_fixture

from oed.result import StudyResult
from pkm_reports import sections as answer
from pkm_reports.blocks import Table
from pkm_studies.stages import headline, outcome, summary


def spread(rms: float, unit: str) -> dict[str, Any]:
    return {"rms": rms, "p95": 2.0 * rms, "max": 3.0 * rms, "unit": unit}


def result(changes: dict[str, tuple[float, float]]) -> StudyResult:
    """A result whose components have these rms errors, before and after."""
    raw = report_fixture.bare()
    full = report_fixture.sample()["prediction"]
    units = {name: full["unit"][name] for name in changes}
    components = {
        name: {
            "compensatable": True,
            "before": spread(before, units[name]),
            "after": spread(after, units[name]),
            "known": spread(after, units[name]),
            "budget": {},
        }
        for name, (before, after) in changes.items()
    }
    after = {name: end for name, (_, end) in changes.items()}
    unmodelled = {
        "effect": "pitch_accumulation",
        "about": "",
        "expected": "10 um",
        "size": after,
        "with_it": {name: 11.5 * value for name, value in after.items()},
        "far": {name: 345.0 * value for name, value in after.items()},
        "remedy": "measure each joint's travel",
    }
    usual = {
        "effects": ["pitch_accumulation", "backlash"],
        "unmodelled": {"z": 1300.0, "psi": 240.0, "theta": 15.2},
        "fitted": {"z": 300.0, "psi": 90.0, "theta": 7.1},
    }
    line = {
        "source": "noise of ball_bar",
        "kind": "instrument",
        "share": after,
        "size": after,
        "halved": {name: 0.5 * value for name, value in after.items()},
    }
    raw["prediction"] = {
        **full,
        "components": components,
        "unit": units,
        "map": [],
        "realised": None,
        "budget": {
            "predicted": after,
            "lines": [line],
            "unmodelled": [unmodelled],
            "usual": {
                part: values
                if part == "effects"
                else {name: values[name] for name in after}
                for part, values in usual.items()
            },
        },
    }
    return report_fixture.result_of(raw)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"z": (1208.0, 97.2), "psi": (223.0, 223.1)},
            "reduce the rms error over the workspace, zeroed at home: z from 1208 to"
            " 97.2 um, and to leave as it is: psi 223 arcsec.",
        ),
        (
            {"z": (223.0, 223.0), "psi": (5.0, 5.0)},
            "leave the rms error over the workspace, zeroed at home as it is: z 223 um;"
            " psi 5 arcsec.",
        ),
        (
            {"z": (10.0, 5.0), "psi": (5.0, 7.0)},
            "zeroed at home: z from 10 to 5 um, and to increase it: psi from 5 to 7"
            " arcsec.",
        ),
    ],
)
def test_what_does_not_change_is_not_reduced(
    changes: dict[str, tuple[float, float]], words: str
) -> None:
    sentence = headline.accuracy_sentences(result(changes))[0]
    assert sentence.startswith("Compensation is predicted to ")
    assert sentence.endswith(words)


CHANGES = {"z": (1208.0, 97.2), "psi": (3488.0, 20.6), "theta": (403.0, 1.31)}


def test_the_terminal_has_each_figure_once() -> None:
    lines = summary.accuracy_lines(result(CHANGES))
    assert len(lines) <= 25
    text = "\n".join(lines)
    for figure in ("1208", "97.2", "20.6", "1.31", "1118", "48.6"):
        assert text.count(figure) == 1
    (row,) = [line for line in lines if "pitch_accumulation of 10 um" in line]
    assert row.split()[-3:] == ["1118", "237", "15.1"]
    (row,) = [line for line in lines if "+ all 2 usual effects" in line]
    assert row.split()[-3:] == ["1300", "240", "15.2"]
    (row,) = [line for line in lines if "in the fit and corrected" in line]
    assert row.split()[-3:] == ["300", "90", "7.1"]
    assert [line for line in lines if "half the noise of ball_bar" in line]
    assert "Remedy: measure each joint's travel." in text


def test_what_no_drive_corrects_is_below_the_table() -> None:
    full = report_fixture.sample()["prediction"]["components"]
    others = [name for name, c in full.items() if not c["compensatable"]]
    assert others
    raw = report_fixture.bare() | {"prediction": report_fixture.sample()["prediction"]}
    out = "\n".join(summary.accuracy_lines(report_fixture.result_of(raw)))
    (sentence,) = re.findall(r"No drive corrects (.*)\.$", out, re.MULTILINE)
    assert [part.split()[0] for part in sentence.split("; ")] == others
    assert sentence.count("with further axes") == len(others)


def test_the_headline_is_not_printed_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    of = result(CHANGES)
    sentences = [*headline.accuracy_sentences(of), "The readings determine 3 of 3."]
    raw = report_fixture.bare() | {"headline": sentences}
    plain = report_fixture.result_of(raw)
    shown = StudyResult(
        **{
            name: getattr(plain if name == "headline" else of, name)
            for name in StudyResult.__struct_fields__
        }
    )
    assert outcome.report_outcome(shown, tmp_path, quiet=False) == 0
    out = capsys.readouterr().out
    assert "The readings determine 3 of 3." in out
    assert "Compensation is predicted to" not in out
    assert out.count("97.2") == 1


def test_the_first_page_says_what_the_model_lacks() -> None:
    (part,) = [
        p for p in answer.answer_parts(result(CHANGES)) if p.anchor == "how-accurate"
    ]
    words = " ".join(getattr(block, "text", "") for block in part.blocks)
    plain = words.replace("\N{NO-BREAK SPACE}", " ")
    assert "pitch accumulation of its expected size (10 µm)" in plain
    assert "Remedy: measure each joint's travel." in plain
    (table,) = [block for block in part.blocks if isinstance(block, Table)]
    titles = [column.title for column in table.columns]
    z = dict(zip(titles, table.rows[0], strict=True))
    assert (z["After"], z["With effects"], z["Corrected"]) == ("97.2", "1300", "300")
    assert "1300" not in plain  # each figure once
