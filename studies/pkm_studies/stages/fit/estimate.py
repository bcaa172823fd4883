"""The step that fits readings: noise law, effects, estimate and posterior, as the result has them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from msgspec.structs import replace

from oed import checks, posterior, units
from oed.base import Array, Mask
from oed.checks import CheckedSession, Goodness, goodness_of_delivered
from oed.corrected import EffectReadings
from oed.dataset import Dataset, ReadingsColumn, temperature_body
from oed.effects import SessionStates
from oed.estimation import (
    Estimate,
    IdentificationError,
    add_warnings,
    contradicted_parameters,
    identify,
    noise_numbers,
    predict_runs,
    tolerance_factor,
)
from oed.fit_limits import ALARM_PROBABILITY, noise_ratio
from oed.gap import GapProblem
from oed.identifiability import Assessment
from oed.instrument import Setup
from oed.linear_algebra import size_order
from oed.measurement import Measurement, Series
from oed.model import Machine
from oed.noise import reach_phrase
from oed.posterior import MIXED_RHAT, Posterior
from oed.result import (
    CombinationEstimate,
    CorrectedSection,
    EstimateSection,
    GoodnessSection,
    HeldParameter,
    Marginal,
    MixtureSection,
    NoiseRecord,
    ParameterEstimate,
    PosteriorSection,
    PredictiveCheckRecord,
    finite_or_none,
)
from oed.text import format_p_value, format_probability, rounded
from pkm_studies.base import Stream
from pkm_studies.describe import displayed_command
from pkm_studies.resolve import GapRequest, ResolvedStudy
from pkm_studies.stages.fit import run_curves
from pkm_studies.stages.gap.diagnosis import covariates_of, rms_by_channel
from pkm_studies.stages.run_state import Fitted, Measured, promote

if TYPE_CHECKING:
    import pandas as pd


# Checks recorded readings, and reports it: the section `goodness` of the result.
def check_dataset(
    resolved: ResolvedStudy, data: Dataset, rng: np.random.Generator
) -> CheckedSession:
    """What a check of recorded readings says. Raises AssemblyError."""
    session = checks.session_readings(
        resolved.measurement_with(data.setups),
        data.series,
        data.y,
        data.covariates,
        data.columns,
    )
    measurement = resolved.measurement_with(resolved.setups)
    guess = resolved.noise_is_a_guess(session.measurement, len(session.y))
    checked = checks.check_session(
        session,
        measurement,
        rng,
        noise_is_a_guess=guess,
        noise_is_estimated=resolved.study.noise.estimate is not False,
    )
    return _assumption_text(checked, is_assumed=resolved.study.noise.assumed)


def _assumption_text(checked: CheckedSession, *, is_assumed: bool) -> CheckedSession:
    """The check without what an assumed noise cannot say."""
    if not is_assumed:
        return checked
    # smaller residuals than an assumption say nothing of the readings
    findings = tuple(f for f in checked.findings if f.kind != "too_small")
    return dataclasses.replace(checked, findings=findings)


def add_delivered(state: Measured, fitted: Goodness) -> Measured:
    """The state whose check has the figures of the delivered fit, not of its own."""
    checked = state.checked
    if checked is None:
        return state.add_sections(goodness=fitted.section)
    judged = checked.with_goodness(fitted, noise_is_a_guess=state.noise_is_a_guess)
    judged = _assumption_text(judged, is_assumed=state.study.noise.assumed)
    before = {finding.sentence for finding in checked.findings}
    others = [warning for warning in state.warnings if warning not in before]
    sentences = [finding.sentence for finding in judged.findings]
    state = state.replace(checked=judged, warnings=(*sentences, *others))
    return state.add_sections(goodness=judged.section)


# Reports the estimated noise law: `noise` of the section `goodness`.
def with_noise(
    section: GoodnessSection, estimate: Estimate, setups: Mapping[str, Setup]
) -> GoodnessSection:
    """The section with the noise law of an estimate, where it has one."""
    posterior = estimate.noise_posterior
    if posterior is None:
        return section
    numbers = noise_numbers(posterior, setups)
    records = {f"{n.kind} {n.of}".rstrip(): n for n in numbers}
    assumed = posterior.prior.statement.is_assumed
    stated_as = "assumed" if assumed else "stated"
    phrase = _words(numbers, stated_as, posterior.structure.longest)
    return replace(section, noise=records, noise_words=phrase)


def _add_assumption(
    section: GoodnessSection, state: Measured, estimate: Estimate
) -> GoodnessSection:
    """The section with a finding that the noise is assumed, which nothing tests."""
    series = state.readings.series
    count = sum(map(len, series))
    amounts = []
    for name in sorted({s.setup for s in series}):
        setup = state.measurement.setups[name]
        for channel, sigma in zip(setup.instrument.channels, setup.sigma, strict=True):
            unit = units.FINE[channel.unit]
            amounts.append(f"{channel.name} {units.number(sigma, unit):.3g} {unit}")
    freedom = max(estimate.dof, 0.0)
    verdict = "which these readings cannot test"
    ratio = noise_ratio(section.chi2, section.dof)
    is_small = section.p_low is not None and section.p_low < ALARM_PROBABILITY
    if is_small and ratio is not None:
        verdict = f"and too large: the residuals are {rounded(ratio)} times it"
    sentence = (
        f"The noise of the readings ({', '.join(dict.fromkeys(amounts))}) is an"
        f" assumption, {verdict} ({count} readings, {freedom:.1f} degrees of freedom). All"
        " intervals scale with it: measure it by probing one place several times, and"
        " give it in [noise]."
    )
    return replace(section, findings=[*section.findings, sentence])


#: kinds that are standard deviations, and what they are
_ERRORS = {
    "reading": "single readings of {} scatter by",
    "run": "the readings of one run of {} share an error of",
    "seat": "what each run of {} seats anew moves by",
    "course": "through the session the readings of {} drift by",
}


def _words(numbers: Sequence[NoiseRecord], stated_as: str, longest: int) -> list[str]:
    """Departures from the stated noise, as one sentence; none where there is none.

    stated_as  stated, or assumed
    longest    number of readings of the longest run
    """
    reach = [n.value for n in numbers if n.kind == "reach"]
    phrases = []
    for number in numbers:
        if not number.departs:
            continue
        size = f"{rounded(number.value)} ± {rounded(number.sd, 1)}"
        of = f" of {number.of}" if number.of else ""
        if number.kind == "carried":
            phrases.append(
                f"a share of {size} of the variance of single readings{of} is"
                f" correlated along a run, {reach_phrase(reach[0], longest)}"
            )
            continue
        stated = (
            f" ({stated_as}: {number.stated:.3g} {number.unit})"
            if number.stated
            else ""
        )
        start = _ERRORS[number.kind].format(number.of)
        phrases.append(f"{start} {size} {number.unit}{stated}")
    if not phrases:
        return []
    return [f"The noise departs from the {stated_as} one: {'; '.join(phrases)}."]


# States in which a machine is used: as the study states them, else as recorded.

#: beginnings of the names of a machine's own bodies; a bar is none
OWN_BODIES = ("leg", "frame")
#: covariates of which every recorded value is one of use
VALUES = ("direction", "payload")


def recorded_states(covariates: pd.DataFrame | None) -> dict[str, Array]:
    """States of use that readings recorded, by covariate, SI.

    Both directions and all payloads, where several were recorded, and each body of the
    machine as cold and as warm as it was. Empty where nothing is recorded.
    """
    if covariates is None:
        return {}
    states = {}
    for name in map(str, covariates.columns):
        body = temperature_body(name)
        warms = body is not None and body.startswith(OWN_BODIES)
        if not warms and name not in VALUES:
            continue
        values = np.unique(covariates[name].dropna().to_numpy(dtype=float))
        if len(values) > 1:
            states[name] = values[[0, -1]] if warms else values
    return states


def extrapolated_states(
    used: Mapping[str, Array], covariates: pd.DataFrame
) -> list[str]:
    """Sentences on values in use, SI, that lie outside what the readings recorded."""
    sentences = []
    for name, values in used.items():
        if name not in covariates:
            continue
        ends = np.array([covariates[name].min(), covariates[name].max()])
        if not ((values < ends[0]) | (values > ends[1])).any():
            continue
        ((column, shown),) = displayed_states({name: values}).items()
        low, high = displayed_states({name: ends})[column]
        sentences.append(
            f"the prediction is for {column} {' and '.join(f'{v:g}' for v in shown)},"
            f" beyond the readings ({low:g} to {high:g}): what effects do there is"
            " extrapolated"
        )
    return sentences


def displayed_states(states: Mapping[str, Array]) -> dict[str, list[float]]:
    """States by column of the readings file, in its unit."""
    shown = {}
    for name, values in states.items():
        column = ReadingsColumn.from_covariate(name)
        if column is not None:
            shown[column.name] = [float(value) / column.factor for value in values]
    return shown


# Readings with what effects are functions of, states in which they act, what is sent.

Section = TypeVar("Section", CorrectedSection, MixtureSection)


def readings_with_covariates(state: Measured, request: GapRequest) -> EffectReadings:
    """The readings with what effects are functions of."""
    readings, measurement = state.readings, state.measurement
    covariates = covariates_of(
        measurement, readings.series, readings.covariates, request
    )
    series = tuple(readings.series)
    return EffectReadings(measurement, series, readings.y, covariates, request.gravity)


def session_states(state: Fitted) -> SessionStates:
    """States in which the readings were taken."""
    return SessionStates.of(_problem(state))


def states_in_use(state: Fitted) -> SessionStates:
    """States of [prediction], else those recorded. Raises InputError."""
    problem = _problem(state)
    resolved = state.resolved
    used = {} if resolved.prediction is None else resolved.prediction.states
    if not used:
        used = recorded_states(state.readings.covariates)
    resolved.check_states(problem.covariates)
    return SessionStates.of(problem, used)


def _problem(state: Fitted) -> GapProblem:
    request = state.resolved.gap_or_default
    return readings_with_covariates(state, request).problem(state.estimate.theta)


def add_controller(section: Section, machine: Machine, sent: Array) -> Section:
    """The section with the parameters (np,) that the controller is given, SI."""
    controller = {}
    for parameter, value in zip(machine.parameters, sent, strict=True):
        estimate = section.parameters.get(parameter.name)
        if estimate is not None:
            controller[parameter.name] = units.number(float(value), estimate.unit)
    return replace(section, controller=controller)


def estimate_section(
    measurement: Measurement,
    series: Sequence[Series],
    estimate: Estimate,
    truth: Array | None,
) -> EstimateSection:
    """Parameters in display, residuals in fine units; `truth` (n,) of a virtual machine."""
    channels = [
        channel
        for s in series
        for _ in range(len(s))
        for channel in measurement.setups[s.setup].instrument.channels
    ]
    fine = {c.name: units.FINE[c.unit] for c in channels}
    factor = np.array([units.factor(fine[c.name]) for c in channels])
    names = np.array([c.name for c in channels])
    after, before = estimate.residuals / factor, estimate.residuals_before / factor
    rounds = [
        {"rms_before": r.rms_before, "rms_after": r.rms_after} for r in estimate.stages
    ]
    parameters = {}
    for k, p in enumerate(measurement.parameters):
        if estimate.prior_sd[k] == 0.0:
            continue
        unit = units.display(p.unit)
        parameters[p.name] = ParameterEstimate(
            value=units.number(estimate.theta[k], unit),
            sd=units.number(estimate.sd[k], unit),
            unit=unit,
            nominal=units.number(p.mean, unit),
            prior_sd=units.number(estimate.prior_sd[k], unit),
            identified=_how_well(float(estimate.shrinkage[k])),
            truth=None if truth is None else units.number(truth[k], unit),
        )
    return EstimateSection(
        parameters=parameters,
        rms_before=rms_by_channel(before, names),
        rms_after=rms_by_channel(after, names),
        units=fine,
        channels=[str(n) for n in names],
        readings=len(after),
        dof=estimate.dof,
        chi2=estimate.chi2,
        iterations=rounds,
        warnings=list(estimate.warnings),
        residuals=[float(v) for v in after],
        residuals_before=[float(v) for v in before],
        covariance=displayed_covariance(
            measurement, estimate.covariance, estimate.prior_sd > 0.0
        ),
        commands=_commands(measurement, series),
    )


def _held_sentence(one: HeldParameter) -> str:
    names = " and ".join(one.parameters)
    together = " together" if len(one.parameters) > 1 else ""
    changes = [
        f"{name} by {rounded(value)} {one.units[name]}"
        for name, value in one.changes.items()
    ]
    return (
        f"{names} {'is' if not together else 'are'} held at {one.held:.5g} {one.unit},"
        f" which the readings contradict (p {format_p_value(one.p_value)}): freed{together},"
        f" {one.estimate:.5g} ± {rounded(one.sd)} {one.unit}, with changes of"
        f" {', '.join(changes)}, and of the tool by {rounded(one.tool_mm)} mm rms at the"
        " poses read"
    )


def _commands(
    measurement: Measurement, series: Sequence[Series]
) -> list[dict[str, float]]:
    """The commands that were read, each once; none where only joints are known."""
    commands = np.unique(np.vstack([s.command for s in series]), axis=0)
    finite = commands[np.isfinite(commands).all(axis=1)]
    return [displayed_command(measurement.machine, c) for c in finite]


def displayed_covariance(
    measurement: Measurement, covariance: Array, free: Mask
) -> list[list[float]]:
    """Covariance (n, n), SI, of the parameters of a mask (n,), in their display units."""
    indices = np.flatnonzero(free)
    names = [units.display(measurement.parameters[k].unit) for k in indices]
    factor = np.array([units.factor(name) for name in names])
    part = covariance[np.ix_(indices, indices)] / np.outer(factor, factor)
    rows: list[list[float]] = part.tolist()
    return rows


def _how_well(shrinkage: float) -> str:
    """How much the readings narrow a tolerance; `shrinkage` is posterior over prior."""
    if shrinkage <= Estimate.WEAK:
        return "seen"
    return "weak" if shrinkage <= Estimate.AT_PRIOR else "prior"


def combination_estimates(
    measurement: Measurement, estimate: Estimate, assessment: Assessment
) -> list[CombinationEstimate]:
    """Each combination's departure from nominal, in the unit of its pivot."""
    verdict = assessment.identifiability
    places = [measurement.names.index(name) for name in verdict.names]
    departure = (estimate.theta - measurement.nominal)[places]
    covariance = estimate.covariance[np.ix_(places, places)]
    prior_root = measurement.prior_root(estimate.prior_sd > 0.0)[places]
    terms = verdict.coefficients_by_name(verdict.combinations)
    records = []
    for named, row in zip(terms, verdict.combinations, strict=True):
        pivot = int(np.flatnonzero(np.abs(row - 1.0) < 1e-9)[0])
        unit = units.display(measurement.parameters[places[pivot]].unit)
        records.append(
            CombinationEstimate(
                terms=named,
                value=units.number(float(row @ departure), unit),
                sd=units.number(float(np.sqrt(row @ covariance @ row)), unit),
                tolerance=units.number(float(np.linalg.norm(row @ prior_root)), unit),
                unit=unit,
            )
        )
    return records


