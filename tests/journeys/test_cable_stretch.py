"""Recorded tensions stretch the cables: against a simulator of its own
(tests/oracles/planar_cables.py), which knows |A - E| = L0 (1 + T / (E A)).
"""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from oracles import planar_cables
from sample import refused, resolved

from oed.result import StudyResult
from pkm_studies.commands import main

STIFFNESS, LOW, HIGH = 2.0e4, 20.0, 200.0  #: E A of the cables, N; tensions, N
DRUM = 0.3e-3  #: m, noise of one drum
READINGS = 60


def _study(
    geometry: str, setup: str = 'instrument = "redundancy"', effects: str = '"none"'
) -> str:
    return f"""\
schema = 1
name = "cables"

[machine]
model = "cables_planar"

[machine.geometry]
tolerance_mm = {1e3 * planar_cables.PLACE}
{geometry}

[[setup]]
name = "drums"
{setup}

[noise]
gap1_mm = {1e3 * DRUM / 2.0}
gap2_mm = {1e3 * DRUM / 2.0}

[identify]
effects = {effects}

[posterior]
enabled = false

[readings]
files = ["drums.csv"]

[report]
html = false
pdf = false
"""


def _table(columns: dict[str, np.ndarray]) -> str:
    """A readings file of one run."""
    rows = zip(*columns.values(), strict=True)
    lines = [
        f"drums,a,{i},{','.join(repr(float(v)) for v in row)}"
        for i, row in enumerate(rows, start=1)
    ]
    return "\n".join([f"setup,run,order,{','.join(columns)}", *lines]) + "\n"


def _recorded(q: np.ndarray, tension: np.ndarray) -> str:
    columns = {f"q{k + 1}_mm": 1e3 * v for k, v in enumerate(q.T)}
    return _table(columns | {f"tension_{k + 1}_N": v for k, v in enumerate(tension.T)})


def _robot_file(
    rng: np.random.Generator, robot: planar_cables.Robot, noise: float
) -> tuple[str, np.ndarray]:
    """Readings of a robot, and the points (n, 2) at which its mover was."""
    at = rng.uniform(-0.5, 0.5, (READINGS, 2))
    tension = rng.uniform(LOW, HIGH, (READINGS, 4))
    q = robot.lengths(at, tension / STIFFNESS)
    return _recorded(q + noise * rng.standard_normal(q.shape), tension), at


def _drawing() -> planar_cables.Robot:
    return planar_cables.Robot(planar_cables.ANCHORS, np.zeros(4), np.zeros(4))


def test_known_stretch_is_taken_off_the_recorded_drums(tmp_path, rng):
    robot = _drawing()
    text, at = _robot_file(rng, robot, 0.0)
    (tmp_path / "drums.csv").write_text(text, encoding="utf-8")
    study = resolved(_study(f"stiffness_N = {STIFFNESS}"), tmp_path)
    (series,) = study.dataset.series
    np.testing.assert_allclose(series.q, robot.lengths(at), rtol=0.0, atol=1e-9)
    without = resolved(_study(""), tmp_path)
    (rigid,) = without.dataset.series
    stretch = np.abs(robot.lengths(at) - rigid.q)
    assert stretch.max() > 5e-3
    assert stretch.min() > 1e-4


def test_commands_stretch_as_well(tmp_path):
    """Two cables of unlike stiffness, one tension not recorded: |A - E| (1 + T / E A)."""
    anchors = np.array([[-1.0, 0.9], [1.0, 0.8]])
    at, tension = np.array([[0.1, -0.2], [-0.3, 0.2]]), np.array([30.0, 150.0])
    columns = {"x_mm": 1e3 * at[:, 0], "y_mm": 1e3 * at[:, 1]}
    columns |= {"tension_1_N": tension, "read_x_mm": 1e3 * at[:, 0]}
    (tmp_path / "drums.csv").write_text(_table(columns), encoding="utf-8")
    geometry = f"anchor_mm = {(1e3 * anchors).tolist()}\nstiffness_N = [5000, 9000]"
    text = _study(geometry, 'instrument = "planar_position"\nchannels = ["read_x"]')
    text = text.replace("gap1_mm", "read_x_mm").replace("gap2_mm", "# ")
    data = resolved(text, tmp_path).dataset
    (series,) = data.series
    free = np.hypot(*np.moveaxis(at[:, None] - anchors, -1, 0))
    expected = free.copy()
    expected[:, 0] *= 1.0 + tension / 5000.0
    np.testing.assert_allclose(series.q, expected, rtol=0.0, atol=1e-9)


