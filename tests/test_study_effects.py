"""`effects` of [identify]: what is allowed, refused, reported and predicted."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bar_readings
import leg_scale
import numpy as np
import pytest
import sample
import test_bad_fit

from pkm_studies.commands import cli

#: the lines of the study of a bad fit that allow no effect
NONE = '[identify]\neffects = "none"\n'


def run(folder: Path, lines: str) -> dict[str, Any]:
    """Result of a fit of two ball bars on an independent head."""
    folder.mkdir()
    study, readings = test_bad_fit.write(folder, bar_readings.a3_readings(0))
    study.write_text(sample.changed(study.read_text(), (NONE, lines)))
    return identified(study, readings)[0]


def identified(study: Path, readings: Path) -> tuple[dict[str, Any], int]:
    """Result and exit code."""
    folder = study.parent
    out = folder / "out"
    code = cli.main(
        ["identify", str(study), "--readings", str(readings), "--out", str(out)]
    )
    return json.loads((out / "result.json").read_text()), code


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """Without the field, without effects, and with the catalogue's."""
    folder = tmp_path_factory.mktemp("effects")
    lines = {
        "default": "",
        "none": NONE,
        "catalogue": '[identify]\neffects = "catalogue"\n',
    }
    return {name: run(folder / name, text) for name, text in lines.items()}


def test_without_effects_nothing_changes(results: dict[str, dict[str, Any]]) -> None:
    for section in ("estimate", "prediction", "goodness"):
        assert results["none"][section] == results["default"][section]


def test_effects_are_reported_with_their_sizes(
    results: dict[str, dict[str, Any]],
) -> None:
    estimate = results["catalogue"]["estimate"]
    effects = estimate["effects"]
    assert {"backlash: leg 1", "unknown tool place"} <= {e["name"] for e in effects}
    changes = [effect["change"] for effect in effects]
    assert changes == sorted(changes, reverse=True)
    assert all(e["low"] <= e["size"] for e in effects)
    assert 0.0 <= estimate["faulty"] <= 1.0
    assert results["none"]["estimate"]["effects"] == []


def test_the_prediction_holds_the_effects(results: dict[str, dict[str, Any]]) -> None:
    without, with_effects = (results[n]["prediction"] for n in ("none", "catalogue"))
    lines = {line["source"]: line for line in with_effects["budget"]["lines"]}
    shares = {
        name: sum(line["share"][name] for line in lines.values())
        for name in with_effects["components"]
    }
    assert "effects beside the geometry" in lines
    assert all(abs(share - 1.0) < 1e-6 for share in shares.values())
    ratio = [
        with_effects["components"][n]["after"]["rms"] / c["after"]["rms"]
        for n, c in without["components"].items()
    ]
    assert np.median(ratio) > 1.0


def test_a_name_that_is_no_effect_is_refused() -> None:
    text = sample.changed(
        sample.STUDY, ("[noise]", "[identify]\neffects = 3\n\n[noise]")
    )
    assert "effects" in sample.refused(text).field


def test_an_unknown_effect_is_refused_by_its_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study, readings = test_bad_fit.write(tmp_path, bar_readings.a3_readings(0))
    misspelt = '[identify]\neffects = ["backlsh"]\n'
    study.write_text(sample.changed(study.read_text(), (NONE, misspelt)))
    code = cli.main(
        [
            "identify",
            str(study),
            "--readings",
            str(readings),
            "--out",
            str(tmp_path / "o"),
        ]
    )
    assert code == 2
    error = capsys.readouterr().err
    assert "identify.effects[1]" in error
    assert "backlsh" in error


#: workspace over which a leg's wrong scale is taken up
WORKSPACE = """x_mm = { from = -80, to = 80, count = 3 }
y_mm = { from = -80, to = 80, count = 3 }
z_mm = { from = 640, to = 760, count = 3 }
rx_deg = [-5, 5]
ry_deg = [-5, 5]
spin_deg = 0
"""


#: what may act in a hexapod: the right effect, and one that is not there
FEW = '["backlash", "encoder_scale"]'
#: the values of `effects` under which the leg's scale is known; all effects take a minute
ALLOWED = (FEW, pytest.param('"catalogue"', marks=pytest.mark.slow))


def with_wrong_scale(folder: Path, effects: str) -> tuple[dict[str, Any], int]:
    """A hexapod whose leg 1 goes 1 % too far, by formulas of its own."""
    folder.mkdir()
    study = leg_scale.write(folder, leg_scale.readings(0.01))
    text, _, _ = study.read_text().partition("x_mm = [-80, 80]")
    without_diagnosis = text.replace('[gap]\neffects = ["all"]\n', "")
    allowed = f"[identify]\neffects = {effects}\n"
    study.write_text(without_diagnosis + WORKSPACE + allowed)
    return identified(study, folder / "readings.csv")


