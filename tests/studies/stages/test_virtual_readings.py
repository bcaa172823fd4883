"""Readings of a virtual machine: their covariates, and the effects that it has."""

import csv
import json
from pathlib import Path
from typing import Any

import gap_fixture
import numpy as np
import pandas as pd
import pytest
import sample

from oed.measurement import Series
from pkm_studies.base import Silent
from pkm_studies.resolve import GapRequest
from pkm_studies.stages import RunState
from pkm_studies.stages.gap.diagnosis import empty_readings
from pkm_studies.stages.readings import planned_series
from pkm_studies.study import Study

pytestmark = pytest.mark.usefixtures("own_folder")


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _covariates(path: Path) -> pd.DataFrame:
    """Covariates of the planned readings of a study."""
    measurement, series = _planned(path)
    request = GapRequest.from_study(Study.load(path), measurement.machine)
    return request.planned_covariates(measurement, series)


def test_conditions_of_readings(tmp_path):
    """Times, ways, feeds and loads of two circles both ways, counted by hand."""
    path = gap_fixture.written(tmp_path)
    covariates = _covariates(path)
    # 10 min warming, 5 min to mount, 2 s a reading; 24 readings a pass; a minute
    # between passes
    starts = 900.0 + np.arange(4) * (24 * 2.0 + 60.0)
    expected = np.concatenate([start + 2.0 * np.arange(1, 25) for start in starts])
    np.testing.assert_allclose(covariates["time"], expected)
    np.testing.assert_array_equal(
        covariates["direction"], np.repeat([1.0, -1.0, 1.0, -1.0], 24)
    )
    np.testing.assert_allclose(
        covariates["feed"], np.repeat([0.5, 1.0, 0.5, 1.0], 24) / 60.0
    )
    np.testing.assert_array_equal(covariates["payload"], 50.0)
    np.testing.assert_array_equal(covariates["repeat"], 1.0)


def test_averaged_passes_have_no_direction_and_take_their_time(tmp_path):
    path = gap_fixture.written(
        tmp_path,
        sample.changed(gap_fixture.STUDY, ("average = false", "average = true")),
    )
    covariates = _covariates(path)
    assert "direction" not in covariates
    np.testing.assert_allclose(covariates["time"].iloc[:2], [904.0, 908.0])


def test_temperatures_rise_with_their_time_constant(tmp_path):
    text = sample.changed(
        gap_fixture.STUDY,
        (
            "payload_N = 50",
            (
                "payload_N = 50\ntemperature = { frame = { rise_C = 3.0, after_min ="
                " 20.0 } }"
            ),
        ),
    )
    path = gap_fixture.written(tmp_path, text)
    covariates = _covariates(path)
    np.testing.assert_allclose(
        covariates["temp_frame"],
        3.0 * (1.0 - np.exp(-covariates["time"] / 1200.0)),
        rtol=1e-12,
    )


def _planned(path: Path) -> tuple[Any, tuple[Series, ...]]:
    state = RunState.start(Study.load(path), 3, Silent(), None)
    return state.measurement, planned_series(state)


