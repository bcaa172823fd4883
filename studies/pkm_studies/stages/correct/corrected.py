"""The step that corrects effects together with the geometry, and its section of the result."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from oed import posterior, units
from oed.accuracy import least_error
from oed.base import Array
from oed.checks import goodness_of_delivered
from oed.compensate import GridAxis
from oed.corrected import CorrectedAccuracy, CorrectedEstimate
from oed.effect_model import Effect
from oed.estimation import IdentificationError
from oed.fit_limits import noise_ratio
from oed.gap import untestable
from oed.measurement import Measurement
from oed.mechanism import AssemblyError
from oed.posterior import Posterior
from oed.result import (
    UNKNOWN,
    CoefficientRecord,
    CompensationName,
    CorrectedSection,
    EffectEstimate,
    EffectTable,
    GapSection,
    Marginal,
    MistakeRecord,
    PredictionSection,
)
from oed.text import join_words, rounded
from pkm_studies import describe
from pkm_studies.base import Stream
from pkm_studies.compensation import TableAccuracy
from pkm_studies.quantities import column, display_unit
from pkm_studies.resolve import GapRequest, StudyWorkspace
from pkm_studies.stages.fit.estimate import (
    add_controller,
    estimate_section,
    marginal,
    readings_with_covariates,
    sampling_warnings,
    with_noise,
)
from pkm_studies.stages.gap import sentences
from pkm_studies.stages.gap.sentences import plain_name
from pkm_studies.stages.predict.prediction import (
    accuracy_section,
    add_wanted,
    budget_section,
    spread_records,
)
from pkm_studies.stages.run_state import Fitted, Measured


# Coefficients of the joint estimate, for the diagnosis and its sentences.
def coefficient_records(corrected: CorrectedEstimate) -> Iterator[CoefficientRecord]:
    """Each coefficient, SI."""
    estimate = corrected.estimate
    k = 0
    start = corrected.parameters
    for form in corrected.forms:
        signature = form.signature
        parts = zip(signature.names, signature.labels, signature.shape, strict=True)
        for name, label, shape in parts:
            scale = float(corrected.scales[k])
            yield CoefficientRecord(
                effect=form.effect.name,
                name=name,
                label=label,
                value=float(estimate.theta[start + k]) * scale,
                sd=float(estimate.sd[start + k]) * scale,
                unit=form.effect.unit(name),
                prior_sd=scale,
                shape=bool(shape),
            )
            k += 1


def implausible_sizes(corrected: CorrectedEstimate) -> list[str]:
    """Sentences on coefficients far beyond their expected sizes."""
    checks = {form.effect.name: form.effect.check for form in corrected.forms}
    return sentences.implausible_sentences(coefficient_records(corrected), checks)


def add_joint_coefficients(gap: GapSection, corrected: CorrectedEstimate) -> GapSection:
    """The diagnosis with the coefficients that are estimated with the parameters.

    It names effects by linear models of single forms; what they amount to comes from the
    nonlinear fit of all of them, which the accuracy rests on as well.
    """
    joint = list(coefficient_records(corrected))
    effects = {c.effect for c in joint}
    others = [c for c in gap.coefficients if c.effect not in effects]
    named = [c for c in joint if c.effect in gap.selected]
    constants = {
        form.effect.name: dict(form.constants)
        for form in corrected.forms
        if form.effect.name in gap.selected
    }
    return sentences.add_sentences(
        replace(
            gap,
            coefficients=[*named, *others],
            constants={**gap.constants, **constants},
        )
    )


# Reports the tables with which a controller corrects effects: `corrected.tables`.

MAX_EFFECT_TABLE_COMMANDS = 1000  #: largest number of commands of the effects' tables


def effect_tables(
    corrected: CorrectedEstimate,
    command: Array,
    axes: tuple[GridAxis, ...],
    prediction: PredictionSection | None,
) -> tuple[list[EffectTable], Mapping[str, str]]:
    """Tables in display units over a box of commands, and why an effect has none."""
    if not len(command):
        return [], {}
    tabled = corrected.tables(command)
    if not tabled.tables:
        return [], tabled.missing
    kinematics = corrected.readings.measurement.kinematics
    machine = kinematics.machine
    want = TableAccuracy.predicted(kinematics, prediction)

    def correction(commands: Array) -> Array:
        return tabled.corrections(corrected.tables(commands))

    grid = want.grid(axes, correction, MAX_EFFECT_TABLE_COMMANDS)
    costs: list[dict[str, float]] = [{} for _ in tabled.tables]
    if grid is not None:
        command = grid.commands
        costs = [
            {
                name: units.number(float(size), units.FINE[unit])
                for name, unit, size in zip(want.names, want.units, worst, strict=True)
            }
            for worst in tabled.largest(grid.errors)
        ]
        tabled = corrected.tables(command)
    factors = [units.factor(display_unit(joint.unit)) for joint in machine.joints]
    tables = [
        EffectTable(
            effect=table.effect,
            state=table.column,
            joint_wise=table.joint_wise,
            values=table.values.tolist(),
            joints=[column(joint.name, joint.unit) for joint in machine.joints],
            commands=[describe.displayed_command(machine, c) for c in command],
            table=(table.joints / factors).tolist(),
            interpolation=cost,
        )
        for table, cost in zip(tabled.tables, costs, strict=True)
    ]
    return tables, tabled.missing


# Reports parameters and effects estimated together: the section `corrected`.

#: what a controller must know, by the covariate that an effect needs
KNOWN = {
    "direction": "the direction of travel of each joint is known",
    "feed": "the feed is known",
    "payload": "the payload is known",
    "tension": "the tension of each cable is known",
}

#: why a table of an effect is left out
NO_HELP = "parameters alone are expected to leave no larger error"
#: effects that change with the payload, where readings have several
LOADED = ("gravity", "frame_bending")


def corrected_section(
    state: Fitted,
    corrected: CorrectedEstimate,
    accuracy: CorrectedAccuracy | None,
    draws: Posterior | None,
    used: StudyWorkspace,
    warnings: Sequence[str],
) -> CorrectedSection:
    """The section, with tables of effects where it is `used`, and warnings of the fit."""
    measurement, estimate = corrected.measurement, corrected.estimate
    machine = measurement.machine
    truth = state.readings.truth
    if truth is not None:
        truth = np.concatenate([truth, np.full(len(corrected.scales), np.nan)])
    whole = estimate_section(measurement, corrected.series, estimate, truth)
    names = measurement.names[: corrected.parameters]
    parameters = {n: p for n, p in whole.parameters.items() if n in names}
    size = len(parameters)
    predicted = None
    if accuracy is not None:
        wanted = state.resolved.wanted_accuracy
        predicted = add_wanted(_predicted(measurement, accuracy), wanted)
    tables, not_tabled = effect_tables(corrected, used.regular, used.axes, predicted)
    marginals = {} if draws is None else dict(_marginals(corrected, draws))
    return CorrectedSection(
        parameters=parameters,
        effects=dict(_coefficients(corrected)),
        constants={f.effect.name: dict(f.constants) for f in corrected.forms},
        conditions=conditions(corrected, state.result.gap),
        origin="given" if state.with_effects else "diagnosis",
        rms_after=whole.rms_after,
        units=whole.units,
        readings=whole.readings,
        chi2=estimate.chi2,
        dof=estimate.dof,
        covariance=[row[:size] for row in whole.covariance[:size]],
        prediction=predicted,
        parameters_only=spread_records(machine, accuracy.parameters_only)
        if accuracy
        else {},
        posterior=marginals,
        tables=tables,
        not_tabled=dict(not_tabled),
        warnings=list(warnings),
    )


def add_least_error(
    section: CorrectedSection,
    corrected: CorrectedEstimate,
    accuracy: CorrectedAccuracy,
    plain: Array,
) -> CorrectedSection:
    """With what is sent by the draws; plain (np,), SI, of the fit without effects."""
    before, after = accuracy.compensated.before, accuracy.compensated.after
    geometry = {
        CompensationName.BEST: accuracy.parameters_only,
        CompensationName.PLAIN: accuracy.plain,
    }
    machine = corrected.measurement.machine
    every = {CompensationName.BEST_WITH_EFFECTS: after, **geometry}
    sent = least_error(before, every, machine.driven)
    section = replace(section, sent=sent)
    if least_error(before, geometry, machine.driven) == CompensationName.PLAIN:
        section = add_controller(section, machine, plain)
    return (
        section if sent == CompensationName.BEST_WITH_EFFECTS else drop_tables(section)
    )


def drop_tables(section: CorrectedSection, reason: str = NO_HELP) -> CorrectedSection:
    """The section whose effects no controller corrects, for a reason."""
    reasons = {table.effect: reason for table in section.tables}
    return replace(section, tables=[], not_tabled={**section.not_tabled, **reasons})


def _predicted(
    measurement: Measurement, accuracy: CorrectedAccuracy
) -> PredictionSection:
    compensated, budget = accuracy.compensated, accuracy.budget
    section = accuracy_section(measurement.kinematics, compensated, "corrected", budget)
    lines = budget_section(measurement.machine, compensated, budget)
    return replace(section, budget=lines)


def _coefficients(corrected: CorrectedEstimate) -> Iterator[tuple[str, EffectEstimate]]:
    records = coefficient_records(corrected)
    names, scales = corrected.coefficient_names, corrected.scales
    for name, c, scale in zip(names, records, scales, strict=True):
        unit, factor = units.coefficient_unit(c.unit)
        yield (
            name,
            EffectEstimate(
                value=c.value / factor,
                sd=c.sd / factor,
                unit=unit,
                effect=c.effect,
                prior_sd=float(scale) / factor,
                shape=c.shape,
            ),
        )


def _marginals(
    corrected: CorrectedEstimate, draws: Posterior
) -> Iterator[tuple[str, Marginal]]:
    """Posterior of every parameter that is free, and of every coefficient."""
    coefficients = dict(_coefficients(corrected))
    parameters = corrected.parameters
    for k, p in enumerate(corrected.measurement.parameters):
        if corrected.estimate.prior_sd[k] == 0.0:
            continue
        if k < parameters:
            unit = units.display(p.unit)
            values = units.from_si(draws.pooled[:, k], unit)
        else:
            coefficient = coefficients[p.name]
            unit = coefficient.unit
            values = draws.pooled[:, k] * coefficient.prior_sd
        yield p.name, marginal(values, draws, k, unit)


def conditions(corrected: CorrectedEstimate, gap: GapSection | None) -> list[str]:
    """One sentence for each condition."""
    moving = [f.effect.name for f in corrected.forms if corrected.moves_machine(f)]
    sentences = []
    if moving:
        names = join_words([plain_name(name) for name in moving])
        sentences.append(f"the controller corrects {names} as well as the parameters")
    effects_of: dict[str, list[str]] = {}
    for form in corrected.forms:
        if corrected.moves_machine(form):
            conditions = _effect_conditions(form.effect, form.signature.names)
        else:
            conditions = [
                "an effect of the measurement; the machine needs no correction"
            ]
        for condition in conditions:
            effects_of.setdefault(condition, []).append(plain_name(form.effect.name))
    sentences += [f"{join_words(e)}: {words}" for words, e in effects_of.items()]
    if gap is not None:
        sentences += _diagnosed_effects(corrected, gap)
    return list(dict.fromkeys(sentences))


def _effect_conditions(effect: Effect, coefficients: Sequence[str]) -> list[str]:
    sentences = []
    for need in effect.needs:
        covariate = need.partition(":")[0].strip()
        if covariate in KNOWN:
            sentences.append(KNOWN[covariate])
        elif "time" in need or "temp" in need:
            sentences.append(_warmth_text(coefficients))
    if not sentences and effect.name in LOADED:
        sentences.append(
            "the machine carries the payload of these readings, or a known one"
        )
    return sentences


def _warmth_text(coefficients: Sequence[str]) -> str:
    if any("per kelvin" in n for n in coefficients):
        return "the temperatures are read as in these readings"
    return (
        "no temperature was recorded, so that the correction holds for the warm-up of this"
        " session alone"
    )


def _diagnosed_effects(corrected: CorrectedEstimate, gap: GapSection) -> list[str]:
    sentences = []
    used = {form.effect.name for form in corrected.forms}
    for group in gap.confusable:
        rivals = [n for n in group if n not in used]
        if rivals and used & set(group):
            taken = plain_name(next(n for n in group if n in used))
            others = join_words([plain_name(name) for name in rivals], last="or")
            sentences.append(
                f"{taken} is the cause: these readings cannot distinguish it from"
                f" {others}"
            )
    if gap.answers and UNKNOWN in gap.answers[0].effects:
        sentences.append(
            "a part of the residual error has an unknown form and is not in the model: it stays, and the"
            " predicted accuracy does not contain it"
        )
    return sentences


# What the alarms of a bad fit become where the fit with effects is good.
#
# The check looked at a fit without effects. Where parameters and effects together fit, the
# alarm would be untrue of the values that count.
def _fit(ratio: float | None) -> str:
    if ratio is None:
        return "the readings fit"
    return f"the residuals are {ratio:.1f} times the stated noise"


# The step that estimates parameters and effects together.
def correct_for_effects(state: Fitted) -> Fitted:
    """Estimate the parameters together with the effects that are named or diagnosed."""
    request, gap = state.resolved.diagnosed, state.result.gap
    effects = _effects(state, request, gap)
    if not effects:
        return state
    state.progress.stage("parameters and effects together")
    effect_readings = readings_with_covariates(state, request)
    refusal = f"nothing is corrected for {', '.join(e.name for e in effects)}, because"
    try:
        corrected = effect_readings.estimate(
            effects,
            state.estimate.theta,
            stages=state.resolved.identification_stages,
            estimate_noise=state.estimates_noise,
            max_iterations=state.study.identify.max_iterations,
        )
    except IdentificationError as error:
        if state.with_effects:
            raise
        return state.add_warnings(f"{refusal} with them in the model {error}")
    if corrected is None:
        return state.add_warnings("no effect that was named changes these readings")
    # the noise without what the effects explain
    noisy = with_noise(state.goodness, corrected.estimate, state.measurement.setups)
    with_effects = state.replace(corrected=corrected).add_sections(goodness=noisy)
    try:
        return _add_section(with_effects, corrected, gap)
    except AssemblyError as error:
        if state.with_effects:
            raise
        return state.add_warnings(
            f"{refusal} the machine that these readings then give does not reach its"
            f" workspace: {error}"
        )


def _effects(
    state: Measured, request: GapRequest, gap: GapSection | None
) -> list[Effect]:
    """The effects of the command, or those that the diagnosis holds likely."""
    if state.with_effects:
        location = state.study.location.key("--with")
        names = dict.fromkeys(state.with_effects)
        return [state.resolved.effect_of_catalogue(name, location) for name in names]
    if gap is None or not gap.effect_likely:
        return []
    by_name = {effect.name: effect for effect in request.effects}
    # with the constants of the forms that the diagnosis selected
    return [
        by_name[name].with_constants(gap.constants.get(name, {}))
        for name in gap.selected
        if name in by_name
    ]


def refuse_untestable(state: Measured) -> Measured:
    """Raises InputError for an effect of the command that these readings cannot show."""
    if not state.with_effects:
        return state
    request = state.resolved.diagnosed
    effect_readings = readings_with_covariates(state, request)
    states = effect_readings.problem(state.measurement.nominal).states
    for effect in _effects(state, request, None):
        reason = untestable(effect, states)
        if reason is not None:
            problem = f"{effect.name} cannot be estimated: {reason}"
            remedy = "record it, or name other effects"
            raise state.study.location.key("--with").error(problem, remedy, effect.name)
    return state


def _add_section(
    state: Fitted, corrected: CorrectedEstimate, gap: GapSection | None
) -> Fitted:
    """The state with the section `corrected`: estimates, conditions, prediction."""
    study = state.study
    rng = state.rng(Stream.CORRECTED)
    series, y = corrected.series, corrected.readings.y
    fit = corrected.measurement, series, y, corrected.estimate
    draws = None
    if study.posterior.enabled and (state.posterior or state.with_effects):
        state.progress.stage("posterior with the effects")
        draws = posterior.sample(
            *fit, rng, **study.posterior.sampler_options, progress=state.progress.share
        )
        state = state.add_warnings(*sampling_warnings(draws, study.posterior.ess))
    kinematics = state.measurement.kinematics
    used = StudyWorkspace(study, kinematics)
    command, reference = used.regular, used.reference
    accuracy = None
    if len(command):
        if draws is None:
            theta, worth = posterior.draw_approximation(*fit, rng).theta, None
        else:
            theta, worth = draws.pooled, float(np.nanmin(draws.ess))
        plain = state.estimate.theta[: len(kinematics.machine.parameters)]
        accuracy = corrected.predict(command, reference, rng, theta, worth, plain)
    goodness = goodness_of_delivered(*fit, state.doubtful_values)
    estimate = dataclasses.replace(
        corrected.estimate, chi2=goodness.chi2, dof=goodness.dof
    )
    corrected = dataclasses.replace(corrected, estimate=estimate)
    warnings = []
    if goodness.is_bad(noise_is_a_guess=state.noise_is_a_guess):
        misfit = "no machine within its tolerances gives these readings"
        if goodness.ratio is not None:
            misfit = f"the residuals are {goodness.ratio:.1f} times the stated noise"
        warnings = [f"{misfit} even with the effects in the model"]
    section = corrected_section(state, corrected, accuracy, draws, used, warnings)
    if accuracy is not None:
        section = add_least_error(section, corrected, accuracy, plain)
    mistaken = _mark_turned_runs(state, section, corrected)
    if mistaken is not None:
        return mistaken
    state = state.add_sections(corrected=section)
    if gap is not None and not state.with_effects:
        joint = add_joint_coefficients(gap, corrected)
        return _add_true_alarms(state.add_sections(gap=joint), section)
    state = state.add_warnings(*implausible_sizes(corrected))
    return _add_true_alarms(state, section)


def _mark_turned_runs(
    state: Fitted, section: CorrectedSection, corrected: CorrectedEstimate
) -> Fitted | None:
    """The state whose first finding is runs driven the other way than written, if any."""
    turned = corrected.turned_runs()
    if turned is None:
        return None
    names = ", ".join(run for _, run in turned.runs)
    runs, were = ("run", "was") if len(turned.runs) == 1 else ("runs", "were")
    before, after = turned.before, turned.after  # over the stated noise
    effects = " and ".join(section.constants)
    sentence = (
        f"The readings look mistaken: {runs} {names} {were} driven the other way than the"
        f" order of the rows says, or all others were (residuals with {effects}:"
        f" {rounded(before)} times the stated noise; with the order of {names} reversed:"
        f" {rounded(after)} times)."
    )
    mistake = MistakeRecord(
        what=f"direction reversed: {names}",
        evidence=(
            f"residuals {before:.3g} times the stated noise as given,"
            f" {after:.3g} times with this undone"
        ),
    )
    goodness = replace(
        state.goodness,
        findings=[sentence, *state.goodness.findings],
        mistakes=[mistake, *state.goodness.mistakes],
        bad_fit=True,
    )
    warnings = [*section.warnings, sentence]
    section = replace(section, warnings=warnings)
    state = state.add_sections(corrected=section, goodness=goodness)
    return state.replace(warnings=(sentence, *state.warnings))


def _add_true_alarms(state: Fitted, section: CorrectedSection) -> Fitted:
    """The state whose alarms hold for the corrected values, where these fit."""
    checked = state.checked
    findings = () if checked is None else checked.findings
    if section.warnings or not all(f.may_be_an_effect for f in findings):
        return state
    true = {}
    if checked is not None and checked.bad_fit:
        ratio = noise_ratio(section.chi2, section.dof)
        effects = join_words([plain_name(name) for name in section.constants])
        opening = f"With {effects} in the model {_fit(ratio)}, and the corrected values count."
        true = {
            f.sentence: f"{opening} Without them the check says: {f.sentence}"
            for f in findings
            if f.is_about_the_fit
        }
        renamed = [true.get(finding, finding) for finding in state.goodness.findings]
        goodness = replace(state.goodness, findings=renamed, bad_fit=False)
        state = state.add_sections(goodness=goodness)
    # The fit without effects is not delivered: its own section keeps its warnings.
    plain = set(state.estimate_section.warnings)
    stated = [true.get(w, w) for w in state.warnings if w not in plain]
    return state.replace(warnings=tuple(stated))
