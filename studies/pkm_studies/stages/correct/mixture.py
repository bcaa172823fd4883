"""The step that mixes the answers of a diagnosis."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from msgspec.structs import replace

from oed import units
from oed.accuracy import BudgetModel, Reference, least_error
from oed.base import Array
from oed.corrected import AnswerFits, AnswerMixture, CorrectedEstimate
from oed.effects import ExpectedColumns, SessionStates
from oed.gap import untestable
from oed.measurement import Measurement, Series
from oed.result import (
    CompensationChoice,
    CompensationName,
    CorrectedSection,
    GapSection,
    MixedAnswer,
    MixedParameter,
    MixtureSection,
    PredictionSection,
    SpreadRecord,
)
from oed.text import format_number, format_probability, join_words
from pkm_studies.base import Stream
from pkm_studies.resolve import StudyWorkspace
from pkm_studies.stages.correct.corrected import NO_HELP, drop_tables
from pkm_studies.stages.fit.estimate import (
    add_controller,
    displayed_covariance,
    displayed_states,
    readings_with_covariates,
    states_in_use,
)
from pkm_studies.stages.gap.sentences import plain_name
from pkm_studies.stages.predict import knowledge
from pkm_studies.stages.predict.knowledge import ActingEffects, ParameterKnowledge
from pkm_studies.stages.predict.prediction import accuracy_section, add_wanted
from pkm_studies.stages.run_state import Fitted

# Parameters and accuracy over all hypotheses of a diagnosis: the record `gap.mixture`.

INTERVAL = (0.025, 0.975)  #: ends of a 95 % interval
PHRASES = {
    CompensationName.MIXTURE: "by the parameters over all hypotheses",
    CompensationName.BEST: "by those of the best hypothesis alone",
    CompensationName.PLAIN: "by those of the fit without effects",
    CompensationName.BEST_WITH_EFFECTS: "by the best hypothesis with its effects corrected",
    CompensationName.NOTHING: "with nothing corrected",
}
#: probability that what stays after compensation is within its bound
BOUND_PROBABILITY = 0.95
ROUNDING_PROBABILITY = 1e-6  #: probability that is rounding
#: last number of the seed of the states in which known effects are taken up
STATE_SEED_PART = 1
#: share of a parameter's variance between the answers from which they disagree
MIN_DISAGREEMENT_SHARE = 0.05


@dataclasses.dataclass(frozen=True, eq=False)
class UseOfMachine:
    """Where, in which states and by which accuracy the machine is used."""

    command: Array  #: (n, n_dof) commands, SI
    reference: Reference
    #: states in which the readings were taken and the machine is used
    session: SessionStates
    wanted: Mapping[str, float]  #: errors to reach by component, SI
    #: where the states of use are from: the study, or the readings
    source: str = "readings"

    def states(self) -> dict[str, Any]:
        """Fields of a predicted accuracy: the states in which effects act."""
        if not self.session.used:
            return {}
        return {
            "states": displayed_states(self.session.used),
            "states_from": self.source,
        }


@dataclasses.dataclass(frozen=True, eq=False)
class BestAnswer:
    """What a compensation by the decision alone takes."""

    theta: Array  #: (n,) parameters, SI
    #: the fit with its effects; None where it names none
    corrected: CorrectedEstimate | None
    plain: Array  #: (n,) parameters of the fit without effects, SI


def mixture_section(
    measurement: Measurement,
    series: Sequence[Series],
    mixture: AnswerMixture,
    best: BestAnswer,
    use: UseOfMachine,
    seed: Sequence[int],
) -> MixtureSection:
    """The record of a mixture.

    Without commands it has no accuracy, and the controller is given the mean.

    seed  of all draws: every compensation is judged by the same ones
    """
    section = MixtureSection(
        answers=[
            MixedAnswer(a.effects, a.probability, a.unseen) for a in mixture.answers
        ],
        rest=mixture.rest,
        parameters=_parameters(measurement, mixture),
        covariance=displayed_covariance(
            measurement, mixture.covariance, np.diag(mixture.covariance) > 0.0
        ),
    )
    if not len(use.command):
        machine = measurement.machine
        count = len(machine.parameters)
        section = add_controller(section, machine, mixture.mean[:count])
    else:
        belief = _knowledge(measurement, series, mixture, best, seed, use.session)
        section = _add_accuracy(section, belief, best, use, seed)
    return replace(section, words=mixture_sentences(section))


def _knowledge(
    measurement: Measurement,
    series: Sequence[Series],
    mixture: AnswerMixture,
    best: BestAnswer,
    seed: Sequence[int],
    session: SessionStates,
) -> ParameterKnowledge:
    """Draws over all hypotheses; the last effects are those of the best answer's fit."""
    count = len(measurement.machine.parameters)
    drawn = mixture.draw(np.random.default_rng(seed))
    parts = [] if drawn.columns is None else [drawn.columns]
    coefficients = drawn.coefficients
    if best.corrected is not None:
        parts.append(best.corrected.columns)
        width = len(best.corrected.scales)
        coefficients = np.hstack([coefficients, np.zeros((len(coefficients), width))])
    columns = ExpectedColumns.side_by_side(parts)
    effects = None
    if columns is not None:
        effects = ActingEffects(columns, session, mixture.mean, coefficients)
    errors = drawn.theta[:, :count] - mixture.mean[:count]
    return ParameterKnowledge(
        measurement,
        tuple(series),
        BudgetModel.of(measurement, series, mixture.mean),
        errors.T @ errors / len(errors),
        mean=(mixture.mean - measurement.drawn)[:count],
        draws=errors,
        effects=effects,
    )


