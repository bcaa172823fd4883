"""Tolerances that are stated ten times too small: seen, taken larger, and said."""

import json
from pathlib import Path
from typing import Any

import bad_fit_sample
import bar_readings
import numpy as np
import pytest
import sample
from shipped_models import a3_head, planar_2dof, pose_tracker

from oed import Measurement, mount
from oed.estimation import identify, tolerance_factor
from oed.estimation.contradictions import ToleranceFactor
from oed.measurement import draw_parameters, draw_readings
from pkm_studies.commands import main

position = pose_tracker.position
head = a3_head.machine
machine = planar_2dof.machine


def identified(folder: Path, factor: float) -> tuple[dict[str, Any], str]:
    """Result and study of an independent head whose tolerances are stated with a factor."""
    folder.mkdir()
    wide = [
        p for p in head.parameters if p.tolerance > 0.0 and p.name not in head.frame
    ]
    sizes = [("rad", 1.0) if p.unit == "rad" else ("mm", 1e3) for p in wide]
    lines = [
        f'[[prior.tolerance]]\nparameters = ["{p.name}"]\n'
        f"sigma_{unit} = {factor * p.tolerance * scale:.9g}\n"
        for p, (unit, scale) in zip(wide, sizes, strict=True)
    ]
    text = sample.changed(
        bad_fit_sample.WITHOUT_REPORT, ("[posterior]", "".join(lines) + "\n[posterior]")
    )
    study, readings = bad_fit_sample.write(folder, bar_readings.a3_readings(3), text)
    out = folder / "out"
    main(["identify", str(study), "--readings", str(readings), "--out", str(out)])
    return json.loads((out / "result.json").read_text()), text


def test_the_fit_is_that_of_tolerances_as_they_are(tmp_path):
    right, _ = identified(tmp_path / "right", 1.0)
    small, _ = identified(tmp_path / "small", 0.1)
    assert any("times as far from nominal" in w for w in small["warnings"])
    assert not any("as far from nominal" in w for w in right["warnings"])
    assert not small["goodness"]["bad_fit"]
    for name, p in right["estimate"]["parameters"].items():
        other = small["estimate"]["parameters"][name]
        if p["prior_sd"] > 0.0:
            assert abs(other["value"] - p["value"]) < 0.5 * p["sd"] + 1e-9
    for name, c in right["prediction"]["components"].items():
        after = small["prediction"]["components"][name]["after"]["rms"]
        assert after == pytest.approx(c["after"]["rms"], rel=0.2)


def planar() -> tuple[Measurement, list[Any]]:
    measurement = Measurement(machine, [mount(position, "tracker")])
    across, up = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    command = np.column_stack([across.ravel(), up.ravel()])
    return measurement, [measurement.series("tracker", command)]


@pytest.mark.parametrize("seed", range(4))
def test_tolerances_that_are_right_are_kept(seed):
    measurement, series = planar()
    rng = np.random.default_rng(seed)
    truth = draw_parameters(measurement, rng)
    y = draw_readings(measurement, series, truth, rng)
    estimate = identify(measurement, series, y)
    assert not tolerance_factor(measurement, series, estimate).is_sure
    small = ToleranceFactor(0.1, 0.0, 1.0).widened(measurement)
    judged = tolerance_factor(small, series, identify(small, series, y))
    assert judged.is_sure
    assert 5.0 < judged.factor < 20.0


def test_an_effect_is_no_wrong_tolerance():
    """A smooth error of 20 times the noise that no parameters explain."""
    measurement, series = planar()
    rng = np.random.default_rng(5)
    truth = draw_parameters(measurement, rng)
    y = draw_readings(measurement, series, truth, rng)
    wave = np.sin(np.linspace(0.0, 25.0, len(y)))
    y = y + 20.0 * measurement.sigma(series) * wave
    estimate = identify(measurement, series, y)
    assert not tolerance_factor(measurement, series, estimate).is_sure
