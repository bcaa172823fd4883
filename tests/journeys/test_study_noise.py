"""Noise and priors of a study: stated, refused, estimated, in result.json and the report."""

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

NOISE = "length_um = 0.5"


def noise(*lines: str) -> str:
    """The small study with lines in [noise]."""
    return sample.changed(sample.STUDY, (NOISE, "\n".join([NOISE, *lines])))


def test_amounts_reach_the_set_up_in_si():
    stated = ("seating_um = 0.3", "length_run_um = 0", "carried = 0.2")
    more = ("reach_readings = 5", "outlier_share = 0.01")
    (setup,) = sample.resolved(noise(*stated, *more)).setups.values()
    statement = setup.statement
    assert statement.seating == pytest.approx(0.3e-6)
    assert statement.levels == {"length"}
    assert setup.instrument.channels[0].shared == 0.0
    assert (statement.correlated, statement.reach) == (0.2, 5.0)
    assert (statement.student_dof, statement.outlier_share) == (None, 0.01)


def test_a_number_for_one_set_up_goes_before_one_for_all():
    text = noise("seating_um = 0.3", "[noise.cup]", "seating_um = 0")
    (setup,) = sample.resolved(text).setups.values()
    assert setup.statement.seating == 0.0


REFUSED = {
    "seating_um = -0.1": "an amount of noise is a standard deviation",
    "length_run_um = -1.0": "an amount of noise is a standard deviation",
    "seating = 0.1": "the unit is missing", "seating_deg = 0.1": "no unit for seating",
    "carried = 1.2": "carried = 1.2", "carried = -0.1": "carried = -0.1",
    "reach_readings = 0": "reach_readings = 0", "student_dof = 2": "student_dof = 2",
    "outlier_share = 0.6": "outlier_share = 0.6",
    "carried = 0.0\nreach_readings = 3": "nothing is carried along",
    "student_dof = 4\noutlier_share = 0.01": "states the tails already",
}  # fmt: skip


@pytest.mark.parametrize("lines", list(REFUSED))
def test_what_cannot_be_is_refused(lines):
    error = sample.refused(noise(lines))
    assert error.field.startswith("noise.")
    assert REFUSED[lines] in str(error)


def test_seating_is_refused_where_nothing_is_seated():
    text = sample.changed(
        sample.DELTA, ("[[setup]]", "[noise]\nseating_um = 1\n\n[[setup]]")
    )
    error = sample.refused(text)
    assert error.field == "noise.seating_um"
    assert "no run of probe, calliper seats anything anew" in error.problem


def test_a_stated_law_is_narrower_and_reported(tmp_path):
    """Intervals of a bar whose cup stays, and the numbers of the law that are left."""
    readings, results = bar_readings.a3_readings(0), {}
    stated = (
        "seating_um = 0", "length_run_um = 0", "carried = 0", "course = false",
        "outlier_share = 0",
    )  # fmt: skip
    for name, lines in (("wide", ()), ("stated", stated)):
        study = sample.changed(
            bad_fit_sample.WITHOUT_REPORT,
            (NOISE, "\n".join([NOISE, "estimate = true", *lines])),
        )
        folder = tmp_path / name
        folder.mkdir()
        path, table = bad_fit_sample.write(folder, readings)
        path.write_text(study, encoding="utf-8")
        out = folder / "fit"
        main(["identify", str(path), "--readings", str(table), "--out", str(out)])
        results[name] = json.loads((out / "result.json").read_text(encoding="utf-8"))
    kinds = {
        k: {r["kind"] for r in v["goodness"]["noise"].values()}
        for k, v in results.items()
    }
    assert kinds["wide"] == {"reading", "run", "seat", "course", "carried", "reach"}
    assert kinds["stated"] == {"reading"}
    wide, narrow = (
        [c["sd"] for c in results[name]["estimate"]["combinations"]]
        for name in ("wide", "stated")
    )
    pairs = list(zip(wide, narrow, strict=True))
    assert all(stated < 1.05 * unknown for unknown, stated in pairs)
    assert sum(stated < 0.95 * unknown for unknown, stated in pairs) >= 3