def _add_accuracy(
    section: MixtureSection,
    belief: ParameterKnowledge,
    best: BestAnswer,
    use: UseOfMachine,
    seed: Sequence[int],
) -> MixtureSection:
    machine = belief.measurement.machine
    count = len(machine.parameters)
    # states other than those that the candidates are judged in
    rng = np.random.default_rng([*seed, STATE_SEED_PART])
    absorbed = knowledge.absorb_effects(belief, use.command, use.reference, rng)
    mean = machine.nominal + belief.centre if absorbed.sent is None else absorbed.sent
    sent = {
        CompensationName.MIXTURE: mean,
        CompensationName.BEST: best.theta[:count],
        CompensationName.PLAIN: best.plain[:count],
    }
    if np.array_equal(best.plain, best.theta):
        del sent[CompensationName.PLAIN]
    compensations = {
        name: dataclasses.replace(belief, sent=parameters)
        for name, parameters in sent.items()
    }
    if best.corrected is not None and belief.effects is not None:
        of_best = best.corrected.estimate.theta[best.corrected.parameters :]
        corrected = np.zeros(belief.effects.draws.shape[1])
        corrected[-len(of_best) :] = of_best
        compensations[CompensationName.BEST_WITH_EFFECTS] = dataclasses.replace(
            compensations[CompensationName.BEST], corrected=corrected
        )
    judged = knowledge.compared(
        compensations, use.command, use.reference, np.random.default_rng(seed)
    )
    predicted = {name: result.prediction for name, result in judged.items()}
    before = predicted[CompensationName.BEST].before
    after = {n: p.after for n, p in predicted.items()}
    geometry = least_error(before, {name: after[name] for name in sent}, machine.driven)
    sections, choices = {}, []
    for name, prediction in predicted.items():
        record = accuracy_section(belief.measurement.kinematics, prediction, "mixture")
        record = replace(record, **use.states())
        sections[name] = add_wanted(record, use.wanted)
        rms = {n: c.after.rms for n, c in record.components.items()}
        choices.append(CompensationChoice(name, rms))
    rms = {
        n: c.before.rms for n, c in sections[CompensationName.BEST].components.items()
    }
    choices.append(CompensationChoice(CompensationName.NOTHING, rms))
    shown = CompensationName.BEST if geometry == CompensationName.NOTHING else geometry
    with_effects = sections.get(CompensationName.BEST_WITH_EFFECTS)
    if least_error(before, after, machine.driven) != CompensationName.BEST_WITH_EFFECTS:
        with_effects = None
    return replace(
        add_controller(section, machine, sent[shown]),
        sent=geometry,
        choices=choices,
        prediction=sections[shown],
        with_effects=with_effects,
    )


def add_bound(gap: GapSection) -> GapSection:
    """The section whose advice to go ahead says how much may still hide."""
    mixture = gap.mixture
    if not gap.next or gap.next[0] != GapSection.GO_AHEAD or mixture is None:
        return gap
    if mixture.prediction is None or mixture.sent == CompensationName.NOTHING:
        return gap
    bounds = [
        f"{name} {format_number(c.after.rms_quantiles[SpreadRecord.LEVELS.index(BOUND_PROBABILITY)])} {c.after.unit}"
        for name, c in mixture.prediction.components.items()
        if c.compensatable
    ]
    sentence = (
        f"{GapSection.GO_AHEAD} With effects too small to show counted, the rms error that stays is at most"
        f" {join_words(bounds)} with {100.0 * BOUND_PROBABILITY:.0f} %."
    )
    return replace(gap, next=[sentence, *gap.next[1:]])


def _parameters(
    measurement: Measurement, mixture: AnswerMixture
) -> dict[str, MixedParameter]:
    low, high = mixture.quantiles(INTERVAL)
    sd = np.sqrt(np.diag(mixture.covariance))
    variances = np.array([np.diag(a.covariance) for a in mixture.answers])
    within = np.sqrt(mixture.shares @ variances)
    parameters = {}
    for k in np.flatnonzero(sd > 0.0):
        parameter = measurement.parameters[k]
        unit = units.display(parameter.unit)
        parameters[parameter.name] = MixedParameter(
            value=units.number(mixture.mean[k], unit),
            sd=units.number(sd[k], unit),
            within=units.number(within[k], unit),
            low=units.number(low[k], unit),
            high=units.number(high[k], unit),
            unit=unit,
        )
    return parameters


