"""Steps that fit the readings: least squares, then the posterior."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from oed.base.arrays import Array
from oed.checks.goodness import goodness_of_estimate
from oed.estimation import fit_warnings, identification, run_prediction
from oed.measurement.measurement import Series, mode_jumps
from oed.posterior import posterior, posterior_checks
from oed.result import EstimateSection, GoodnessSection
from pkm_studies.stages.fit.combinations import combination_estimates
from pkm_studies.stages.fit.estimate import estimate_section
from pkm_studies.stages.fit.left_out import surprises, with_left_out
from pkm_studies.stages.fit.noise import (
    unchecked_section,
    with_assumption,
    with_noise,
)
from pkm_studies.stages.fit.posterior import (
    contradictions,
    posterior_section,
    sampling_warnings,
    with_checks,
)
from pkm_studies.stages.run_state import RunState, Stream


def fit_parameters(state: RunState) -> RunState:
    """Identify the parameters by least squares with tolerance priors."""
    assert state.readings is not None
    series, y = state.readings.series, state.readings.y
    if y is None:
        return state
    state.progress.stage("identification")
    estimate = _identify(state, series, y)
    _refuse_mode_jump(state, estimate.theta)
    section = estimate_section(
        state.measurement, series, estimate, state.readings.truth
    )
    state = state.replace(estimate=estimate).with_sections(estimate=section)
    if state.identifiability is not None:
        verdict = state.identifiability.identifiability
        combinations = combination_estimates(state.measurement, estimate, verdict)
        section = msgspec.structs.replace(section, combinations=combinations)
        state = state.with_sections(estimate=section)
    runs = run_prediction.predict_runs(state.measurement, series, estimate)
    goodness = with_left_out(_goodness(state, estimate), runs)
    section = _without_resolved_warning(section, goodness, estimate)
    state = state.with_sections(estimate=section, goodness=goodness)
    return state.with_warnings(*section.warnings, *surprises(runs))


def _without_resolved_warning(
    section: EstimateSection,
    goodness: GoodnessSection,
    estimate: identification.Estimate,
) -> EstimateSection:
    """The section without the warning of residuals that rows in doubt explain."""
    if goodness.bad_fit or not goodness.doubtful:
        return section
    resolved = fit_warnings.large_residuals(estimate)
    warnings = [w for w in section.warnings if w not in resolved]
    return msgspec.structs.replace(section, warnings=warnings)


def _identify(
    state: RunState, series: Sequence[Series], y: Array
) -> identification.Estimate:
    """The fit; where it fails, the error opens with what the check of readings found."""
    try:
        return identification.identify(
            state.measurement,
            series,
            y,
            stages=state.resolved.identification_stages,
            estimate_noise=state.estimates_noise,
            max_iterations=state.study.identify.max_iterations,
        )
    except identification.IdentificationError as error:
        raise with_finding(state, error) from error


def with_finding(
    state: RunState, error: identification.IdentificationError
) -> identification.IdentificationError:
    """The error, opened by what the check of the readings found."""
    checked = state.checked
    if checked is None or not checked.findings:
        return error
    return identification.IdentificationError(f"{checked.findings[0].sentence} {error}")


def _goodness(state: RunState, estimate: identification.Estimate) -> GoodnessSection:
    """The check's section with the estimated noise; of the fit where there was none."""
    assert state.readings is not None
    section: GoodnessSection | None = state.sections.get("goodness")
    if section is None:
        fitted = goodness_of_estimate(
            state.measurement, state.readings.series, estimate
        )
        section = unchecked_section(fitted)
    section = with_noise(section, estimate, state.measurement.setups)
    if not state.study.noise.assumed:
        return section
    used = {s.setup for s in state.readings.series}
    setups = {name: state.measurement.setups[name] for name in sorted(used)}
    count = sum(len(s) for s in state.readings.series)
    return with_assumption(section, estimate, setups, count)


def _refuse_mode_jump(state: RunState, theta: Array) -> None:
    """Raises IdentificationError where the fit mirrors the machine."""
    assert state.readings is not None
    jumps, count = mode_jumps(state.measurement, state.readings.series, theta)
    if jumps:
        raise identification.IdentificationError(
            f"the fit carries {jumps} of {count} poses into another (mirrored) assembly"
            " mode; check the machine's numbers, the poses and the units of the"
            " readings"
        )


def sample_posterior(state: RunState) -> RunState:
    """Sample the posterior about the estimate."""
    table = state.study.posterior
    if state.estimate is None or not table.enabled:
        return state
    assert state.readings is not None
    assert state.readings.y is not None
    posterior.import_samplers()
    state.progress.stage("posterior")
    draws = posterior.sample(
        state.measurement,
        state.readings.series,
        state.readings.y,
        state.estimate,
        state.rng(Stream.SAMPLER),
        walkers=table.walkers,
        ess=float(table.ess),
        max_steps=table.steps,
        max_draws=table.draws,
        thin=table.thin,
        progress=state.progress.share,
        checkpoint=state.checkpoint,
        resumed=lambda steps: state.progress.stage(
            f"posterior, resumed after {steps} steps"
        ),
    )
    corner = state.study.report.corner
    section = posterior_section(state.measurement, state.estimate, draws, corner)
    checks = posterior_checks.predictive_checks(
        state.measurement,
        state.readings.series,
        state.readings.y,
        state.estimate,
        draws,
        state.rng(Stream.PREDICTIVE),
    )
    section = with_checks(section, checks)
    state = state.replace(posterior=draws).with_sections(posterior=section)
    state = state.with_warnings(*contradictions(checks))
    return state.with_warnings(*sampling_warnings(draws, table.ess))
