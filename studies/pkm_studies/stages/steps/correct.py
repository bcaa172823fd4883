"""The step that estimates parameters and effects together."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from oed import posterior
from oed.base import Array
from oed.checks import PHYSICAL_KINDS, CheckFinding, Severity, goodness_of_delivered
from oed.corrected import (
    CorrectedEstimate,
    EffectReadings,
    TurnedRuns,
    estimate_with_effects,
    find_turned_runs,
    predict_corrected,
    with_constants,
)
from oed.effect_model import Effect
from oed.estimation import IdentificationError
from oed.fit_limits import noise_ratio
from oed.gap import untestable
from oed.result import CorrectedSection, GoodnessSection, MistakeRecord
from oed.text import rounded
from pkm_studies import catalogue
from pkm_studies.base import Stream
from pkm_studies.resolve import (
    GapRequest,
    effect_with_sizes,
    regular_commands,
    workspace_axes,
)
from pkm_studies.stages.corrected import section as sections
from pkm_studies.stages.fit.effects import readings_with_covariates
from pkm_studies.stages.fit.noise import with_noise
from pkm_studies.stages.fit.posterior import sampler_options, sampling_warnings
from pkm_studies.stages.run_state import Fitted

if TYPE_CHECKING:
    from oed.result import CorrectedSection, GapSection

# What the alarms of a bad fit become where the fit with effects is good.
#
# The check looked at a fit without effects. Where parameters and effects together fit, the
# alarm would be untrue of the values that count.


def resolves_alarm(
    corrected: CorrectedSection, findings: Sequence[CheckFinding]
) -> bool:
    """Whether the fit with effects is good, and no finding remains that spoils it."""
    return not corrected.warnings and may_be_resolved(findings)


def may_be_resolved(findings: Sequence[CheckFinding]) -> bool:
    """Whether effects may be behind every finding that spoils the fit."""
    return all(f.severity > Severity.BAD_FIT or is_about_the_fit(f) for f in findings)


def resolved_section(
    section: GoodnessSection,
    corrected: CorrectedSection,
    findings: Sequence[CheckFinding],
) -> GoodnessSection:
    """The section with the alarms as they are with the effects in the model."""
    renamed = resolved_sentences(corrected, findings)
    sentences = [renamed.get(sentence, sentence) for sentence in section.findings]
    return msgspec.structs.replace(section, findings=sentences, bad_fit=False)


def resolved_sentences(
    corrected: CorrectedSection, findings: Sequence[CheckFinding]
) -> dict[str, str]:
    """Alarms of the fit without effects, and what is true with them."""
    ratio = noise_ratio(corrected.chi2, corrected.dof)
    effects = " and ".join(corrected.constants)
    opening = (
        f"With {effects} in the model {_fit(ratio)}, and the corrected values count."
    )
    return sentences_with(opening, findings)


def _fit(ratio: float | None) -> str:
    if ratio is None:
        return "the readings fit"
    return f"the residuals are {rounded(ratio)} times the stated noise"


def sentences_with(opening: str, findings: Sequence[CheckFinding]) -> dict[str, str]:
    """Alarms of the fit without effects, each after what is true with them."""
    return {
        f.sentence: f"{opening} Without: {f.sentence[:1].lower()}{f.sentence[1:]}"
        for f in findings
        if is_about_the_fit(f)
    }


def turned_sentence(corrected: CorrectedSection, turned: TurnedRuns) -> str:
    """Which runs were driven the other way than their rows say."""
    names = ", ".join(run for _, run in turned.runs)
    runs, were = ("run", "was") if len(turned.runs) == 1 else ("runs", "were")
    effects = " and ".join(corrected.constants)
    return (
        f"The readings look mistaken: {runs} {names} {were} driven the other way than the"
        f" order of the rows says, or all others were (residuals with {effects}:"
        f" {rounded(turned.before)} times the stated noise; with the order of {names} reversed:"
        f" {rounded(turned.after)} times)."
    )


def add_turned_runs(
    section: GoodnessSection, corrected: CorrectedSection, turned: TurnedRuns
) -> GoodnessSection:
    """The section with that mistake as its first finding."""
    sentence = turned_sentence(corrected, turned)
    names = ", ".join(run for _, run in turned.runs)
    mistake = MistakeRecord(
        what=f"direction reversed: {names}",
        evidence=(
            f"residuals {turned.before:.3g} times the stated noise as given,"
            f" {turned.after:.3g} times with this undone"
        ),
    )
    return msgspec.structs.replace(
        section,
        findings=[sentence, *section.findings],
        mistakes=[mistake, *section.mistakes],
        bad_fit=True,
    )


def is_about_the_fit(finding: CheckFinding) -> bool:
    """Whether an effect of the machine may be behind a finding."""
    kinds = ("fit", *PHYSICAL_KINDS)
    return finding.severity <= Severity.BAD_FIT and finding.kind in kinds


def correct_for_effects(state: Fitted) -> Fitted:
    """Estimate the parameters together with the effects that are named or diagnosed."""
    request, gap = state.resolved.diagnosed, state.result.gap
    effects = _effects(state, request, gap)
    if not effects:
        return state
    state.progress.stage("parameters and effects together")
    effect_readings = readings_with_covariates(state, request)
    if state.with_effects:
        _refuse_untestable(state, effect_readings, effects)
    try:
        corrected = estimate_with_effects(
            effect_readings,
            effects,
            state.estimate.theta,
            stages=state.resolved.identification_stages,
            estimate_noise=state.estimates_noise,
            max_iterations=state.study.identify.max_iterations,
        )
    except IdentificationError as error:
        if state.with_effects:
            raise
        names = ", ".join(effect.name for effect in effects)
        return state.add_warnings(
            f"nothing is corrected for {names}, because with them in the model {error}"
        )
    if corrected is None:
        return state.add_warnings("no effect that was named changes these readings")
    state = state.replace(corrected=corrected)
    # the noise without what the effects explain
    setups = state.measurement.setups
    noisy = with_noise(state.goodness, corrected.estimate, setups)
    state = state.add_sections(goodness=noisy)
    return _add_section(state, corrected, gap)


def _effects(
    state: Fitted, request: GapRequest, gap: GapSection | None
) -> list[Effect]:
    """The effects of the command, or those that the diagnosis holds likely."""
    if state.with_effects:
        location = state.study.location.key("--with")
        origin = state.study.origin
        names = dict.fromkeys(state.with_effects)
        return [
            effect_with_sizes(catalogue.effect(name, origin, location), state.study)
            for name in names
        ]
    if gap is None or not gap.effect_likely:
        return []
    by_name = {effect.name: effect for effect in request.effects}
    # with the constants of the forms that the diagnosis selected
    return [
        with_constants(by_name[name], gap.constants.get(name, {}))
        for name in gap.selected
        if name in by_name
    ]


def _refuse_untestable(
    state: Fitted, effect_readings: EffectReadings, effects: Sequence[Effect]
) -> None:
    """Raises InputError for an effect that these readings cannot show."""
    states = effect_readings.problem(state.estimate.theta).states
    for effect in effects:
        reason = untestable(effect, states)
        if reason is not None:
            raise state.study.location.key("--with").error(
                f"{effect.name} cannot be estimated: {reason}",
                "record it, or name other effects",
                effect.name,
            )


def _add_section(
    state: Fitted, corrected: CorrectedEstimate, gap: GapSection | None
) -> Fitted:
    """The state with the section `corrected`: estimates, conditions, prediction."""
    study, rng = state.study, state.rng(Stream.CORRECTED)
    draws = None
    if study.posterior.enabled and (state.posterior or state.with_effects):
        draws = _sample(state, corrected, rng)
        state = state.add_warnings(*sampling_warnings(draws, study.posterior.ess))
    table = study.prediction
    kinematics = state.measurement.kinematics
    command = regular_commands(study, kinematics)
    reference = "home" if table is None else table.reference
    accuracy = None
    if len(command):
        theta = _approximate(corrected, rng) if draws is None else draws.pooled
        worth = None if draws is None else float(np.nanmin(draws.ess))
        plain = state.estimate.theta[: len(kinematics.machine.parameters)]
        accuracy = predict_corrected(
            corrected, command, reference, rng, theta, worth, plain
        )
    workspace = sections.Workspace(
        command=command,
        axes=workspace_axes(study, kinematics.machine),
        wanted=state.resolved.wanted_accuracy,
    )
    goodness = goodness_of_delivered(
        corrected.measurement,
        corrected.series,
        corrected.readings.y,
        corrected.estimate,
        state.doubtful_values,
    )
    estimate = dataclasses.replace(
        corrected.estimate, chi2=goodness.chi2, dof=goodness.dof
    )
    corrected = dataclasses.replace(corrected, estimate=estimate)
    section = sections.corrected_section(
        corrected,
        gap,
        accuracy,
        draws,
        workspace,
        origin="given" if state.with_effects else "diagnosis",
        truth=state.readings.truth,
        warnings=sections.misfit_warnings(
            goodness, noise_is_a_guess=state.noise_is_a_guess
        ),
    )
    if accuracy is not None:
        section = sections.add_least_error(section, corrected, accuracy, plain)
    turned = find_turned_runs(corrected)
    if turned is not None:
        return _mark_turned_runs(state, section, turned)
    state = state.add_sections(corrected=section)
    if gap is not None and not state.with_effects:
        joint = sections.add_joint_coefficients(gap, corrected)
        return _add_true_alarms(state.add_sections(gap=joint), section)
    state = state.add_warnings(*sections.implausible_sizes(corrected))
    return _add_true_alarms(state, section)


def _mark_turned_runs(
    state: Fitted, section: CorrectedSection, turned: TurnedRuns
) -> Fitted:
    """The state that names runs which were driven the other way than written."""
    sentence = turned_sentence(section, turned)
    goodness = add_turned_runs(state.goodness, section, turned)
    warnings = [*section.warnings, sentence]
    section = msgspec.structs.replace(section, warnings=warnings)
    state = state.add_sections(corrected=section, goodness=goodness)
    return state.replace(warnings=(sentence, *state.warnings))


def _add_true_alarms(state: Fitted, section: CorrectedSection) -> Fitted:
    """The state whose alarms hold for the corrected values, where these fit."""
    checked = state.checked
    if checked is None or not checked.bad_fit:
        return state
    if not resolves_alarm(section, checked.findings):
        return state
    goodness = resolved_section(state.goodness, section, checked.findings)
    true = resolved_sentences(section, checked.findings)
    state = state.add_sections(goodness=goodness)
    # The fit without effects is not delivered: its own section keeps its warnings.
    plain = set(state.estimate_section.warnings)
    stated = [true.get(w, w) for w in state.warnings if w not in plain]
    return state.replace(warnings=tuple(stated))


def _approximate(corrected: CorrectedEstimate, rng: np.random.Generator) -> Array:
    """Draws (m, n) of parameters and effects without a posterior."""
    return posterior.draw_approximation(
        corrected.measurement,
        corrected.series,
        corrected.readings.y,
        corrected.estimate,
        rng,
    ).theta


def _sample(
    state: Fitted, corrected: CorrectedEstimate, rng: np.random.Generator
) -> posterior.Posterior:
    state.progress.stage("posterior with the effects")
    return posterior.sample(
        corrected.measurement,
        corrected.series,
        corrected.readings.y,
        corrected.estimate,
        rng,
        **sampler_options(state.study.posterior),
        progress=state.progress.share,
    )