def mixture_sentences(section: MixtureSection) -> list[str]:
    """What the answers are, how far they set the parameters apart, what to compensate."""
    named = [
        f"{_name(answer)} ({format_probability(answer.probability)})"
        for answer in section.answers
    ]
    sentence = f"Over all hypotheses of the diagnosis: {', '.join(named)}"
    if section.rest > ROUNDING_PROBABILITY:
        rest = format_probability(section.rest)
        sentence += f"; others, {rest} together, are left out"
    sentences = [f"{sentence}.", *_parameters_text(section)]
    if section.prediction is None:
        return sentences
    unit = section.prediction.unit
    components = section.prediction.components.items()
    driven = [name for name, component in components if component.compensatable]
    parts = []
    for choice in section.choices:
        if choice.name in (
            section.sent,
            CompensationName.BEST_WITH_EFFECTS,
            CompensationName.NOTHING,
        ):
            figures = [f"{n} {format_number(choice.rms[n])} {unit[n]}" for n in driven]
            parts.append(f"{join_words(figures)} {PHRASES[choice.name]}")
    return [*sentences, f"Expected rms error over all hypotheses: {'; '.join(parts)}."]


def _name(answer: MixedAnswer) -> str:
    named = join_words([plain_name(name) for name in answer.effects])
    if answer.unseen:
        return f"{named} beside small effects" if named else "small effects alone"
    return named or "noise alone"


def _parameters_text(section: MixtureSection) -> list[str]:
    """The parameter of which the answers disagree most."""
    between = {
        name: 1.0 - (p.within / p.sd) ** 2 for name, p in section.parameters.items()
    }
    if not between or len(section.answers) < 2:
        return []
    name = max(between, key=lambda n: between[n])
    if between[name] < MIN_DISAGREEMENT_SHARE:
        return ["The hypotheses agree on all parameters."]
    return [
        f"The hypotheses disagree most on {name}: {100.0 * between[name]:.0f} % of its"
        " variance is between them."
    ]


#: why no table holds an effect that varies faster than its commands
COARSE = "it varies faster over the workspace than a table can follow"


def mix_answers(state: Fitted) -> Fitted:
    """Parameters and accuracy over all hypotheses of a diagnosis, unless the fit is bad."""
    diagnosis, gap = state.diagnosis, state.result.gap
    if diagnosis is None or gap is None or state.with_effects:
        return state
    if state.fit_is_bad and state.corrected is None:
        return state
    state.progress.stage("parameters over all hypotheses")
    request = state.resolved.diagnosed
    effect_readings = readings_with_covariates(state, request)
    problem = effect_readings.problem(state.estimate.theta)
    testable = [e for e in request.effects if untestable(e, problem.states) is None]
    rng = state.rng(Stream.MIXTURE)
    fits = AnswerFits(
        readings=effect_readings,
        effects=request.effects,
        allowed=ExpectedColumns.of(problem, testable),
        estimate_noise=state.estimates_noise,
        rng=rng,
        max_iterations=state.study.identify.max_iterations,
        corrected=state.corrected,
    )
    mixture = fits.fit(diagnosis.answers, diagnosis.contents, state.estimate)
    if mixture is None:
        return state
    state = state.replace(mixture=mixture)
    corrected = state.corrected
    workspace = StudyWorkspace(state.study, state.measurement.kinematics)
    used = state.study.prediction
    theta = state.estimate.theta
    if corrected is not None:
        theta = corrected.estimate.theta[: corrected.parameters]
    use = UseOfMachine(
        command=workspace.regular,
        reference=workspace.reference,
        session=states_in_use(state),
        wanted=state.resolved.wanted_accuracy,
        source="study" if used is not None and used.states else "readings",
    )
    section = mixture_section(
        state.measurement,
        effect_readings.series,
        mixture,
        BestAnswer(theta, corrected, state.estimate.theta),
        use,
        Stream.MIXTURE_ACCURACY.key(state.seed),
    )
    tabled, reason = state.result.corrected, NO_HELP
    if tabled is not None and _is_too_coarse(tabled, section.with_effects):
        section, reason = replace(section, with_effects=None), COARSE
    gap = replace(gap, mixture=section)
    state = state.add_sections(gap=add_bound(gap))
    if tabled is None or section.with_effects is not None:
        return state
    return state.add_sections(corrected=drop_tables(tabled, reason))


def _is_too_coarse(
    section: CorrectedSection, predicted: PredictionSection | None
) -> bool:
    """Whether straight lines between a table's commands cost more than what stays."""
    if predicted is None:
        return False
    after = {name: c.after.rms for name, c in predicted.components.items()}
    return any(
        cost > after.get(name, np.inf)
        for table in section.tables
        for name, cost in table.interpolation.items()
    )