def test_simulated_readings_have_the_effect(oed, tmp_path):
    """Against exact readings at joints moved by hand: q_i + b_i sign(dq_i) / 2."""
    with_effect = gap_fixture.written(tmp_path)
    plain = tmp_path / "plain.study.toml"
    plain.write_text(
        gap_fixture.STUDY[: gap_fixture.STUDY.index("[[gap.acting]]")], encoding="utf-8"
    )
    assert oed("simulate", with_effect, "--out", "a.readings.csv")[0] == 0
    assert oed("simulate", plain, "--out", "b.readings.csv")[0] == 0
    a, b = _rows(tmp_path / "a.readings.csv"), _rows(tmp_path / "b.readings.csv")
    change = np.array(
        [
            1e-3 * (float(x["length_mm"]) - float(y["length_mm"]))
            for x, y in zip(a, b, strict=True)
        ]
    )

    state = RunState.start(
        Study.load(plain), 3, Silent(), [tmp_path / "b.readings.csv"]
    )
    truth_table = json.loads((tmp_path / "b.truth.json").read_text())
    truth = np.array([truth_table[n]["value"] for n in state.measurement.names])
    (series,) = state.resolved.dataset.series
    moved, sure = series.q.copy(), np.ones(len(series.q), dtype=bool)
    for run in dict.fromkeys(series.run):
        at = np.flatnonzero(series.run == run)
        steps = np.sign(np.diff(series.q[at], axis=0))
        sense, after = np.vstack([steps[:1], steps]), np.vstack([steps, steps[-1:]])
        # elsewhere a joint turns back between the neighbours
        sure[at] = (sense == after).all(axis=1)
        moved[at] += 0.5 * sense * np.array([0.0, 1.5 * 2.0, 1.5 * -0.5]) * 5e-6
    expected = state.measurement.readings([series], truth)
    bent = state.measurement.readings(
        [Series(**{**_fields(series), "q": moved})], truth
    )
    sure = sure[series.index[:, 0]]
    assert sure.mean() > 0.4
    np.testing.assert_allclose(change[sure], (bent - expected)[sure], atol=1e-12)
    assert np.abs(change).max() > 5e-6

    acting = json.loads((tmp_path / "a.truth.json").read_text())["effects"]
    assert acting[0]["coefficients"]["leg 2"] == {
        "value": pytest.approx(1.5e-5),
        "prior_sds": 3.0,
    }
    assert acting[0]["constants"] == {"reach": 1.0}
    assert acting[0]["rms"]["length_um"] == pytest.approx(
        1e6 * np.sqrt(np.mean(change**2)), rel=1e-3
    )
    assert "effects" not in truth_table


def _fields(series: Series) -> dict[str, Any]:
    return {
        n: getattr(series, n)
        for n in ("setup", "q", "start", "command", "index", "run")
    }


def test_each_pass_has_a_state_of_its_own(tmp_path):
    """Passes of a circle share their poses in the plan, but not their direction."""
    path = gap_fixture.written(tmp_path)
    measurement, series = _planned(path)
    request = GapRequest.from_study(Study.load(path), measurement.machine)
    planned = empty_readings(measurement, series, request)
    assert [len(s.q) for s in planned.series] == [4 * 24 + 1]
    truth = measurement.nominal
    np.testing.assert_array_equal(
        measurement.readings(planned.series, truth), measurement.readings(series, truth)
    )


def test_drawn_coefficients_are_of_the_textbook_s_form(oed, tmp_path):
    text = sample.changed(
        gap_fixture.STUDY,
        ('coefficients = { "leg 2" = 2.0, "leg 3" = -0.5 }', "draw = true"),
    )
    study = gap_fixture.written(tmp_path, text)
    for name in "ab":
        assert oed("simulate", study, "--out", f"{name}.readings.csv")[0] == 0
    coefficients = [
        json.loads((tmp_path / f"{n}.truth.json").read_text())["effects"][0][
            "coefficients"
        ]
        for n in "ab"
    ]
    assert coefficients[0] == coefficients[1]
    assert set(coefficients[0]) == {"leg 1", "leg 2", "leg 3"}
    assert len({c["prior_sds"] for c in coefficients[0].values()}) == 3


def test_without_a_table_readings_are_as_before(oed, tmp_path):
    """No covariates; and with a table and nothing acting, the same readings."""
    text = gap_fixture.STUDY
    texts = {
        "a": text[: text.index("[gap]")],
        "b": text[: text.index("[[gap.acting]]")],
    }
    (tmp_path / "effects.py").write_text(gap_fixture.EFFECTS, encoding="utf-8")
    for name, study in texts.items():
        path = tmp_path / f"{name}.study.toml"
        path.write_text(study, encoding="utf-8")
        assert oed("simulate", path, "--out", f"{name}.csv")[0] == 0
    a, b = _rows(tmp_path / "a.csv"), _rows(tmp_path / "b.csv")
    assert [r["length_mm"] for r in a] == [r["length_mm"] for r in b]
    assert "time_s" not in a[0]
    assert {"time_s", "direction", "feed_mm_min", "payload_N", "repeat"} <= set(b[0])


def test_a_coefficient_that_an_effect_has_not(oed, tmp_path):
    study = gap_fixture.written(
        tmp_path, sample.changed(gap_fixture.STUDY, ('"leg 2" = 2.0', '"leg 4" = 2.0'))
    )
    code, _, err = oed("simulate", study, "--out", "r.csv")
    assert code == 2
    assert "gap.acting[1].coefficients.leg 4" in err
    assert "leg 3" in err
    assert not (tmp_path / "r.csv").exists()
