"""The diagnosis and the corrected model have one estimate of each coefficient."""

from __future__ import annotations

import json
from pathlib import Path

import gap_fixture
import pytest
import sample

from oed import units
from oed.result import StudyResult
from pkm_studies import stages
from pkm_studies import study as studies

ACTING = "[[gap.acting]]"
A3 = (
    sample.changed(
        gap_fixture.STUDY.split(ACTING)[0],
        (
            '["effects.py:backlash", "effects.py:cold"]',
            '["backlash", "friction", "encoder_scale"]',
        ),
        ("count = 24", "count = 12"),
    )
    + '[[gap.acting]]\neffect = "backlash"\ncoefficients = { "leg 2" = 3.0 }\n'
)
PLANAR = """\
schema = 1
name = "planar_scale"
seed = 2
[machine]
model = "planar_2dof"
[[setup]]
name = "rm5"
instrument = "rm5"
[[setup]]
name = "rm4"
instrument = "rm4"
[noise]
rm5 = { dy_um = 1.0, dz_um = 3.0 }
rm4 = { dy_um = 3.0 }
[design]
[[design.reference]]
name = "lines"
setup = "rm5"
y_mm = { from = -1500.0, to = 1500.0, count = 13 }
z_mm = [0.0, 750.0, 1500.0]
runs_by = "z"
[[design.reference]]
name = "lines"
setup = "rm4"
y_mm = [-1500.0, 0.0, 1500.0]
z_mm = { from = 0.0, to = 1500.0, count = 11 }
runs_by = "y"
[readings]
simulate = true
draw = true
[posterior]
enabled = false
[report]
html = false
pdf = false
[gap]
effects = ["encoder_scale", "pitch_accumulation", "frame_bending"]
[[gap.acting]]
effect = "encoder_scale"
coefficients = { "leg 1" = 20.0, "leg 2" = 1.0 }
"""
DELTA = """\
schema = 1
name = "delta_scale"
seed = 6
[machine]
model = "linear_delta"
[[setup]]
name = "tracker"
instrument = "pose_tracker_position"
[noise]
read_x_um = 10
read_y_um = 10
read_z_um = 10
[design]
[[design.reference]]
name = "grid"
setup = "tracker"
x_mm = [-80.0, 0.0, 80.0]
y_mm = [-80.0, 0.0, 80.0]
z_mm = [0.0, 60.0, 120.0]
runs_by = "z"
[readings]
simulate = true
draw = true
[posterior]
enabled = false
[report]
html = false
pdf = false
[gap]
effects = ["encoder_scale", "pitch_accumulation", "gravity"]
[[gap.acting]]
effect = "encoder_scale"
coefficients = { "leg 2" = -60.0 }
"""
MACHINES = {"a3_head": A3, "planar_2dof": PLANAR, "linear_delta": DELTA}


@pytest.fixture(
    scope="module",
    params=[
        "a3_head",
        pytest.param("planar_2dof", marks=pytest.mark.slow),
        pytest.param("linear_delta", marks=pytest.mark.slow),
    ],
)
def case(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[StudyResult, dict]:
    """A diagnosed virtual machine, and the coefficients that it has, SI."""
    folder = tmp_path_factory.mktemp(request.param)
    path = folder / "case.study.toml"
    path.write_text(MACHINES[request.param], encoding="utf-8")
    study = studies.load(path)
    _, truth_file = stages.simulate_study(study, folder / "case.csv")
    truth = json.loads(Path(truth_file).read_text(encoding="utf-8"))["effects"][0]
    readings = [folder / "case.csv"]
    return stages.diagnose_study(study, readings, folder / "out", seed=1), truth


def test_one_value_and_one_deviation(case: tuple[StudyResult, dict]) -> None:
    result, truth = case
    gap, corrected = result.gap, result.corrected
    assert gap is not None
    assert corrected is not None
    assert truth["effect"] in gap.selected
    shared = {f"{c.effect}: {c.name}": c for c in gap.coefficients}
    assert set(shared) == set(corrected.effects)
    for name, estimate in corrected.effects.items():
        c = shared[name]
        factor = units.coefficient_unit(c.unit)[1]
        assert c.value == pytest.approx(factor * estimate.value, rel=1e-9)
        assert c.sd == pytest.approx(factor * estimate.sd, rel=1e-9)
        assert c.prior_sd == pytest.approx(factor * estimate.prior_sd, rel=1e-9)
    for effect, constants in corrected.constants.items():
        assert gap.constants[effect] == constants


def test_it_is_that_of_the_machine(case: tuple[StudyResult, dict]) -> None:
    result, truth = case
    assert result.gap is not None
    estimates = {
        c.name: c for c in result.gap.coefficients if c.effect == truth["effect"]
    }
    for name, true in truth["coefficients"].items():
        c = estimates[name]
        assert abs(c.value - true["value"]) < 4.0 * c.sd, name
        if abs(true["prior_sds"]) > 2.0:
            assert abs(c.value) > 5.0 * c.sd, name
