"""Estimated noise laws and bad fits reach result.json, the report and the terminal."""

import itertools
import json
from pathlib import Path
from typing import Any

import bad_fit_sample
import bar_readings
import numpy as np
import pytest
import sample
from bad_fit_sample import STUDY, WITHOUT_REPORT, write
from scipy import stats

from oed.checks import explain
from oed.noise import reach_phrase
from pkm_studies.commands import main

ESTIMATE = ("length_um = 0.5", "length_um = 0.5\nestimate = true")
ESTIMATED = sample.changed(bad_fit_sample.STUDY, ESTIMATE)
ESTIMATED = sample.changed(bad_fit_sample.WITHOUT_REPORT, ESTIMATE)


def fit(folder: Path, readings: bar_readings.Readings, study: str) -> dict:
    """The section `goodness` of an identification."""
    path, table = bad_fit_sample.write(folder, readings)
    path.write_text(study, encoding="utf-8")
    out = str(folder / "fit")
    main(["identify", str(path), "--readings", str(table), "--out", out])
    text = (folder / "fit/result.json").read_text(encoding="utf-8")
    return json.loads(text)["goodness"]


def test_noise_above_the_stated_one_is_reported(tmp_path, capsys):
    """Readings scatter by 1.25 um, stated are 0.5 um."""
    goodness = fit(tmp_path, bar_readings.a3_readings(1, noise=1.25e-6), ESTIMATED)
    names = ["cup.length", "long_tool.length"]
    for name in names:
        record = goodness["noise"][f"reading {name}"]
        assert (record["unit"], record["stated"]) == ("um", 0.5)
        assert record["departs"]
        assert abs(record["value"] - 1.25) < 3.0 * record["sd"]
        assert 0.05 < record["sd"] < 0.5
    sentence = "The noise departs from the stated one: single readings of cup.length"
    out = capsys.readouterr().out
    assert [line for line in out.splitlines() if line.startswith(sentence)]
    page = (tmp_path / "fit/report.html").read_text(encoding="utf-8")
    assert "The noise law as estimated from the readings" in page
    assert sentence in page


def test_goodness_is_of_the_delivered_parameters_and_each_p_of_its_own_noise(tmp_path):
    """Circles shifted by 2 and 3 um: not by the stated noise of 0.5 um, but by a law of runs."""
    readings = bar_readings.a3_readings(2)
    shift = np.repeat([3e-6, -3e-6, 2e-6, -2e-6], bar_readings.POINTS)
    goodness = fit(tmp_path, readings.with_y(readings.y + shift), ESTIMATED)
    text = (tmp_path / "fit/result.json").read_text(encoding="utf-8")
    estimate = json.loads(text)["estimate"]
    noise = goodness["noise"]
    assert noise["run cup.length"]["value"] > noise["reading cup.length"]["value"]
    assert 0.0 < noise["reach"]["value"] <= bar_readings.POINTS
    chi2 = float(np.sum((np.array(estimate["residuals"]) / 0.5) ** 2))  # um
    assert goodness["chi2"] == pytest.approx(chi2, rel=1e-9)
    assert (estimate["chi2"], estimate["dof"]) == (goodness["chi2"], goodness["dof"])
    p = stats.chi2.sf(chi2, goodness["dof"])
    assert p < 1e-12
    assert goodness["p_high"] < 1e-9
    assert goodness["law_p_high"] > 0.01
    ratio = np.sqrt(chi2 / goodness["dof"])
    assert any(f"{ratio:.1f} times the stated" in w for w in estimate["warnings"])
    page = (tmp_path / "fit/report.html").read_text(encoding="utf-8")
    assert "more than the stated noise leaves at these parameters" in page
    assert "as the stated noise predicts" not in page
    assert "By the noise law as estimated" in page


def test_noise_as_stated_departs_from_nothing(tmp_path):
    goodness = fit(tmp_path, bar_readings.a3_readings(0), ESTIMATED)
    assert not goodness["noise_words"]
    assert not any(record["departs"] for record in goodness["noise"].values())
    assert 1e-3 < goodness["p_low"] < 1.0 - 1e-3
    assert goodness["p_low"] + goodness["p_high"] == pytest.approx(1.0)


@pytest.mark.parametrize(("reach", "longest", "words"), [
    (22145.0, 27, "over whole runs of up to 27 readings"),
    (20.0, 27, "over whole runs of up to 27 readings"),
    (5.2, 27, "over about 5 readings"),
    (0.3, 27, "to the next reading"),
    (300.0, float("inf"), "over about 300 readings"),
])  # fmt: skip
def test_a_reach_is_what_the_runs_can_show(reach, longest, words):
    assert reach_phrase(reach, longest) == words


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
