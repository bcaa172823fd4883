"""Rows that are set aside: only where the readings locate them, and no sound ones."""

import dataclasses
import functools
import json
import re
from pathlib import Path
from typing import Any

import bar_readings
import numpy as np
import pytest
from bad_fit_sample import STUDY, WITHOUT_REPORT, write

from kernel import a3_plans
from kernel.a3_machines import NOISE, exact, measured
from oed import checks
from oed.checks import sentences
from oed.checks.fit import Goodness
from oed.checks.outliers import find_outliers
from oed.measurement import Measurement, Series
from pkm_studies.commands import main
from pkm_studies.importers import import_files

PLAIN = "\n[posterior]\nenabled = false\n"
#: Klipper's delta: radius and arm, endstops by tower, towers, probed circle (mm), step
RADIUS, ARM, ENDSTOPS = 110.0, 250.0, (260.0, 260.4, 259.7)
TOWERS = np.radians([210.0, 330.0, 90.0])
CIRCLE, STEP = 70.0, 0.01
#: amplitude in sigma of an effect that is in no model, and its harmonic
EFFECT, HARMONIC = 3.0, 5


def call(*arguments: object) -> int:
    return main([str(one) for one in arguments])


def klipper(dent: float) -> str:
    """Klipper's file of seven heights: the six of a circle are off by +-dent mm.

    No radius, angle or endstop gives such heights; with one degree of freedom they show
    that something is wrong, and not what.
    """
    towers = RADIUS * np.column_stack([np.cos(TOWERS), np.sin(TOWERS)])
    angles = np.radians(np.arange(30, 390, 60))
    circle = CIRCLE * np.column_stack([np.cos(angles), np.sin(angles)])
    lines = ["[printer]\nkinematics: delta\ndelta_radius: 110"]
    for k, tower in enumerate("abc"):
        lines += [f"[stepper_{tower}]\nstep_distance: {STEP}\narm_length: {ARM:.0f}"]
        lines += [f"position_endstop: {ENDSTOPS[k]}"]
        lines += [f"angle: {np.degrees(TOWERS[k]):.0f}"]
    lines += ["[delta_calibrate]", f"radius: {CIRCLE:.0f}"]
    for k, point in enumerate(np.vstack([np.zeros(2), circle])):
        height = -dent * (-1) ** k if k else 0.0
        distance = np.linalg.norm(towers - point, axis=1)
        above = np.sqrt(ARM**2 - RADIUS**2) - np.sqrt(ARM**2 - distance**2)
        down = (np.array(ENDSTOPS) + above - height) / STEP
        lines += [
            f"height{k}: 0.0",
            f"height{k}_pos: {','.join(f'{d:.3f}' for d in down)}",
        ]
    return "\n".join([*lines, ""])


def test_seven_heights_detect_an_error_and_locate_none(tmp_path, capsys):
    path = tmp_path / "printer.cfg"
    path.write_text(klipper(0.18), encoding="utf-8")
    study, _ = import_files("klipper", [path], tmp_path / "in", name="q")
    lines = (tmp_path / "in" / "q.readings.csv").read_text("utf-8").splitlines()
    centre = 2 + next(k for k, line in enumerate(lines) if line.startswith("setup,"))
    circle = list(range(centre + 1, centre + 7))
    study.write_text(study.read_text("utf-8") + PLAIN, encoding="utf-8")
    out = tmp_path / "out"
    assert call("run", study, "--out", out) == 1
    assert "the fit is bad" in capsys.readouterr().err
    result = json.loads((out / "result.json").read_text("utf-8"))
    goodness = result["goodness"]
    assert goodness["bad_fit"]
    assert goodness["outliers"] == []
    assert goodness["unlocated"] == circle
    assert result["estimate"]["readings"] == 7
    assert result["prediction"] is None
    first = result["headline"][0]
    assert f"any one of the rows {', '.join(map(str, circle))}" in first
    assert "cannot tell which one is wrong" in first
    assert_refused(out, capsys)
    assert call("compensate", out, "--to", "klipper", "--force") == 0


