"""Parameters over all hypotheses: who takes them, and the compensation that is sent."""

import dataclasses
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import report_fixture
from result_sample import drop, whole
from shipped_models import a3_head

from kernel.answer_mixture import Case, case, readings
from oed import trust
from oed.accuracy import Spread, least_error
from oed.effects import SessionStates
from oed.result import CompensationName, MixtureSection, StudyResult
from pkm_reports.sections import gap as chapter
from pkm_studies.acceptance import promise
from pkm_studies.compensation import identified_parameters
from pkm_studies.earlier_result import controller_values, known_parameters
from pkm_studies.stages.correct import mixture
from pkm_studies.stages.correct import mixture as mixture_stage
from pkm_studies.stages.correct.corrected import drop_tables
from pkm_studies.stages.correct.mixture import mixture_sentences
from pkm_studies.stages.predict import knowledge

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


__all__ = ["case"]
COMMAND = np.array([[y, z] for y in (-0.9, 0.0, 0.9) for z in (0.4, 0.8, 1.1)])
SHIFT = 5e-3  #: a shift that no session shows, m


def spreads(**rms: float) -> dict[str, Spread]:
    return {name: Spread(value, value, value) for name, value in rms.items()}


def test_components_count_in_units_of_their_error_with_nothing_sent():
    """(1/2)^2 + (1/2)^2 < (1/10)^2 + 1^2 < 2, though the lengths alone say otherwise."""
    before = spreads(x=100e-6, turn=1e-3, held=0.0)
    after = {
        "halves both": spreads(x=50e-6, turn=0.5e-3, held=0.0),
        "corrects x": spreads(x=10e-6, turn=1e-3, held=0.0),
    }
    assert least_error(before, after, {"x", "turn", "held"}) == "halves both"
    assert (
        least_error(before, dict(reversed(after.items())), {"x", "turn"})
        == "halves both"
    )


def test_nothing_is_sent_where_all_is_worse():
    before = spreads(x=100e-6, turn=1e-3)
    worse = {"one": spreads(x=101e-6, turn=1e-3), "other": spreads(x=1.0, turn=0.0)}
    assert least_error(before, worse, {"x", "turn"}) == CompensationName.NOTHING
    assert least_error(before, {**worse, "equal": before}, {"x", "turn"}) == "equal"


def test_what_no_drive_corrects_does_not_decide():
    """y falls to a quarter by one, x to a half by the other; y has no drive."""
    before = spreads(x=4e-6, y=100e-6)
    after = {"y": spreads(x=4e-6, y=25e-6), "x": spreads(x=2e-6, y=100e-6)}
    assert least_error(before, after, {"x"}) == "x"
    assert least_error(before, after, {"x", "y"}) == "y"


def section_of(case: Case, theta: np.ndarray, plain: np.ndarray) -> MixtureSection:
    given = readings()
    problem = given.problem(given.measurement.nominal)
    use = mixture.UseOfMachine(COMMAND, "absolute", SessionStates.of(problem), {})
    best = mixture.BestAnswer(theta, None, plain)
    return mixture.mixture_section(
        given.measurement, given.series, case.mixture, best, use, [1, 2]
    )


def score(section: MixtureSection, name: str) -> float:
    """Sum of the squares relative to those with nothing sent."""
    rms = {choice.name: choice.rms for choice in section.choices}
    return sum(
        (rms[name][n] / unit) ** 2 for n, unit in rms[CompensationName.NOTHING].items()
    )


def test_all_candidates_are_judged_and_the_least_is_sent(case):
    mean = case.mixture.mean
    section = section_of(case, case.answers[0].mean, case.answers[1].mean)
    names = [choice.name for choice in section.choices]
    assert names == [
        CompensationName.MIXTURE,
        CompensationName.BEST,
        CompensationName.PLAIN,
        CompensationName.NOTHING,
    ]
    assert score(section, section.sent) == min(score(section, n) for n in names)
    assert score(section, section.sent) < score(section, CompensationName.NOTHING)
    for name, value in section.controller.items():
        assert value == pytest.approx(section.parameters[name].value, rel=0.2, abs=1.0)
    assert len(section.controller) <= len(mean)


def test_a_shift_that_is_worse_than_the_plain_fit_is_not_sent(case, monkeypatch):
    """As from states that no machine is in: parameters far off what the readings say."""

    def far(known: knowledge.ParameterKnowledge, *given: object) -> object:
        return dataclasses.replace(
            known, sent=known.measurement.machine.nominal + SHIFT
        )

    monkeypatch.setattr(knowledge, "absorb_effects", far)
    plain = case.answers[0].mean
    section = section_of(case, case.mixture.mean + SHIFT, plain)
    assert section.sent == CompensationName.PLAIN
    machine_parameters = readings().measurement.machine.parameters
    for k, parameter in enumerate(machine_parameters):
        if parameter.name in section.controller and parameter.unit == "m":
            assert section.controller[parameter.name] == pytest.approx(1e3 * plain[k])
    hopeless = section_of(case, plain + SHIFT, plain + 2.0 * SHIFT)
    assert hopeless.sent == CompensationName.NOTHING
    assert "with nothing corrected" in hopeless.words[-1]


def test_a_result_whose_best_is_nothing_is_objected_to():
    result = report_fixture.result_of(whole())
    assert result.gap.mixture is not None
    mixture = msgspec.structs.replace(result.gap.mixture, sent=CompensationName.NOTHING)
    gap = msgspec.structs.replace(result.gap, mixture=mixture)
    known = trust.objections(result)
    (objection,) = [
        sentence
        for sentence in trust.objections(msgspec.structs.replace(result, gap=gap))
        if sentence not in known
    ]
    assert "no correction" in objection


def test_every_section_says_what_a_controller_gets():
    """After a correction by name: those of its `controller` for geometry alone."""
    result = report_fixture.result_of(whole())
    result = msgspec.structs.replace(result, gap=None)
    assert result.corrected is not None
    corrected = msgspec.structs.replace(result.corrected, controller={"da1y": 2.0})
    result = msgspec.structs.replace(result, corrected=corrected)
    at = machine.index("da1y")
    assert controller_values(result, machine)[0][at] == pytest.approx(2e-3)
    own = 1e-3 * corrected.parameters["da1y"].value
    with_effects, _ = controller_values(result, machine, with_effects=True)
    assert with_effects[at] == pytest.approx(own)


def test_effects_are_corrected_only_where_that_is_better():
    result = report_fixture.result_of(whole())
    assert result.corrects_effects
    assert result.gap.mixture is not None
    mixture = msgspec.structs.replace(result.gap.mixture, with_effects=None)
    gap = msgspec.structs.replace(result.gap, mixture=mixture)
    assert not msgspec.structs.replace(result, gap=gap).corrects_effects
    assert result.corrected is not None
    section = drop_tables(result.corrected)
    assert not section.tables
    assert set(section.not_tabled) == {"backlash"}
