"""Sentences and table on the predicted accuracy say what becomes of each component."""

import re
from typing import Any

import pytest
import report_fixture

from oed.result import StudyResult
from pkm_reports import sections as answer
from pkm_reports.blocks import Table
from pkm_studies.stages import headline


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
        "fitted": dict.fromkeys(after, 7.1),
    }
    counted = {
        name: component | {"after": spread(usual["unmodelled"][name], units[name])}
        for name, component in components.items()
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
        "mode": "plan",
        "components": components,
        "unit": units,
        "map": [],
        "realised": None,
        "budget": {
            "predicted": after,
            "lines": [line],
            "unmodelled": [unmodelled],
            "usual": usual | {"components": counted},
        },
    }
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
    parts = answer.answer_parts(report_fixture.result_of(raw))
    (part,) = [part for part in parts if part.anchor == "how-accurate"]
    words = " ".join(getattr(block, "text", "") for block in part.blocks)
    (sentence,) = re.findall(r"No drive corrects (.*?):", words)
    assert re.split(", | and ", sentence) == others


def test_the_first_page_says_what_the_model_lacks():
    parts = {p.anchor: p for p in answer.answer_parts(result(CHANGES))}
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
