"""A bad fit is loud: first line, exit code, and no accuracy predicted from it."""

import itertools
import json
from pathlib import Path
from typing import Any

import bar_readings
import pytest
from bad_fit_sample import STUDY, WITHOUT_REPORT, write

from oed.checks import explain
from pkm_studies.commands import main


def identify(folder: Path, readings: bar_readings.Readings, text: str = STUDY) -> int:
    study, table = write(folder, readings, text)
    out = str(folder / "fit")
    return main(["identify", str(study), "--readings", str(table), "--out", out])


@pytest.mark.mistakes
def test_a_mistake_is_the_first_line_and_predicts_nothing(
    tmp_path, capsys, monkeypatch
):
    readings = bar_readings.a3_readings(0)
    ranked = explain.candidates

    def of_signs(*given: Any, **options: Any) -> tuple[list[Any], list[Any]]:
        """Rivals of other kinds are compared in tests/oed/checks."""
        every = itertools.chain(*ranked(*given, **options))
        return [one for one in every if one.trial.kind == "sign"], []

    monkeypatch.setattr(explain, "candidates", of_signs)
    turned = readings.with_y(2.0 * bar_readings.LENGTH - readings.y)
    assert identify(tmp_path, turned) == 1
    out = capsys.readouterr().out
    first = "The readings look mistaken: the sign of the deviations of length_mm"
    lines = out.splitlines()
    stages = lines.index("report") + 1
    assert lines[stages].startswith(first)
    assert "The predicted accuracy is withheld" in out
    result = json.loads((tmp_path / "fit/result.json").read_text())
    assert result["prediction"] is None
    assert result["goodness"]["bad_fit"]
    assert "is reversed" in result["goodness"]["mistakes"][0]["what"]
    page = (tmp_path / "fit/report.html").read_text(encoding="utf-8")
    assert 0 < page.index(first) < page.index('id="identif')


def test_an_outlier_is_named_and_set_aside(tmp_path, capsys):
    readings = bar_readings.a3_readings(0)
    y = readings.y.copy()
    y[17] += 50 * bar_readings.SIGMA
    assert identify(tmp_path, readings.with_y(y), WITHOUT_REPORT) == 0
    assert "Row 19, column length_mm" in capsys.readouterr().out
    result = json.loads((tmp_path / "fit/result.json").read_text())
    assert [o["row"] for o in result["goodness"]["outliers"]] == [19]
    assert result["estimate"]["readings"] == len(y) - 1
    assert result["prediction"] is not None
