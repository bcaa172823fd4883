"""Effects that a study allows beside the geometry: their columns, and what was found."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from oed.base.arrays import Array
from oed.compensate.effects.effect_maps import SessionStates
from oed.compensate.effects.expected_columns import ExpectedColumns, expected_columns
from oed.compensate.effects.fit import EffectReadings
from oed.estimation import identification
from oed.estimation.estimate import Estimate
from oed.gap.data.problem import GapProblem
from oed.measurement.measurement import Measurement, Series
from oed.model.effect import Effect
from oed.result import EffectSizeRecord, EstimateSection
from pkm_studies.resolve.gap import GapRequest
from pkm_studies.stages.gap.virtual_readings import empty_readings
from pkm_studies.stages.run_state import Fitted, Measured

#: ends of a 95 % interval
INTERVAL = (0.025, 0.975)


def expected_effects(state: Measured, start: Array | None) -> ExpectedColumns | None:
    """What the effects of [identify] do to the readings; None where it allows none.

    start  (n,) where the fit begins, SI; nominal by default. Raises InputError for a
           name that is no effect of the study.
    """
    if state.study.identify.effects == "none":
        return None
    request = state.resolved.gap_or_default
    allowed = _allowed(state, request)
    fitted = identification.identify(
        state.measurement,
        state.readings.series,
        state.readings.y,
        stages=state.resolved.identification_stages,
        start=start,
        max_iterations=state.study.identify.max_iterations,
    )
    return expected_columns(_problem(state, request, fitted.theta), allowed)


def _allowed(state: Measured, request: GapRequest) -> list[Effect]:
    names = state.study.identify.effects
    if isinstance(names, str):
        return list(request.effects)
    known = {effect.name: effect for effect in request.effects}
    place = state.study.place.key("identify").key("effects")
    for k, name in enumerate(names):
        if name not in known:
            remedy = f"name some of {', '.join(known)}"
            raise place.item(k).error("no such effect is tried", remedy, name)
    return [known[name] for name in dict.fromkeys(names)]


def _problem(state: Measured, request: GapRequest, theta: Array) -> GapProblem:
    """The readings about parameters (n,)."""
    readings = state.readings
    covariates = readings.covariates
    if covariates is None:
        planned = empty_readings(state.measurement, readings.series, request)
        covariates = planned.covariates
    given = EffectReadings(
        state.measurement,
        tuple(readings.series),
        readings.y,
        covariates,
        request.gravity,
    )
    return given.problem(theta)


def session_states(state: Fitted) -> SessionStates:
    """States in which the readings were taken."""
    request = state.resolved.gap_or_default
    problem = _problem(state, request, state.estimate.theta)
    return SessionStates(
        state.measurement, problem.covariates, problem.states, request.gravity
    )


def with_effects(
    section: EstimateSection,
    estimate: Estimate,
    columns: ExpectedColumns,
    measurement: Measurement,
    series: Sequence[Series],
) -> EstimateSection:
    """The section with the effects that the fit drew, the largest change first."""
    sampled = estimate.effects
    if sampled is None:
        return section
    discrepancy = columns.discrepancy
    white = discrepancy.columns / measurement.sigma(series)[:, None]
    records = []
    for g, members in enumerate(discrepancy.members()):
        low, high = np.quantile(sampled.sizes[:, g], INTERVAL)
        change = white[:, members] @ sampled.coefficients[:, members].T
        records.append(
            EffectSizeRecord(
                name=discrepancy.names[g],
                size=float(sampled.rms_sizes[g]),
                low=float(low),
                high=float(high),
                change=float(np.sqrt((change**2).mean())),
                unknown=bool(discrepancy.unknown[g]),
            )
        )
    records.sort(key=lambda record: -record.change)
    return msgspec.structs.replace(section, effects=records, faulty=sampled.faulty)