def assert_refused(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing that rests on the fit passes over it."""
    capsys.readouterr()
    for command in (("compensate", out, "--to", "csv"), ("verify", out)):
        assert call(*command) == 1
        printed = capsys.readouterr()
        assert "the fit is bad" in printed.err
        assert printed.out == ""
    assert call("report", out) == 0
    page = (out / "report.html").read_text("utf-8")
    assert "The fit is not to be trusted" in page


# -- figures with and without ----------------------------------------------------------
def with_effect(place: int | None = None) -> bar_readings.Readings:
    """48 readings of an A3 head with an effect of 1.4 to 2 sigma, one row off by 48."""
    readings = bar_readings.a3_readings(2)
    phase = 2.0 * np.pi * np.arange(len(readings.y)) / bar_readings.POINTS
    y = readings.y + EFFECT * bar_readings.SIGMA * np.cos(HARMONIC * phase)
    if place is not None:
        y[place] += 48.0 * bar_readings.SIGMA
    return readings.with_y(y)


def identified(folder, readings, drop=None):
    """result.json of the readings; with `drop`, the file lacks this row."""
    folder.mkdir()
    study, table = write(folder, readings, STUDY if drop is None else WITHOUT_REPORT)
    if drop is not None:
        lines = table.read_text("utf-8").splitlines()
        del lines[drop + 1]
        table.write_text("\n".join([*lines, ""]), encoding="utf-8")
    call("identify", study, "--readings", table, "--out", folder / "fit", "--quiet")
    return json.loads((folder / "fit" / "result.json").read_text("utf-8"))


def figures(result: Any) -> list[float]:
    goodness, estimate = result["goodness"], result["estimate"]
    numbers = [goodness[key] for key in ("chi2", "dof", "p_high")]
    numbers += [estimate[key] for key in ("chi2", "dof", "readings")]
    return [*numbers, estimate["rms_after"]["length"]]


@pytest.mark.mistakes(searched=False)
def test_every_figure_is_without_the_row_set_aside(tmp_path, capsys):
    """A bad fit as well: the row leaves, and what the effect leaves remains."""
    place = 17
    result = identified(tmp_path / "with", with_effect(place))
    without = identified(tmp_path / "without", with_effect(), drop=place)
    goodness = result["goodness"]
    assert [one["row"] for one in goodness["outliers"]] == [place + 2]
    assert goodness["bad_fit"]
    assert result["estimate"]["readings"] == len(with_effect().y) - 1
    assert figures(result) == pytest.approx(figures(without), rel=1e-6)
    ratio = (goodness["chi2"] / goodness["dof"]) ** 0.5
    assert 1.4 < ratio < 4.0
    assert result["estimate"]["rms_after"]["length"] < 1.3  # um; 2.4 with the row
    said = " ".join([*result["headline"], *result["warnings"]])
    times = [float(x) for x in re.findall(r"([\d.]+) times the stated noise", said)]
    assert times
    assert times == pytest.approx([ratio] * len(times), rel=0.2)
    assert "without the 1 row set aside (chi2" in said
    assert "The fit of 47 readings, without the 1 row set aside, changes" in said
    assert_refused(tmp_path / "with" / "fit", capsys)
    page = (tmp_path / "with" / "fit" / "report.html").read_text("utf-8")
    assert "without the 1 row set aside" in page


@pytest.mark.mistakes(searched=False)
@pytest.mark.parametrize("rows", [(20, 21, 22)])
def test_neighbours_off_the_same_way_stay_for_the_diagnosis(rows):
    """A local bump is no three typing errors; a typing error beside it is one."""
    readings = bar_readings.a3_readings(4)
    y = readings.y.copy()
    y[list(rows)] += 25.0 * bar_readings.SIGMA
    y[40] -= 300.0 * bar_readings.SIGMA
    checked = bar_readings.check(readings.with_y(y))
    assert checked.set_aside == (40,)
    assert checked.bad_fit
    named = [f for f in checked.findings if "are off the same way" in f.sentence]
    assert "rows 22, 23, 24" in named[0].sentence


# -- no degrees of freedom -------------------------------------------------------------
def test_without_freedom_no_multiple_of_the_noise_is_stated():
    readings = bar_readings.a3_readings(0)
    found = find_outliers(session_of(readings), np.empty(0, dtype=np.intp))
    assert found is not None
    fitted = Goodness(chi2=14.5, dof=0.04, p_low=1.0, p_high=1e-9)
    assert fitted.ratio is None
    sentence = sentences.too_large(session_of(readings), fitted, found).sentence
    assert "no machine within its tolerances gives these readings" in sentence
    assert "times the stated noise" not in sentence
    assert "degrees of freedom" not in sentence


def session_of(readings: bar_readings.Readings) -> checks.SessionReadings:
    return bar_readings.session(readings)


POINTS = 30


@functools.cache
def plan() -> tuple[Measurement, Series]:
    m = a3_plans.measurement()
    return m, a3_plans.circles(m, POINTS)


@pytest.mark.parametrize(("count", "size", "seed"), [(1, 50.0, 0), (3, 10.0, 60)])
def test_wrong_readings_are_named_and_no_others(count, size, seed):
    """One, or three of which two are neighbours."""
    m, series = plan()
    rng = np.random.default_rng([26, seed])
    truth = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
    y = measured(series, truth, rng)
    rows = rng.choice(2 * POINTS, 3, replace=False)[:count]
    y[rows] += size * NOISE * rng.choice([-1, 1], 3)[:count]
    session = checks.session_readings(m, [series], y)
    checked = checks.check_session(session, m, np.random.default_rng(0))
    wrong = {int(k) for k in rows}
    assert set(checked.set_aside) == wrong
    rows = {row for finding in checked.findings for row in finding.rows}
    assert rows == {k + 2 for k in wrong}


#: laws of sound readings, in units of the stated noise
LAWS = ("white", "heavy", "carried", "offset")


def sound_errors(law: str, rng: np.random.Generator) -> np.ndarray:
    """Errors (2 POINTS,) of two circles: white, Student t of 4, AR(1), run offsets."""
    white = rng.standard_normal((2, POINTS))
    if law == "heavy":
        white = rng.standard_t(4.0, (2, POINTS)) / np.sqrt(2.0)
    if law == "offset":
        white += 2.0 * rng.standard_normal((2, 1))
    if law == "carried":
        for k in range(1, POINTS):
            white[:, k] = 0.7 * white[:, k - 1] + np.sqrt(0.51) * white[:, k]
    return white.ravel()


@pytest.mark.parametrize("law", LAWS)
def test_no_sound_reading_is_set_aside(law):
    """Clean sessions also have no bad fit."""
    m, series = plan()
    by_circle = dataclasses.replace(series, run=np.repeat(["1", "2"], POINTS))
    for seed in range(5):
        rng = np.random.default_rng([27, seed])
        truth = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
        y = exact(series, truth) + NOISE * sound_errors(law, rng)
        session = checks.session_readings(m, [by_circle], y)
        checked = checks.check_session(session, m, np.random.default_rng(0))
        assert not checked.set_aside, seed
        assert not checked.bad_fit, seed
