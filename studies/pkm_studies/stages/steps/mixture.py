"""The step that mixes the answers of a diagnosis."""

from __future__ import annotations

import msgspec

from oed.compensate.effects.answer_fits import AnswerFits
from oed.compensate.effects.expected_columns import expected_columns
from oed.estimation import identification
from oed.estimation.estimate import Estimate
from oed.estimation.identification import IdentificationError
from oed.gap.data.signature import untestable
from pkm_studies.resolve.workspace import regular_commands
from pkm_studies.stages.fit.effects import readings_with_covariates, states_in_use
from pkm_studies.stages.gap import mixture as sections
from pkm_studies.stages.run_state import Fitted, Stream


def mix_answers(state: Fitted) -> Fitted:
    """Parameters and accuracy over all answers of the diagnosis, where there is one.

    Nothing rests on a fit that failed its check, unless an effect explains that.
    """
    diagnosis, gap = state.diagnosis, state.result.gap
    if diagnosis is None or gap is None or state.with_effects:
        return state
    if state.fit_is_bad and state.corrected is None:
        return state
    state.progress.stage("parameters over all answers")
    request = state.resolved.gap_or_default
    given = readings_with_covariates(state, request)
    try:
        without_effects = _without_effects(state)
    except IdentificationError as error:
        return state.with_warnings(
            f"there are no parameters over all answers: with the geometry alone {error}"
        )
    problem = given.problem(without_effects.theta)
    testable = [e for e in request.effects if untestable(e, problem.states) is None]
    rng = state.rng(Stream.MIXTURE)
    fits = AnswerFits(
        readings=given,
        effects=request.effects,
        allowed=state.effect_columns or expected_columns(problem, testable),
        estimate_noise=state.estimates_noise,
        rng=rng,
        max_iterations=state.study.identify.max_iterations,
        corrected=state.corrected,
    )
    mixture = fits.fit(diagnosis.answers, diagnosis.contents, without_effects)
    if mixture is None:
        return state
    corrected, table = state.corrected, state.study.prediction
    theta = state.estimate.theta
    if corrected is not None:
        theta = corrected.estimate.theta[: corrected.parameters]
    use = sections.UseOfMachine(
        command=regular_commands(state.study, state.measurement.kinematics),
        reference="home" if table is None else table.reference,
        session=states_in_use(state),
        wanted=state.resolved.wanted_accuracy,
    )
    section = sections.mixture_section(
        state.measurement,
        given.series,
        mixture,
        sections.BestAnswer(theta, corrected),
        use,
        Stream.MIXTURE_ACCURACY.key(state.seed),
    )
    return state.with_sections(gap=msgspec.structs.replace(gap, mixture=section))


def _without_effects(state: Fitted) -> Estimate:
    """The fit of the geometry alone. Raises IdentificationError."""
    if state.estimate.effects is None:
        return state.estimate
    return identification.identify(
        state.measurement,
        state.readings.series,
        state.readings.y,
        stages=state.resolved.identification_stages,
        estimate_noise=state.estimates_noise,
        start=state.estimate.theta,
        max_iterations=state.study.identify.max_iterations,
    )
