"""The diagnosis and the corrected model have one estimate of each coefficient."""

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


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResult, dict]:
    """A diagnosed virtual machine, and the coefficients that it has, SI."""
    folder = tmp_path_factory.mktemp("a3_head")
    path = folder / "case.study.toml"
    path.write_text(A3, encoding="utf-8")
    study = studies.Study.load(path)
    _, truth_file = stages.simulate_study(study, folder / "case.csv")
    truth = json.loads(Path(truth_file).read_text(encoding="utf-8"))["effects"][0]
    readings = [folder / "case.csv"]
    with pytest.MonkeyPatch.context() as patch:
        # the accuracy over all hypotheses takes half of the time
        patch.setattr("pkm_studies.stages.order.mix_answers", lambda state: state)
        return stages.diagnose_study(study, readings, folder / "out", seed=1), truth


def test_one_value_and_one_deviation(case):
    result, truth = case
    gap, corrected = result.gap, result.corrected
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


def test_it_is_that_of_the_machine(case):
    result, truth = case
    estimates = {
        c.name: c for c in result.gap.coefficients if c.effect == truth["effect"]
    }
    for name, true in truth["coefficients"].items():
        c = estimates[name]
        assert abs(c.value - true["value"]) < 4.0 * c.sd, name
        if abs(true["prior_sds"]) > 2.0:
            assert abs(c.value) > 5.0 * c.sd, name
