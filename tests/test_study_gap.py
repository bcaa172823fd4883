"""The diagnosis of a study: what [gap] says, readings of a virtual machine with
effects, the section, the command.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gap_fixture
import msgspec
import numpy as np
import pytest
import sample

from oed import result
from oed.gap.data.diagnosis import Diagnosis
from oed.measurement import Series
from pkm_studies import cli, schemas
from pkm_studies.errors import InputError
from pkm_studies.progress import Silent
from pkm_studies.resolve.conditions import planned_covariates
from pkm_studies.resolve.gap import gap_request
from pkm_studies.run_state import start
from pkm_studies.stages.gap import traces as gap_traces
from pkm_studies.stages.gap.virtual_readings import empty_readings
from pkm_studies.steps.readings import planned_series, simulate_readings
from pkm_studies.study import load, parse

Run = Callable[..., tuple[int, str, str]]
FOLDER = Path(__file__).resolve().parent


@pytest.fixture
def oed(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Run:
    """The command, with the diagnosis made by hand."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "oed.gap.diagnose.diagnose",
        lambda problem, effects, rng: gap_fixture.diagnosis(problem),
    )

    def call(*arguments: object) -> tuple[int, str, str]:
        code = cli.main([str(a) for a in arguments])
        out, err = capsys.readouterr()
        return code, out, err

    return call


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


# -- what [gap] says -------------------------------------------------------------------


def test_all_known_effects_are_tried_but_those_left_out() -> None:
    names = {e.name for e in sample.resolved(sample.STUDY + "[gap]\n").gap.effects}
    assert {"gravity", "backlash", "leg_thermal"} <= names
    fewer = {
        e.name
        for e in sample.resolved(
            sample.STUDY + '[gap]\nwithout = ["gravity"]\n'
        ).gap.effects
    }
    assert names - fewer == {"gravity"}
    assert sample.resolved().gap is None


def test_an_effect_of_ones_own_replaces_the_library_s(tmp_path: Path) -> None:
    path = gap_fixture.written(
        tmp_path, sample.STUDY + '[gap]\neffects = ["all", "effects.py:backlash"]\n'
    )
    asked = gap_request(load(path), sample.resolved().machine)
    assert asked is not None
    (mine,) = [e for e in asked.effects if e.name == "backlash"]
    assert mine.source == "by hand"


