"""Parameters over all hypotheses of a diagnosis: who takes them, and what is printed."""

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import report_fixture
from result_sample import drop, whole
from shipped_models import a3_head

from oed import trust
from oed.result import MixtureSection, StudyResult
from pkm_reports.sections import gap as chapter
from pkm_studies.acceptance import promise
from pkm_studies.compensation import identified_parameters
from pkm_studies.earlier_result import known_parameters
from pkm_studies.stages.correct import mixture as mixture_stage
from pkm_studies.stages.correct.mixture import mixture_sentences

machine = a3_head.machine

NAMES = ("da1y", "da1z")


@pytest.fixture
def result() -> StudyResult:
    return report_fixture.result_of(whole())


def mixture_of(result: StudyResult) -> MixtureSection:
    assert result.gap.mixture is not None
    return result.gap.mixture


def sent(result: StudyResult, *, tables: bool) -> tuple[np.ndarray, str]:
    identified = identified_parameters(result, machine, tables=tables)
    values = identified.values[[machine.index(name) for name in NAMES]]
    return values, identified.origin


def test_a_controller_without_effects_takes_the_parameters_over_all_answers(result):
    values, origin = sent(result, tables=False)
    assert origin == "gap.mixture"
    assert values == pytest.approx([1.1e-3, 0.9e-3])


def test_a_controller_with_effects_takes_what_was_estimated_with_them(result):
    assert result.corrected is not None
    values, origin = sent(result, tables=True)
    assert origin == "corrected"
    best = [1e-3 * result.corrected.parameters[name].value for name in NAMES]
    assert values == pytest.approx(best)


def test_without_a_table_of_any_effect_geometry_is_all_that_is_sent():
    plain = whole()
    drop("corrected/tables/0")(plain)
    assert sent(report_fixture.result_of(plain), tables=True)[1] == "gap.mixture"


def test_a_file_says_what_is_reached_and_what_it_lacks(result):
    identified = identified_parameters(result, machine, tables=False)
    prediction = mixture_of(result).prediction
    words = " ".join(identified.conditions)
    assert "not in this file: backlash" in words
    rms = prediction.components["z"].after.rms
    assert f"z {rms:.3g}" in words


def test_a_next_plan_knows_the_parameters_over_all_answers(result, tmp_path):
    value, covariance, source = known_parameters(
        result, machine.name, list(NAMES), tmp_path
    )
    assert value == pytest.approx([1e-3, 1e-3])
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.2e-3, 0.2e-3])
    assert "all hypotheses" in source


def test_words_name_answers_disagreement_and_each_compensation(result):
    mixture = mixture_of(result)
    parameters = dict(mixture.parameters)
    agreed = msgspec.structs.replace(parameters["da1z"], within=0.2)
    mixture = msgspec.structs.replace(
        mixture, parameters={**parameters, "da1z": agreed}
    )
    answers, parameter, choices = mixture_sentences(mixture)
    assert "backlash (90 %), noise alone (5 %)" in answers
    assert "5 % together, are left out" in answers
    assert "disagree most on da1y: 75 %" in parameter
    assert "1 arcsec by the parameters over all hypotheses" in choices
    assert choices.startswith("Expected rms error over all hypotheses: ")
    assert "best hypothesis alone" not in choices


def test_answers_that_agree_are_said_to(result):
    mixture = mixture_of(result)
    parameters = {
        name: msgspec.structs.replace(p, within=p.sd)
        for name, p in mixture.parameters.items()
    }
    agreed = msgspec.structs.replace(mixture, parameters=parameters)
    assert mixture_sentences(agreed)[1] == "The hypotheses agree on all parameters."


def test_one_answer_agrees_with_no_other(result):
    mixture = mixture_of(result)
    alone = msgspec.structs.replace(mixture, answers=mixture.answers[:1], rest=0.0)
    words = " ".join(mixture_sentences(alone))
    assert "agree" not in words


def test_a_file_with_effects_says_what_all_answers_expect(result):
    mixture = mixture_of(result)
    assert result.gap is not None
    both = msgspec.structs.replace(mixture, with_effects=mixture.prediction)
    gap = msgspec.structs.replace(result.gap, mixture=both)
    result = msgspec.structs.replace(result, gap=gap)
    identified = identified_parameters(result, machine, tables=True)
    rms = mixture.prediction.components["z"].after.rms
    assert identified.origin == "corrected"
    assert "take the diagnosis' best hypothesis as true" in identified.conditions[-1]
    assert f"z {rms:.3g} um" in identified.conditions[-1]


def test_what_to_do_first_is_no_second_diagnosis(result):
    assert trust.remedy(result) == "do first what its diagnosis advises"
    plain = msgspec.structs.replace(result, gap=None)
    assert trust.remedy(plain) == "run `oed diagnose`"


@pytest.mark.parametrize("cost", [0.1, 0.7, 22.0])
def test_tables_that_cost_more_than_what_stays_are_too_coarse(cost):
    """A period of 10 mm in a table of 120 mm steps: 22 um where .74 um stay."""
    section = SimpleNamespace(tables=[SimpleNamespace(interpolation={"z": cost})])
    after = SimpleNamespace(after=SimpleNamespace(rms=0.74))
    predicted = SimpleNamespace(components={"z": after})
    assert mixture_stage._is_too_coarse(section, predicted) == (cost > 0.74)
    assert not mixture_stage._is_too_coarse(section, None)


def test_a_promise_says_what_geometry_alone_reaches(result):
    (condition,) = promise.without_effects(result)
    prediction = mixture_of(result).prediction
    rms = prediction.components["z"].after.rms
    assert f"z_um={rms:.3g}" in condition
    assert result.gap is not None
    gap = msgspec.structs.replace(result.gap, mixture=None)
    assert not promise.without_effects(msgspec.structs.replace(result, gap=gap))


def test_without_a_correction_a_test_promises_what_is_sent(result):
    """That is over all hypotheses, as the certificate says too (tests/certificate)."""
    sent_alone = msgspec.structs.replace(result, corrected=None)
    number = [c.name for c in machine.components].index("z")
    size = len(machine.parameters)
    unit = np.eye(size)
    slope = np.ones((1, 1, size))
    (rms,) = promise.promised_rms(sent_alone, machine, slope, [number], unit)
    prediction = mixture_of(result).prediction
    assert rms == pytest.approx(1e-6 * prediction.components["z"].after.rms)


def test_the_chapter_is_there_with_a_mixture_only(result):
    assert chapter.mixture_blocks(result)
    assert result.gap is not None
    gap = msgspec.structs.replace(result.gap, mixture=None)
    assert not chapter.mixture_blocks(msgspec.structs.replace(result, gap=gap))
