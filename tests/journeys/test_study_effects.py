"""`effects` of [identify]: what is allowed, refused, reported and predicted."""

import json
from pathlib import Path
from typing import Any

import bad_fit_sample
import bar_readings
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
