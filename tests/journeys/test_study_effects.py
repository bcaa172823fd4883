"""`effects` of [identify]: what is allowed, refused, reported and predicted."""

import itertools
import json
from pathlib import Path
from typing import Any

import bad_fit_sample
import bar_readings
import leg_scale
import numpy as np
import pytest
import sample

from pkm_studies.commands import main


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


#: workspace over which a leg's wrong scale is taken up
WORKSPACE = """x_mm = [-80, 80]
y_mm = [-80, 80]
z_mm = [640, 760]
rx_deg = [-5, 5]
ry_deg = [-5, 5]
spin_deg = 0
"""


def with_wrong_scale(folder: Path, effects: str) -> tuple[dict[str, Any], int]:
    """A hexapod whose leg 1 goes 1 % too far, by formulas of its own.

    Every third pose is held out: it is of a set-up that is predicted.
    """
    folder.mkdir()
    study = leg_scale.write(
        folder, leg_scale.readings(0.01), setup_of=lambda k: "u" if k % 3 == 0 else "t"
    )
    text, _, _ = study.read_text().partition("x_mm = [-80, 80]")
    head, _, tail = text.partition("[[setup]]")
    setup, _, rest = tail.partition("[noise]")
    held_out = setup.replace('name = "t"', 'name = "u"')
    rest = rest.replace("[readings]\n", '[readings]\npredict = ["u"]\n')
    rest = rest.replace('[gap]\neffects = ["all"]\n', "")
    text = f"{head}[[setup]]{setup}[[setup]]{held_out}[noise]{rest}{WORKSPACE}"
    study.write_text(f"{text}[identify]\neffects = {effects}\n")
    return identified(study, folder / "readings.csv")


#: effects that compete for a leg's scale; the nightly run allows the whole catalogue
FEW = '["encoder_scale", "pitch_accumulation", "backlash", "gravity"]'


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(effects, marks=pytest.mark.slow)
        for effects in (FEW, '"catalogue"')
    ],
    ids=["few", "catalogue"],
)
def wrong_scale(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, tuple[dict[str, Any], int]]:
    """Results and exit codes without effects, and with those that are allowed."""
    folder = tmp_path_factory.mktemp("scale")
    allowed = {"none": '"none"', "some": request.param}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("oed.corrected.answer_fits.N_DRAWS", 1000)
        patch.setattr("oed.corrected.answer_fits.MIN_DRAWS", 60)
        return {n: with_wrong_scale(folder / n, e) for n, e in allowed.items()}


def test_a_bad_fit_is_good_where_effects_explain_it(wrong_scale):
    alone, code = wrong_scale["none"]
    assert code == 1
    assert alone["goodness"]["bad_fit"]
    assert alone["prediction"] is None
    allowed, code = wrong_scale["some"]
    assert code == 0
    assert not allowed["goodness"]["bad_fit"]
    first = allowed["goodness"]["findings"][0]
    assert first.startswith("With encoder_scale in the model")
    answers = allowed["gap"]["mixture"]["answers"]
    named = sum(a["probability"] for a in answers if "encoder_scale" in a["effects"])
    assert named > 0.95


def test_the_controller_gets_parameters_that_take_up_effects(wrong_scale):
    """Less is left than with the machine's parameters, and as much as predicted."""
    result, _ = wrong_scale["some"]
    mixture = result["gap"]["mixture"]
    own = {n: p["value"] for n, p in result["corrected"]["parameters"].items()}
    sent = mixture["controller"]
    assert set(sent) == {name for name in own if "." not in name}
    places = itertools.product((-80, 80), (-80, 80), (640, 760))
    tilts = list(itertools.product((-5, 5), (-5, 5)))
    grid = np.array(
        [[*p, *np.radians(t), 0.0] for p in places for t in tilts], dtype=float
    )
    errors = {
        name: leg_scale.reached(grid, parameters, 0.01) - grid
        for name, parameters in (("own", own), ("sent", sent))
    }
    rms = {n: np.sqrt((e[:, :3] ** 2).mean(axis=0)) for n, e in errors.items()}
    after = mixture["prediction"]["components"]
    predicted = np.array([after[n]["after"]["rms"] for n in ("x", "y", "z")]) / 1e3
    total = {name: np.linalg.norm(values) for name, values in rms.items()}
    assert total["sent"] < 0.9 * total["own"]
    assert 0.8 < total["sent"] / np.linalg.norm(predicted) < 1.25


def test_readings_that_are_held_out_lie_within_the_bands(wrong_scale):
    """Every third pose is predicted: with the leg's scale, bands hold and are narrow."""
    rms, coverage = {}, {}
    for effects, (result, _) in wrong_scale.items():
        places = [s for s in result["held_out"] if s["unit"] == "um"]
        assert len(places) == 3
        rms[effects] = np.sqrt(np.mean([s["rms"] ** 2 for s in places]))
        coverage[effects] = np.mean([s["coverage"] for s in places])
    assert rms["none"] > 200.0
    assert rms["some"] < 100.0  # the noise is 50
    assert coverage["some"] > 0.85


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
