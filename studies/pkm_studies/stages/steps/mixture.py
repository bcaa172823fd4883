"""The step that mixes the answers of a diagnosis."""

from __future__ import annotations

import msgspec
import numpy as np

from oed.corrected import AnswerFits
from oed.effects import expected_columns
from oed.gap import untestable
from oed.result import CorrectedSection, PredictionSection
from pkm_studies.base import Stream
from pkm_studies.resolve import regular_commands
from pkm_studies.stages.corrected.section import NO_HELP, drop_tables
from pkm_studies.stages.fit.effects import readings_with_covariates, states_in_use
from pkm_studies.stages.gap import mixture as sections
from pkm_studies.stages.run_state import Fitted

#: why no table holds an effect that varies faster than its commands
COARSE = "it varies faster over the workspace than a table can follow"


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
    request = state.resolved.diagnosed
    effect_readings = readings_with_covariates(state, request)
    problem = effect_readings.problem(state.estimate.theta)
    testable = [e for e in request.effects if untestable(e, problem.states) is None]
    rng = state.rng(Stream.MIXTURE)
    fits = AnswerFits(
        readings=effect_readings,
        effects=request.effects,
        allowed=expected_columns(problem, testable),
        estimate_noise=state.estimates_noise,
        rng=rng,
        max_iterations=state.study.identify.max_iterations,
        corrected=state.corrected,
    )
    mixture = fits.fit(diagnosis.answers, diagnosis.contents, state.estimate)
    if mixture is None:
        return state
    state = state.replace(mixture=mixture)
    corrected, table = state.corrected, state.study.prediction
    theta = state.estimate.theta
    if corrected is not None:
        theta = corrected.estimate.theta[: corrected.parameters]
    use = sections.UseOfMachine(
        command=regular_commands(state.study, state.measurement.kinematics),
        reference="home" if table is None else table.reference,
        session=states_in_use(state),
        wanted=state.resolved.wanted_accuracy,
        source="study" if table is not None and table.states else "readings",
    )
    section = sections.mixture_section(
        state.measurement,
        effect_readings.series,
        mixture,
        sections.BestAnswer(theta, corrected, state.estimate.theta),
        use,
        Stream.MIXTURE_ACCURACY.key(state.seed),
    )
    tabled, reason = state.result.corrected, NO_HELP
    if tabled is not None and _is_too_coarse(tabled, section.with_effects):
        section, reason = msgspec.structs.replace(section, with_effects=None), COARSE
    gap = msgspec.structs.replace(gap, mixture=section)
    state = state.add_sections(gap=sections.add_bound(gap))
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