def _identified(
    folder: Path, study: str, readings: str, *options: str
) -> tuple[int, StudyResult]:
    path, data = folder / "cables.study.toml", folder / "drums.csv"
    path.write_text(study, encoding="utf-8")
    data.write_text(readings, encoding="utf-8")
    out = folder / "out"
    arguments = ["identify", path, "--readings", data, "--out", out, "--quiet"]
    code = main([*map(str, arguments), *options])
    return code, msgspec.json.decode(
        (out / "result.json").read_bytes(), type=StudyResult
    )


def test_with_a_known_stiffness_the_robot_is_calibrated(tmp_path, rng):
    robot = planar_cables.drawn(rng)
    text, _ = _robot_file(rng, robot, DRUM)
    study = _study(f"stiffness_N = {STIFFNESS}")
    code, result = _identified(tmp_path, study, text)
    assert code == 0
    assert result.estimate is not None
    estimate, truth = result.estimate, robot.by_name()
    assert 0.7 < estimate.chi2 / estimate.dof < 1.4
    for name, p in estimate.parameters.items():
        value = p.value * (1.0 if name.startswith("scale") else 1e-3)
        sd = p.sd * (1.0 if name.startswith("scale") else 1e-3)
        assert abs(value - truth[name]) < 4.5 * sd


def test_an_unknown_compliance_is_estimated(tmp_path, rng):
    """1 / (E A) in its unit, where the readings without the effect fit badly."""
    text, _ = _robot_file(rng, planar_cables.drawn(rng), DRUM)
    options = ("--with", "cable_stretch")
    code, result = _identified(tmp_path, _study(""), text, *options)
    assert code == 0
    assert result.estimate.chi2 > 10.0 * result.estimate.dof
    corrected = result.corrected
    assert 0.7 < corrected.chi2 / corrected.dof < 1.4
    compliance = corrected.effects["cable_stretch: cables"]
    legs = [corrected.effects[f"cable_stretch: leg {k}"].value for k in (1, 2, 3, 4)]
    assert compliance.unit == "ppm/N"
    mean = compliance.value + np.mean(legs)
    assert mean == pytest.approx(1e6 / STIFFNESS, rel=0.02)
    assert any("tension of each cable is known" in c for c in corrected.conditions)


def test_without_tensions_a_warning_says_what_is_missing(tmp_path, rng):
    robot = planar_cables.drawn(rng)
    q = robot.lengths(rng.uniform(-0.5, 0.5, (READINGS, 2)))
    q += DRUM * rng.standard_normal(q.shape)
    columns = {f"q{k + 1}_mm": 1e3 * v for k, v in enumerate(q.T)}
    study = _study(f"stiffness_N = {STIFFNESS}")
    _, result = _identified(tmp_path, study, _table(columns))
    (warning,) = [w for w in result.warnings if "stretch" in w]
    assert "tension_1_N" in warning


@pytest.mark.parametrize(("column", "cells", "words"), [
    ("tension_1_N", ("40", ""), "the cell is empty"),
    ("tension_1_N", ("40", "-3"), "tension_1 is at least 0"),
    ("tension_1_mm", ("40", "30"), "the unit does not fit"),
    ("tension_5_N", ("40", "30"), "unknown column"),
])  # fmt: skip
def test_tensions_that_make_no_sense_are_refused(tmp_path, column, cells, words):
    header = f"setup,run,order,q1_mm,q2_mm,q3_mm,q4_mm,{column}"
    rows = [
        f"drums,a,{i + 1},1280,1280,1280,1280,{cell}" for i, cell in enumerate(cells)
    ]
    text = "\n".join([header, *rows]) + "\n"
    (tmp_path / "drums.csv").write_text(text, encoding="utf-8")
    error = refused(_study(""), folder=tmp_path)
    assert words in str(error)


def test_a_stiffness_that_is_none_is_refused(tmp_path):
    (tmp_path / "drums.csv").write_text("", encoding="utf-8")
    assert "must be above 0" in str(refused(_study("stiffness_N = 0"), folder=tmp_path))
    two = refused(_study("stiffness_N = [1, 2]"), folder=tmp_path)
    assert "one number for each cable" in str(two)