LEGS = '[[prior.correlated]]\nparameters = ["dq*"]\ncorrelation = 0.9\n\n'


def prior(lines: str) -> str:
    return sample.changed(sample.STUDY, ("[design]", lines + "[design]"))


def test_legs_of_one_batch_are_correlated():
    resolved = sample.resolved(prior(LEGS))
    m = resolved.measurement_with(resolved.setups)
    covariance = m.prior_covariance
    legs = [m.names.index(f"dq{k}") for k in (1, 2, 3)]
    block = covariance[np.ix_(legs, legs)] / m.tolerance[legs[0]] ** 2
    assert block == pytest.approx(0.1 * np.eye(3) + 0.9)
    others = [k for k in range(len(covariance)) if k not in legs]
    assert not covariance[np.ix_(legs, others)].any()


def test_later_tables_win():
    pair = LEGS.replace('"dq*"', '"dq1", "dq2"').replace("0.9", "0.5")
    resolved = sample.resolved(prior(LEGS.replace("0.9", "0.6") + pair))
    m = resolved.measurement_with(resolved.setups)
    first, second, third = (m.names.index(f"dq{k}") for k in (1, 2, 3))
    assert m.correlation[first, second] == 0.5
    assert m.correlation[first, third] == 0.6


REFUSED_PRIORS = {
    LEGS.replace("0.9", "1.0"): "correlation = 1",
    LEGS.replace("0.9", "-0.6"): "no errors have such correlations",
    LEGS.replace('"dq*"', '"dr*"'): "no parameter has this name",
    LEGS.replace('"dq*"', '"dq1"'): "fewer than two parameters",
    LEGS.replace('"dq*"', '"cup.*"'): "no parameter has this name",
}


@pytest.mark.parametrize("lines", list(REFUSED_PRIORS))
def test_priors_that_cannot_be_are_refused(lines):
    error = sample.refused(prior(lines))
    assert error.field.startswith("prior.correlated[1]")
    assert REFUSED_PRIORS[lines] in str(error)


def test_a_design_for_correlated_legs_counts_them_once(tmp_path):
    """Legs of one batch are known better before, so that readings gain less."""
    options = "[readings]\nsimulate = true\n[posterior]\nenabled = false\n[expect]"
    gains = {}
    for name, lines in (("independent", ""), ("batch", LEGS)):
        text = sample.changed(
            prior(lines),
            ('criterion = "D"', 'criterion = "D"\nscaling = "tolerance"\nprior = true'),
            ("[expect]", options),
        )
        path = tmp_path / f"{name}.study.toml"
        path.write_text(text, encoding="utf-8")
        out = tmp_path / name
        assert main(["run", str(path), "--quiet", "--out", str(out)]) == 0
        result = json.loads((out / "result.json").read_text(encoding="utf-8"))
        (chosen,) = [p for p in result["design"]["plans"] if p["name"] == "chosen"]
        gains[name] = chosen["logdet"], chosen["value"]
    # of P, with eigenvalues 1 - 0.9 twice and 1 + 2 * 0.9
    known = -np.log(0.1 * 0.1 * 2.8)
    for name, prior_alone in (("independent", 0.0), ("batch", known)):
        gain, value = gains[name]
        assert gain == pytest.approx(value - prior_alone, rel=1e-6)
    assert gains["batch"][0] < gains["independent"][0] - 1.0


BOUNDS = '[[prior.bounds]]\nparameters = ["dq1"]\nlower_mm = 0.0\nupper_mm = 2.0\n\n'


def test_bounds_are_of_the_value():
    resolved = sample.resolved(prior(BOUNDS))
    m = resolved.measurement_with(resolved.setups)
    first = m.names.index("dq1")
    assert m.bounds[first] == pytest.approx([0.0, 2e-3])
    assert list(m.bounded) == [first]


