"""What a controller is sent: the compensation of least expected error, or nothing."""

import dataclasses

import msgspec
import numpy as np
import pytest
import report_fixture
from result_sample import whole
from shipped_models import a3_head

from kernel.answer_mixture import Case, case, readings
from oed import trust
from oed.accuracy import Spread, least_error
from oed.effects import SessionStates
from oed.result import CompensationName, MixtureSection
from pkm_studies.earlier_result import controller_values
from pkm_studies.stages.correct import mixture
from pkm_studies.stages.correct.corrected import drop_tables
from pkm_studies.stages.predict import knowledge

machine = a3_head.machine

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