# Reports the sampled posterior: the section `posterior`.

CORNER_DRAWS = 1500  #: draws shown in the corner plot
MAX_DIRECTION_PARAMETERS = 3  #: parameters that name a direction


def posterior_section(
    measurement: Measurement, estimate: Estimate, posterior: Posterior, corner: int
) -> PosteriorSection:
    """Marginals in display units, and draws along the `corner` widest directions."""
    marginals = {}
    for k, p in enumerate(measurement.parameters):
        if estimate.prior_sd[k] == 0.0:
            continue
        unit = units.display(p.unit)
        values = units.from_si(posterior.pooled[:, k], unit)
        marginals[p.name] = marginal(values, posterior, k, unit)
    # the directions with the widest posterior, named by what they move most
    z = posterior.z.reshape(-1, posterior.z.shape[2])
    widest = np.argsort(-z.std(axis=0))[:corner]
    scale = np.where(estimate.prior_sd > 0, estimate.prior_sd, 1.0)
    directions = []
    for direction in widest:
        weight = estimate.coordinates.basis[:, direction] / scale
        largest = size_order(weight)[:MAX_DIRECTION_PARAMETERS]
        terms = [f"{weight[j]:+.2f} {measurement.names[j]}" for j in largest]
        directions.append(" ".join(terms))
    thin = max(1, len(z) // CORNER_DRAWS)
    draws = z[::thin][:CORNER_DRAWS, widest]
    return PosteriorSection(
        marginals=marginals,
        sampler=posterior.sampler,
        pareto_k=finite_or_none(posterior.pareto_k),
        proposals=posterior.proposals,
        acceptance=finite_or_none(posterior.acceptance),
        draws=len(posterior.pooled),
        walkers=posterior.walkers,
        autocorrelation=finite_or_none(posterior.autocorrelation),
        directions=directions,
        corner=draws.tolist(),
    )


#: what a predictive check compares
COMPARED = {
    "rms": "the rms residual",
    "largest": "the largest residual",
    "neighbours": "the correlation of neighbours along a run",
    "run_means": "the rms of the runs' mean residuals",
}


def contradictions(checks: Mapping[str, PredictiveCheckRecord]) -> list[str]:
    """Checks that the readings fail, as sentences."""
    return [
        f"the readings contradict the posterior: {COMPARED[name]} is"
        f" {check.observed:.2g}, predicted are {check.low:.2g} to {check.high:.2g} (in"
        " units of the stated noise)"
        for name, check in checks.items()
        if check.alarming
    ]


def sampling_warnings(posterior: Posterior, ess: int) -> list[str]:
    """What a user must know of how the posterior was sampled."""
    sentences = []
    finite = posterior.ess[np.isfinite(posterior.ess)]
    least = float(finite.min(initial=np.inf))
    if not finite.size:
        sentences.append(
            "the posterior has too few steps to tell its effective sample size; raise"
            " [posterior] steps"
        )
    if least < ess:
        key = "draws" if posterior.sampler == PosteriorSection.IMPORTANCE else "steps"
        sentences.append(
            f"the posterior has an effective sample size of {least:.0f}, short of"
            f" {ess}; raise [posterior] {key}"
        )
    unmixed = np.flatnonzero(np.nan_to_num(posterior.rhat) > MIXED_RHAT)
    if unmixed.size:
        worst = int(np.nanargmax(posterior.rhat))
        also = f", {len(unmixed)} parameters in all" if len(unmixed) > 1 else ""
        sentences.append(
            f"independent ensembles disagree: R-hat is {posterior.rhat[worst]:.3f} for"
            f" {posterior.names[worst]}{also}, wanted is {MIXED_RHAT} at most; raise"
            " [posterior] steps"
        )
    return sentences


def marginal(values: Array, posterior: Posterior, k: int, unit: str) -> Marginal:
    """Marginal of the k-th coordinate, from its pooled draws (m,) in `unit`."""
    low, high = np.quantile(values, [0.025, 0.975])
    return Marginal(
        mean=float(values.mean()),
        sd=float(values.std(ddof=1)),
        q025=float(low),
        q975=float(high),
        rhat=finite_or_none(posterior.rhat[k]),
        ess=float(posterior.ess[k]),
        unit=unit,
    )


# The step that checks recorded readings before anything is fitted to them.
def check_readings(state: Measured) -> Measured:
    """Check the recorded readings that are fitted, and set single outliers aside."""
    readings, data = state.readings, state.resolved.dataset
    if data is None:
        return state
    state.progress.stage("check of the readings")
    fitted = data.take(dict.fromkeys(s.setup for s in readings.series))
    checked = check_dataset(state.resolved, fitted, state.rng(Stream.CHECKS))
    state = state.replace(checked=checked)
    state = state.add_sections(goodness=checked.section)
    state = state.add_warnings(*[f.sentence for f in checked.findings])
    used, covariates = state.resolved.prediction, readings.covariates
    if used is not None and covariates is not None:
        state = state.add_warnings(*extrapolated_states(used.states, covariates))
    if not checked.set_aside:
        return state
    rest = checked.session.without(checked.set_aside)
    rows = readings.covariates
    if rows is not None:
        fitted_rows = np.setdiff1d(np.arange(len(rows)), checked.set_aside)
        rows = rows.iloc[fitted_rows].reset_index(drop=True)
    readings = dataclasses.replace(
        readings, series=rest.series, y=rest.y, covariates=rows
    )
    return state.replace(readings=readings)


# Steps that fit the readings: least squares, then the posterior.
def fit_parameters(state: Measured, start: Array | None = None) -> Fitted:
    """Identify the parameters from `start` (n,), SI, or nominal, with tolerance priors."""
    readings, series = state.readings, state.readings.series
    state.progress.stage("identification")
    estimate = _identify(state, start)
    larger = _enlarge_tolerances(state, estimate)
    if larger is not state:
        state = larger
        estimate = _identify(state, start)
    measurement = state.measurement
    jumps, count = measurement.mode_jumps(series, estimate.theta)
    if jumps:
        raise IdentificationError(
            f"the fit carries {jumps} of {count} poses into another (mirrored) assembly"
            " mode; check the machine's numbers, the poses and the units of the"
            " readings"
        )
    delivered = goodness_of_delivered(
        measurement, series, readings.y, estimate, state.doubtful_values
    )
    estimate = dataclasses.replace(estimate, chi2=delivered.chi2, dof=delivered.dof)
    explained = state.checked is not None and state.checked.explained_as_stated
    state = add_delivered(state, delivered)
    estimate = add_warnings(
        measurement,
        estimate,
        is_judged=state.checked is not None and state.checked.judges_residuals,
        explained_as_stated=explained,
    )
    held = []
    if readings.truth is None:
        held = contradicted_parameters(measurement, series, readings.y, estimate)
    section = estimate_section(measurement, series, estimate, readings.truth)
    combinations = section.combinations
    if state.identifiability is not None:
        verdict = state.identifiability
        combinations = combination_estimates(measurement, estimate, verdict)
    goodness = with_noise(state.goodness, estimate, measurement.setups)
    if state.study.noise.assumed and not goodness.noise:
        goodness = _add_assumption(goodness, state, estimate)
    warnings = [*map(_held_sentence, held), *section.warnings]
    runs = predict_runs(measurement, series, estimate)
    if runs is not None:
        warnings, goodness = [*warnings, *runs.warnings], runs.add_to(goodness)
    section = replace(
        section,
        held=held,
        combinations=combinations,
        runs=run_curves.fitted_curves(measurement, series, estimate),
        warnings=warnings,
    )
    fitted = promote(Fitted, state, estimate=estimate)
    fitted = fitted.add_sections(estimate=section, goodness=goodness)
    return fitted.add_warnings(*warnings)


def _identify(state: Measured, start: Array | None) -> Estimate:
    """The fit; where it fails, the error opens with what the check of readings found."""
    try:
        return identify(
            state.measurement,
            state.readings.series,
            state.readings.y,
            stages=state.resolved.identification_stages,
            estimate_noise=state.estimates_noise,
            start=start,
            max_iterations=state.study.identify.max_iterations,
        )
    except IdentificationError as error:
        raise state.explained(error) from error


def _enlarge_tolerances(state: Measured, estimate: Estimate) -> Measured:
    """The state with tolerances that the readings ask for, where stated ones are too small.

    What an earlier session knows is no tolerance of a drawing, and stays; so do the
    tolerances from which a virtual machine is drawn.
    """
    measurement = state.measurement
    expected = any(p.expected is not None for p in measurement.parameters)
    if expected or state.readings.truth is not None:
        return state
    judged = tolerance_factor(measurement, state.readings.series, estimate)
    if not judged.is_sure:
        return state
    factor = judged.factor
    warning = (
        f"the parameters are some {factor:.2g} times as far from nominal as their"
        " tolerances allow, all together (probability that these are right"
        f" {format_probability(judged.probability)}): the fit takes all tolerances {factor:.2g} times"
        " as large; correct [prior] or the nominal numbers"
    )
    larger = judged.widened(measurement)
    return state.replace(measurement=larger).add_warnings(warning)


def sample_posterior(state: Fitted) -> Fitted:
    """Sample the posterior about the estimate."""
    table = state.study.posterior
    if not table.enabled:
        return state.withhold_section("posterior", "[posterior] enabled is false")
    state.progress.stage("posterior")
    draws = posterior.sample(
        *state.fit,
        state.rng(Stream.SAMPLER),
        **table.sampler_options,
        progress=state.progress.share,
        checkpoint=state.checkpoint,
        resumed=lambda steps: state.progress.stage(
            f"posterior, resumed after {steps} steps"
        ),
    )
    corner = state.study.report.corner
    section = posterior_section(state.measurement, state.estimate, draws, corner)
    checks = posterior.predictive_checks(
        *state.fit, draws, state.rng(Stream.PREDICTIVE)
    )
    section = replace(section, checks=dict(checks))
    state = state.replace(posterior=draws).add_sections(posterior=section)
    state = state.add_warnings(*contradictions(checks))
    return state.add_warnings(*sampling_warnings(draws, table.ess))
