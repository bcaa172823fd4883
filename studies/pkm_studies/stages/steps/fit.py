"""Steps that fit the readings: least squares, then the posterior."""

from __future__ import annotations

import dataclasses

import msgspec
import numpy as np

from oed import checks, posterior
from oed.base import Array
from oed.checks import goodness_of_delivered
from oed.estimation import (
    Estimate,
    IdentificationError,
    add_warnings,
    contradicted_parameters,
    identify,
    predict_runs,
    tolerance_factor,
)
from oed.measurement import mode_jumps
from oed.result import GoodnessSection
from oed.text import format_probability
from pkm_studies.base import Stream
from pkm_studies.stages.fit import run_curves
from pkm_studies.stages.fit.effects import extrapolated_states
from pkm_studies.stages.fit.estimate import (
    add_held,
    combination_estimates,
    estimate_section,
)
from pkm_studies.stages.fit.goodness import (
    add_delivered,
    add_left_out,
    check_dataset,
    goodness_section,
    surprises,
)
from pkm_studies.stages.fit.noise import add_assumption, with_noise
from pkm_studies.stages.fit.posterior import (
    add_checks,
    contradictions,
    posterior_section,
    sampler_options,
    sampling_warnings,
)
from pkm_studies.stages.run_state import Fitted, Measured, MeasuredReadings, promote

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
    state = state.add_sections(goodness=goodness_section(checked))
    state = state.add_warnings(*[f.sentence for f in checked.findings])
    used, covariates = state.resolved.prediction, readings.covariates
    if used is not None and covariates is not None:
        state = state.add_warnings(*extrapolated_states(used.states, covariates))
    if not checked.set_aside:
        return state
    return state.replace(readings=_drop_readings(readings, checked))


def _drop_readings(
    readings: MeasuredReadings, checked: checks.CheckedSession
) -> MeasuredReadings:
    """The readings that are not set aside, with their covariates."""
    rest = checked.session.without(checked.set_aside)
    covariates = readings.covariates
    if covariates is not None:
        used = np.setdiff1d(np.arange(len(covariates)), checked.set_aside)
        covariates = covariates.iloc[used].reset_index(drop=True)
    return dataclasses.replace(
        readings, series=rest.series, y=rest.y, covariates=covariates
    )


def fit_parameters(state: Measured, start: Array | None = None) -> Fitted:
    """Identify the parameters by least squares with tolerance priors.

    `start` (n,), SI, is where the fit begins; nominal by default.
    """
    readings, measurement = state.readings, state.measurement
    state.progress.stage("identification")
    estimate = _identify(state, start)
    larger = _enlarge_tolerances(state, estimate)
    if larger is not state:
        state = larger
        measurement = state.measurement
        estimate = _identify(state, start)
    _refuse_mode_jump(state, estimate.theta)
    fitted_as = goodness_of_delivered(
        measurement, readings.series, readings.y, estimate, state.doubtful_values
    )
    estimate = dataclasses.replace(estimate, chi2=fitted_as.chi2, dof=fitted_as.dof)
    estimate = add_warnings(measurement, estimate)
    state = add_delivered(state, fitted_as)
    fixed = []
    if readings.truth is None:
        fixed = contradicted_parameters(
            measurement, readings.series, readings.y, estimate
        )
    section = estimate_section(measurement, readings.series, estimate, readings.truth)
    section = add_held(section, fixed)
    if state.identifiability is not None:
        verdict = state.identifiability.identifiability
        combinations = combination_estimates(measurement, estimate, verdict)
        section = msgspec.structs.replace(section, combinations=combinations)
    curves = run_curves.fitted_curves(measurement, readings.series, estimate)
    section = msgspec.structs.replace(section, runs=curves)
    runs = predict_runs(measurement, readings.series, estimate)
    goodness = add_left_out(_goodness(state, estimate), runs)
    fitted = promote(Fitted, state, estimate=estimate)
    fitted = fitted.add_sections(estimate=section, goodness=goodness)
    return fitted.add_warnings(*section.warnings, *surprises(runs))


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
        raise explain_error(state, error) from error


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


def explain_error(state: Measured, error: IdentificationError) -> IdentificationError:
    """The error, opened by what the check of the readings found."""
    checked = state.checked
    if checked is None or not checked.findings:
        return error
    return IdentificationError(f"{checked.findings[0].sentence} {error}")


def _goodness(state: Measured, estimate: Estimate) -> GoodnessSection:
    """The section with the estimated noise."""
    section = with_noise(state.goodness, estimate, state.measurement.setups)
    if not state.study.noise.assumed:
        return section
    used = {s.setup for s in state.readings.series}
    setups = {name: state.measurement.setups[name] for name in sorted(used)}
    count = sum(len(s) for s in state.readings.series)
    return add_assumption(section, estimate, setups, count)


def _refuse_mode_jump(state: Measured, theta: Array) -> None:
    """Raises IdentificationError where the fit mirrors the machine."""
    jumps, count = mode_jumps(state.measurement, state.readings.series, theta)
    if jumps:
        raise IdentificationError(
            f"the fit carries {jumps} of {count} poses into another (mirrored) assembly"
            " mode; check the machine's numbers, the poses and the units of the"
            " readings"
        )


def sample_posterior(state: Fitted) -> Fitted:
    """Sample the posterior about the estimate."""
    table = state.study.posterior
    if not table.enabled:
        return state.withhold_section("posterior", "[posterior] enabled is false")
    state.progress.stage("posterior")
    draws = posterior.sample(
        state.measurement,
        state.readings.series,
        state.readings.y,
        state.estimate,
        state.rng(Stream.SAMPLER),
        **sampler_options(table),
        progress=state.progress.share,
        checkpoint=state.checkpoint,
        resumed=lambda steps: state.progress.stage(
            f"posterior, resumed after {steps} steps"
        ),
    )
    corner = state.study.report.corner
    section = posterior_section(state.measurement, state.estimate, draws, corner)
    checks = posterior.predictive_checks(
        state.measurement,
        state.readings.series,
        state.readings.y,
        state.estimate,
        draws,
        state.rng(Stream.PREDICTIVE),
    )
    section = add_checks(section, checks)
    state = state.replace(posterior=draws).add_sections(posterior=section)
    state = state.add_warnings(*contradictions(checks))
    return state.add_warnings(*sampling_warnings(draws, table.ess))