BAD = {
    "effect": ('[gap]\neffects = ["gravty"]', "gap.effects[1]", "gravity"),
    "without": (
        '[gap]\nwithout = ["gravty"]',
        "gap.without[1]",
        "did you mean gravity",
    ),
    "none left": (
        '[gap]\neffects = ["gravity"]\nwithout = ["gravity"]',
        "gap.effects",
        "no effect is left",
    ),
    "gravity": ("[gap]\ngravity = [0, 0, 0]", "gap.gravity", "[0, 0, -1]"),
    "payload": (
        "[gap.conditions]\npayload_N = [-1]",
        "gap.conditions.payload_N[1]",
        ">= 0",
    ),
    "no feed": (
        "[gap.conditions]\nfeed_mm_min = []",
        "gap.conditions.feed_mm_min",
        "list",
    ),
    "warming": (
        "[gap.conditions.temperature]\nleg = { rise_C = 1 }",
        "gap.conditions.temperature.leg",
        "after_min",
    ),
    "acting": ('[[gap.acting]]\neffect = "gravty"', "gap.acting[1].effect", "gravity"),
    "constant": (
        '[[gap.acting]]\neffect = "gravity"\nconstants = { raito = 1 }',
        "gap.acting[1].constants.raito",
        "did you mean ratio",
    ),
    "field": (
        '[[gap.acting]]\neffect = "gravity"\nsizes = 2',
        "gap.acting[1].sizes",
        "did you mean size",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_told_with_field_and_remedy(case: str) -> None:
    text, field, remedy = BAD[case]
    with pytest.raises(InputError) as error:
        sample.resolved(sample.STUDY + text + "\n")
    assert field in str(error.value)
    assert remedy in str(error.value)


def test_a_coefficient_that_an_effect_has_not(oed: Run, tmp_path: Path) -> None:
    study = gap_fixture.written(
        tmp_path, sample.changed(gap_fixture.STUDY, ('"leg 2" = 2.0', '"leg 4" = 2.0'))
    )
    code, _, err = oed("simulate", study, "--out", "r.csv")
    assert code == 2
    assert "gap.acting[1].coefficients.leg 4" in err
    assert "leg 3" in err
    assert not (tmp_path / "r.csv").exists()


def test_a_study_file_is_read_back() -> None:
    said = parse(gap_fixture.STUDY, FOLDER / "x.study.toml").gap
    assert said.conditions.payload == 50.0
    assert said.conditions.feed_mm_min == [500.0, 1000.0]
    assert said.acting[0].coefficients == {"leg 2": 2.0, "leg 3": -0.5}


def test_the_schema_tells_the_tables() -> None:
    tables = schemas.study()["$defs"]
    assert {"effects", "without", "gravity", "conditions", "acting"} <= set(
        tables["GapTable"]["properties"]
    )
    assert {"feed_mm_min", "payload_N"} <= set(tables["ConditionsTable"]["properties"])
    assert {
        "verdict",
        "answers",
        "set95",
        "where",
        "closure",
        "not_testable",
        "confusable",
    } <= set(schemas.result()["$defs"]["GapSection"]["required"])


# -- conditions and virtual machines ---------------------------------------------------


def test_conditions_of_readings(tmp_path: Path) -> None:
    """Times, ways, feeds and loads of two circles both ways, counted by hand."""
    path = gap_fixture.written(tmp_path)
    found = planned_covariates(*_planned(path), load(path).gap.conditions)
    # 10 min warming, 5 min to mount, 2 s a reading; 24 readings a pass; a minute
    # between passes
    starts = 900.0 + np.arange(4) * (24 * 2.0 + 60.0)
    expected = np.concatenate([start + 2.0 * np.arange(1, 25) for start in starts])
    np.testing.assert_allclose(found["time"], expected)
    np.testing.assert_array_equal(
        found["direction"], np.repeat([1.0, -1.0, 1.0, -1.0], 24)
    )
    np.testing.assert_allclose(
        found["feed"], np.repeat([0.5, 1.0, 0.5, 1.0], 24) / 60.0
    )
    np.testing.assert_array_equal(found["payload"], 50.0)
    np.testing.assert_array_equal(found["repeat"], 1.0)


def test_averaged_passes_have_no_direction_and_take_their_time(tmp_path: Path) -> None:
    path = gap_fixture.written(
        tmp_path,
        sample.changed(gap_fixture.STUDY, ("average = false", "average = true")),
    )
    found = planned_covariates(*_planned(path), load(path).gap.conditions)
    assert "direction" not in found
    np.testing.assert_allclose(found["time"].iloc[:2], [904.0, 908.0])


def test_temperatures_rise_as_said(tmp_path: Path) -> None:
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
    found = planned_covariates(*_planned(path), load(path).gap.conditions)
    np.testing.assert_allclose(
        found["temp_frame"], 3.0 * (1.0 - np.exp(-found["time"] / 1200.0)), rtol=1e-12
    )


def _planned(path: Path) -> tuple[Any, tuple[Series, ...]]:
    state = start(load(path), path.parent, 3, Silent(), None)
    return state.measurement, planned_series(state)


def test_simulated_readings_have_the_effect(oed: Run, tmp_path: Path) -> None:
    """With and without backlash, against exact readings at joints moved by hand: q_i +
    b_i sign(dq_i) / 2.
    """
    with_it = gap_fixture.written(tmp_path)
    plain = tmp_path / "plain.study.toml"
    plain.write_text(
        gap_fixture.STUDY[: gap_fixture.STUDY.index("[[gap.acting]]")], encoding="utf-8"
    )
    assert oed("simulate", with_it, "--out", "a.readings.csv")[0] == 0
    assert oed("simulate", plain, "--out", "b.readings.csv")[0] == 0
    a, b = _rows(tmp_path / "a.readings.csv"), _rows(tmp_path / "b.readings.csv")
    change = np.array(
        [
            1e-3 * (float(x["length_mm"]) - float(y["length_mm"]))
            for x, y in zip(a, b, strict=True)
        ]
    )

    state = start(load(plain), tmp_path, 3, Silent(), [tmp_path / "b.readings.csv"])
    told = json.loads((tmp_path / "b.truth.json").read_text())
    truth = np.array([told[n]["value"] for n in state.measurement.names])
    (series,) = state.resolved.dataset.series
    moved, sure = series.q.copy(), np.ones(len(series.q), dtype=bool)
    for run in dict.fromkeys(series.run):
        at = np.flatnonzero(series.run == run)
        steps = np.sign(np.diff(series.q[at], axis=0))
        sense, after = np.vstack([steps[:1], steps]), np.vstack([steps, steps[-1:]])
        sure[at] = (sense == after).all(
            axis=1
        )  # elsewhere a joint turns back between the neighbours
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
    assert "effects" not in told


def _fields(series: Series) -> dict[str, Any]:
    return {
        n: getattr(series, n)
        for n in ("setup", "q", "start", "command", "index", "run")
    }


def test_each_pass_has_a_state_of_its_own(tmp_path: Path) -> None:
    """Passes of a circle share their poses in the plan, but neither their way nor their
    time.
    """
    path = gap_fixture.written(tmp_path)
    measurement, series = _planned(path)
    asked = gap_request(load(path), measurement.machine)
    made = empty_readings(measurement, series, asked)
    assert [len(s.q) for s in made.series] == [4 * 24 + 1]
    truth = measurement.nominal
    np.testing.assert_array_equal(
        measurement.readings(made.series, truth), measurement.readings(series, truth)
    )


def test_drawn_coefficients_are_of_the_textbook_s_form(
    oed: Run, tmp_path: Path
) -> None:
    text = sample.changed(
        gap_fixture.STUDY,
        ('coefficients = { "leg 2" = 2.0, "leg 3" = -0.5 }', "draw = true"),
    )
    study = gap_fixture.written(tmp_path, text)
    for name in "ab":
        assert oed("simulate", study, "--out", f"{name}.readings.csv")[0] == 0
    found = [
        json.loads((tmp_path / f"{n}.truth.json").read_text())["effects"][0][
            "coefficients"
        ]
        for n in "ab"
    ]
    assert found[0] == found[1]
    assert set(found[0]) == {"leg 1", "leg 2", "leg 3"}
    assert len({c["prior_sds"] for c in found[0].values()}) == 3


def test_without_a_table_readings_are_as_before(oed: Run, tmp_path: Path) -> None:
    """No covariates; and with a table and nothing acting, the same readings."""
    start, end = (
        gap_fixture.STUDY.index("[gap]"),
        gap_fixture.STUDY.index("[[gap.acting]]"),
    )
    for name, text in (
        ("a", gap_fixture.STUDY[:start]),
        ("b", gap_fixture.STUDY[:end]),
    ):
        (tmp_path / f"{name}.study.toml").write_text(text, encoding="utf-8")
        (tmp_path / "effects.py").write_text(gap_fixture.EFFECTS, encoding="utf-8")
        assert (
            oed("simulate", tmp_path / f"{name}.study.toml", "--out", f"{name}.csv")[0]
            == 0
        )
    a, b = _rows(tmp_path / "a.csv"), _rows(tmp_path / "b.csv")
    assert [r["length_mm"] for r in a] == [r["length_mm"] for r in b]
    assert "time_s" not in a[0]
    assert {"time_s", "direction", "feed_mm_min", "payload_N", "repeat"} <= set(b[0])


# -- the section -----------------------------------------------------------------------


def test_the_command_diagnoses_readings(oed: Run, tmp_path: Path) -> None:
    study = gap_fixture.written(tmp_path)
    assert oed("simulate", study, "--out", "r.csv")[0] == 0
    code, out, err = oed("diagnose", study, "--readings", "r.csv", "--out", "found")
    assert (code, err) == (0, "")
    assert "The gap comes from backlash (probability 97 %): 9." in out
    text = (tmp_path / "found/result.json").read_text()
    assert "NaN" not in text
    gap = msgspec.json.decode(text, type=result.StudyResult).gap
    assert gap is not None
    assert gap.verdict == "effect"
    assert gap.selected == ["backlash"]
    assert gap.closure[1].value is None
    assert gap.not_testable == ["cold"]
    assert gap.about["cold"].column == "temp_frame_C"
    value = {c.name: c.value for c in gap.coefficients}
    assert value["leg 2"] == pytest.approx(15e-6, rel=0.03)
    assert value["leg 3"] == pytest.approx(-3.75e-6, rel=0.15)
    assert gap.rms_after["length"] < 0.6 < 5.0 < gap.rms_before["length"]
    assert (json.loads(text)["posterior"], json.loads(text)["prediction"]) == (
        None,
        None,
    )


def test_readings_of_the_study_and_the_same_from_a_file_give_the_same(
    oed: Run, tmp_path: Path
) -> None:
    study = gap_fixture.written(tmp_path)
    assert oed("simulate", study, "--out", "r.csv")[0] == 0
    assert oed("diagnose", study, "--out", "own", "--quiet") == (0, "", "")
    assert oed(
        "diagnose", study, "--readings", "r.csv", "--out", "file", "--quiet"
    ) == (0, "", "")
    own, file = (
        json.loads((tmp_path / n / "result.json").read_text())["gap"]
        for n in ("own", "file")
    )
    assert own["words"] == file["words"]
    for a, b in zip(own["traces"], file["traces"], strict=True):
        assert (a["run"], a["direction"], a["payload_N"]) == (
            b["run"],
            b["direction"],
            b["payload_N"],
        )
        np.testing.assert_allclose(a["after"], b["after"], atol=2e-4)
    assert oed("run", study, "--out", "whole", "--quiet") == (0, "", "")
    assert json.loads((tmp_path / "whole/result.json").read_text())["gap"] == own


def test_the_same_seed_gives_the_same_bytes(oed: Run, tmp_path: Path) -> None:
    study = gap_fixture.written(tmp_path)
    made = []
    for name in "ab":
        assert oed("diagnose", study, "--out", name, "--quiet", "--seed", "8")[0] == 0
        told = json.loads((tmp_path / name / "result.json").read_text())
        made.append({**told, "seconds": 0})
    assert made[0] == made[1]
    assert made[0]["seed"] == 8


def test_claims_can_point_into_the_diagnosis(oed: Run, tmp_path: Path) -> None:
    claims = (
        '[expect]\nverdict = { of = "gap.verdict", equals = "effect" }\n'
        'closed = { of = "gap.closure[0].low", min = 0.9 }\n'
        'cause = { of = "gap.answers[0].effects", contains = "gravity" }\n'
        'accuracy = { of = "prediction.components.z.after.rms", max = 1.0 }\n'
    )
    study = gap_fixture.written(tmp_path, gap_fixture.STUDY + claims)
    code, _, err = oed("diagnose", study, "--out", "x", "--quiet")
    assert code == 1
    assert (
        err == "oed: claim cause: not met: gap.answers[0].effects contains 'gravity',"
        ' measured ["backlash"]\n'
    )


def test_nothing_to_diagnose(oed: Run, tmp_path: Path) -> None:
    text = sample.changed(
        gap_fixture.STUDY, ("[readings]\nsimulate = true\ndraw = true\n", "")
    )
    study = gap_fixture.written(tmp_path, text)
    code, _, err = oed("diagnose", study, "--out", "x")
    assert code == 2
    assert "--readings" in err
    assert not (tmp_path / "x").exists()


def test_a_study_without_a_table_is_diagnosed_with_all_effects(
    oed: Run, tmp_path: Path
) -> None:
    study = gap_fixture.written(
        tmp_path, gap_fixture.STUDY[: gap_fixture.STUDY.index("[gap]")]
    )
    assert oed("diagnose", study, "--out", "x", "--quiet")[0] == 0
    assert (
        "gravity"
        in json.loads((tmp_path / "x/result.json").read_text())["gap"]["tried"]
    )
    assert oed("run", study, "--out", "y", "--quiet")[0] == 0
    assert json.loads((tmp_path / "y/result.json").read_text())["gap"] is None


# -- traces ----------------------------------------------------------------------------


def _diagnosed(tmp_path: Path) -> Diagnosis:
    from oed.gap.data import problem

    path = gap_fixture.written(tmp_path)
    state = start(load(path), tmp_path, 3, Silent(), None)
    readings = simulate_readings(state, planned_series(state)).readings
    residuals = problem.assemble(
        state.measurement,
        readings.series,
        readings.covariates,
        readings.truth,
        readings.y,
    )
    return gap_fixture.diagnosis(residuals)


def test_traces_are_circles_both_ways(tmp_path: Path) -> None:
    found = _diagnosed(tmp_path)
    traces = gap_traces.traces(found)
    assert [t.kind for t in traces] == ["circle"] * 4
    assert [t.base for t in traces] == ["z=1146mm"] * 2 + ["z=1206mm"] * 2
    assert [t.direction for t in traces] == [1, -1, 1, -1]
    # the tool stands on a sphere of 300 mm about the cup, and the circle's height tells
    # its radius
    assert traces[0].radius_mm == pytest.approx(
        math.sqrt(300.0**2 - 138.0**2), abs=15.0
    )
    assert all(np.diff(t.at).min() > 0.0 for t in traces)
    every = np.concatenate([t.before for t in traces])
    assert np.sqrt(np.mean(every**2)) == pytest.approx(
        1e6 * np.sqrt(np.mean(found.before**2)), rel=1e-4
    )
    explained = np.concatenate([t.explained for t in traces])
    left = every - np.concatenate([t.after for t in traces])
    np.testing.assert_allclose(explained, left, atol=3e-4)


@pytest.mark.parametrize(
    ("points", "kind"),
    [
        ([[0.1 * k, 0.05 * k, 1.0] for k in range(8)], "line"),
        ([[math.cos(0.7 * k), math.sin(0.7 * k), 0.2] for k in range(9)], "circle"),
        ([[(k * 37 % 11) * 0.1, (k * 23 % 7) * 0.1, 0.0] for k in range(20)], "points"),
        ([[0.0, 0.0, 0.0]] * 6, "points"),
        ([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]], "points"),
    ],
)
def test_what_a_run_is(points: list[list[float]], kind: str) -> None:
    found, at, radius = gap_traces._shape(np.array(points), np.zeros(len(points)))
    assert found == kind
    assert (radius is None) == (kind != "circle")
    if kind == "circle":
        assert radius == pytest.approx(1.0)
    if kind == "line":
        np.testing.assert_allclose(np.diff(at), 1e3 * math.hypot(0.1, 0.05))


def test_places_of_the_tool_gather_their_readings(tmp_path: Path) -> None:
    found = _diagnosed(tmp_path)
    spots, unit = gap_traces.spots(found)
    assert unit == "um"
    assert len(spots) == 48  # both ways at 24 poses of two circles
    total = sum(2.0 * s.before**2 for s in spots)
    assert total == pytest.approx(1e12 * float(np.sum(found.before**2)), rel=1e-3)