BOUNDS_REFUSED = {
    BOUNDS.replace("upper_mm", "upper"): "the unit is missing",
    BOUNDS.replace("upper_mm", "upper_deg"): "no unit for upper",
    BOUNDS.replace("lower_mm = 0.0", "lower_mm = 1.0"): "is not within",
    BOUNDS.replace("lower_mm = 0.0\nupper_mm = 2.0\n", ""): "give lower, upper, or both",
    BOUNDS.replace("2.0", "0.01"): "of the machines of the tolerances keep",
    BOUNDS.replace('"dq1"', '"dq*", "beta*"'): "parameters of different kinds",
}  # fmt: skip


@pytest.mark.parametrize("lines", list(BOUNDS_REFUSED))
def test_bounds_that_cannot_be_are_refused(lines):
    error = sample.refused(prior(lines))
    assert error.field.startswith("prior.bounds")
    assert BOUNDS_REFUSED[lines] in str(error)


def run(folder: Path, lines: str) -> dict[str, Any]:
    """Result of a fit of two ball bars on an independent head."""
    folder.mkdir()
    rigid = '[identify]\neffects = "none"\n'
    text = sample.changed(bad_fit_sample.WITHOUT_REPORT, (rigid, "")) + lines
    study, readings = bad_fit_sample.write(folder, bar_readings.a3_readings(0), text)
    return identified(study, readings)[0]


def identified(study: Path, readings: Path) -> tuple[dict[str, Any], int]:
    """Result and exit code."""
    folder = study.parent
    out = folder / "out"
    code = main(
        ["identify", str(study), "--readings", str(readings), "--out", str(out)]
    )
    return json.loads((out / "result.json").read_text()), code


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """Without the field, and without effects."""
    folder = tmp_path_factory.mktemp("effects")
    lines = {"default": "", "none": '\n[identify]\neffects = "none"\n'}
    return {name: run(folder / name, text) for name, text in lines.items()}


def test_readings_of_a_machine_are_asked_by_default(results):
    """Which effects act, unless the study keeps them out."""
    assert results["none"]["gap"] is None
    assert results["default"]["gap"]["mixture"] is not None
    for section in ("estimate", "prediction", "goodness"):
        assert results["none"][section] == results["default"][section]
    asked = (sample.STUDY, f'{sample.STUDY}\n[identify]\neffects = "catalogue"\n')
    default, every = (
        [effect.name for effect in sample.resolved(text).diagnosed.effects]
        for text in asked
    )
    assert default == every


def test_small_effects_widen_the_accuracy_by_their_evidence(results):
    """A rigid head: the rigid answer leads, and small effects count beside it."""
    mixture = results["default"]["gap"]["mixture"]
    nothing = {
        a["unseen"]: a["probability"] for a in mixture["answers"] if not a["effects"]
    }
    assert nothing[False] > nothing[True] > 0.0
    without = results["none"]["prediction"]["components"]
    ratio = [
        c["after"]["rms"] / without[name]["after"]["rms"]
        for name, c in mixture["prediction"]["components"].items()
        if c["compensatable"]
    ]
    assert 1.0 < np.median(ratio) < 1.5


def test_a_name_that_is_no_effect_is_refused():
    text = sample.changed(
        sample.STUDY, ("[noise]", "[identify]\neffects = 3\n\n[noise]")
    )
    assert "effects" in sample.refused(text).field


@pytest.mark.parametrize("table", ["design", "plan", "identify"])
def test_a_check_names_a_misspelt_effect(tmp_path, capsys, table):
    text = 'schema = 1\nname = "slip"\n[machine]\nmodel = "planar_2dof"\n'
    text += '[[setup]]\nname = "rm5"\ninstrument = "rm5"\n'
    path = tmp_path / "slip.study.toml"
    effects = f'[{table}]\neffects = ["{{}}"]\n'
    path.write_text(text + effects.format("backlash"))
    assert main(["check", str(path)]) == 0
    path.write_text(text + effects.format("backlsh"))
    assert main(["check", str(path)]) == 2
    assert f'{table}.effects[1] = "backlsh"' in capsys.readouterr().err


ESTIMATE = ("length_um = 0.5", "length_um = 0.5\nestimate = true")
ESTIMATED = sample.changed(bad_fit_sample.STUDY, ESTIMATE)


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
    turned = readings.with_y(2.0 * bar_readings.BAR - readings.y)
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