@pytest.fixture(scope="module")
def without_search() -> Iterator[None]:
    """Mistakes of the file have tests of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("oed.checks.check.explain", lambda *args, **options: [])
        yield


@pytest.fixture(scope="module", params=ALLOWED)
def wrong_scale(
    request: pytest.FixtureRequest,
    tmp_path_factory: pytest.TempPathFactory,
    without_search: None,
) -> tuple[dict[str, Any], int]:
    """Result and exit code where effects are allowed."""
    return with_wrong_scale(tmp_path_factory.mktemp("scale") / "with", request.param)


@pytest.mark.usefixtures("without_search")
def test_a_wrong_scale_alone_is_a_bad_fit(tmp_path: Path) -> None:
    alone, code = with_wrong_scale(tmp_path / "alone", '"none"')
    assert code == 1
    assert alone["goodness"]["bad_fit"]
    assert alone["prediction"] is None


def test_a_bad_fit_is_good_where_effects_explain_it(
    wrong_scale: tuple[dict[str, Any], int],
) -> None:
    allowed, code = wrong_scale
    assert code == 0
    assert not allowed["goodness"]["bad_fit"]
    first = allowed["goodness"]["findings"][0]
    assert first.startswith("With effects beside the geometry")
    assert allowed["prediction"] is not None
    assert allowed["estimate"]["faulty"] > 0.9
    assert allowed["estimate"]["effects"][0]["name"] == "encoder_scale: leg 1"


def test_the_controller_gets_parameters_that_take_up_effects(
    wrong_scale: tuple[dict[str, Any], int],
) -> None:
    """Less is left than with the machine's parameters, and as much as predicted."""
    result, _ = wrong_scale
    estimate = result["estimate"]
    own = {name: p["value"] for name, p in estimate["parameters"].items()}
    sent = estimate["controller"]
    assert set(sent) == {name for name in own if "." not in name}
    places = itertools.product((-80, 0, 80), (-80, 0, 80), (640, 700, 760))
    tilts = list(itertools.product((-5, 5), (-5, 5)))
    grid = np.array(
        [[*p, *np.radians(t), 0.0] for p in places for t in tilts], dtype=float
    )
    errors = {
        name: leg_scale.reached(grid, parameters, 0.01) - grid
        for name, parameters in (("own", own), ("sent", sent))
    }
    rms = {n: np.sqrt((e[:, :3] ** 2).mean(axis=0)) for n, e in errors.items()}
    after = result["prediction"]["components"]
    predicted = np.array([after[n]["after"]["rms"] for n in ("x", "y", "z")]) / 1e3
    total = {name: np.linalg.norm(values) for name, values in rms.items()}
    assert total["sent"] < 0.9 * total["own"]
    assert 0.8 < total["sent"] / np.linalg.norm(predicted) < 1.25


@pytest.mark.usefixtures("no_search_for_mistakes")
@pytest.mark.parametrize("effects", ['"none"', *ALLOWED])
def test_readings_that_are_held_out_lie_within_the_bands(
    tmp_path: Path, effects: str
) -> None:
    """Every third pose is predicted: with the leg's scale, bands hold and are narrow."""
    study = leg_scale.write(
        tmp_path,
        leg_scale.readings(0.01),
        setup_of=lambda k: "u" if k % 3 == 0 else "t",
    )
    text, _, tail = study.read_text().partition("[[setup]]")
    setup, _, rest = tail.partition("[noise]")
    held_out = setup.replace('name = "t"', 'name = "u"')
    rest = rest.replace("[readings]\n", '[readings]\npredict = ["u"]\n')
    rest = rest.replace('[gap]\neffects = ["all"]\n', "")
    allowed = f"[identify]\neffects = {effects}\n"
    study.write_text(f"{text}[[setup]]{setup}[[setup]]{held_out}[noise]{rest}{allowed}")
    result, _ = identified(study, tmp_path / "readings.csv")
    places = [s for s in result["held_out"] if s["unit"] == "um"]
    assert len(places) == 3
    rms = np.sqrt(np.mean([s["rms"] ** 2 for s in places]))
    if effects == '"none"':
        assert rms > 200.0
        return
    assert rms < 100.0  # the noise is 50
    assert np.mean([s["coverage"] for s in places]) > 0.85


@pytest.mark.parametrize("table", ["design", "plan", "identify"])
def test_a_check_names_a_misspelt_effect(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], table: str
) -> None:
    text = 'schema = 1\nname = "slip"\n[machine]\nmodel = "planar_2dof"\n'
    text += '[[setup]]\nname = "rm5"\ninstrument = "rm5"\n'
    path = tmp_path / "slip.study.toml"
    effects = f'[{table}]\neffects = ["{{}}"]\n'
    path.write_text(text + effects.format("backlash"))
    assert cli.main(["check", str(path)]) == 0
    path.write_text(text + effects.format("backlsh"))
    assert cli.main(["check", str(path)]) == 2
    assert f'{table}.effects[1] = "backlsh"' in capsys.readouterr().err
