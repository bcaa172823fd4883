"""The steps that take readings, recorded or virtual; what a check finds before a run."""

from collections.abc import Sequence

import numpy as np

from oed.dataset import Dataset, tension_columns
from oed.measurement import Series, draw_errors, draw_parameters, draw_readings
from oed.mechanism import AssemblyError
from pkm_studies.base import Silent, Stream
from pkm_studies.resolve import ResolvedStudy
from pkm_studies.stages.run_state import (
    HeldOut,
    Measured,
    MeasuredReadings,
    Readings,
    RunState,
    Scheduled,
    promote,
    state_of,
)


# Steps that provide readings: recorded, or of a virtual machine.
def take_readings(state: RunState) -> Scheduled:
    """Take recorded readings, simulate those of a virtual machine, or only plan them."""
    data = state.resolved.dataset
    if data is not None:
        return take_recorded(state, data)
    if state.study.readings is not None:
        return take_simulated(state)
    return plan_readings(state)


def plan_readings(state: RunState) -> Scheduled:
    """Plan the readings: their poses, without values."""
    return promote(Scheduled, state, readings=Readings(series=planned_series(state)))


def take_simulated(state: RunState) -> Measured:
    """Take readings of the virtual machine at the planned poses."""
    readings = simulate_readings(state, planned_series(state))
    return promote(Measured, state, readings=readings)


def take_recorded(state: RunState, data: Dataset) -> Measured:
    """Take recorded readings, with warnings about them."""
    state = _add_setups(state, data)
    fit, held_out = state.resolved.fitted(data), None
    if state.resolved.held_out_setups:
        predict = data.take(state.resolved.held_out_setups)
        held_out = HeldOut(predict.series, predict.y, predict.covariates)
    recorded = MeasuredReadings(
        series=fit.series, y=fit.y, covariates=fit.covariates, held_out=held_out
    )
    measured = promote(Measured, state, readings=recorded)
    stiffness = state.measurement.machine.cable_stiffness or ()
    columns = tension_columns(state.measurement.machine)
    finite = [c for c, s in zip(columns, stiffness, strict=True) if np.isfinite(s)]
    absent = [c for c in finite if c not in data.columns]
    warnings = []
    if absent:  # of cables of known stiffness
        names = ", ".join(f"{stem}_N" for stem in absent)
        warnings = [
            f"the stretch of cables is not corrected: there is no column {names}"
        ]
    if data.dropped:
        warnings.append(f"{data.dropped} rows without a reading were left out")
    return measured.add_warnings(*warnings)


def _add_setups(state: RunState, data: Dataset) -> RunState:
    """The state with the set-ups of the readings, if its design lacks some.

    A design of other set-ups says nothing about the readings and is left out.
    """
    absent = [name for name in data.setups if name not in state.measurement.setups]
    if not absent:
        return state
    measurement = state.resolved.measurement_with(set(data.setups))
    state = state.replace(measurement=measurement, design=None, planned=())
    return state.add_warnings(
        f"the design has no readings of {', '.join(absent)}: it is not reported with"
        " these readings"
    )


def planned_series(state: RunState) -> tuple[Series, ...]:
    """The chosen readings, or of the plan, or a reference plan. Raises InputError."""
    if state.design is not None:
        return state.design.series
    if state.plan is not None:
        return state.plan.series
    if state.resolved.reference_plans:
        return state.resolved.reference_plans[0].series
    raise state.study.location.key("design").error(
        "the study has neither readings nor a plan",
        "add [[design.candidates]], [[design.reference]], [[plan.measurement]] or"
        " [readings]",
    )


def simulate_readings(state: RunState, series: Sequence[Series]) -> MeasuredReadings:
    """Readings of the study's virtual machine, with the effects of [gap] if any."""
    try:
        return _simulated(state, series)
    except AssemblyError as error:
        location = state.study.location.path("readings", "truth")
        raise location.error(
            f"the virtual machine cannot be assembled at {error.indices.size} of the"
            " poses",
            "give parameters nearer to nominal, or narrow the grid",
        ) from error


def _simulated(state: RunState, series: Sequence[Series]) -> MeasuredReadings:
    measurement, request = state.measurement, state.resolved.gap
    table, stated = state.study.readings, state.resolved.true_parameters
    # without stated parameters they are drawn: a nominal machine has nothing to find
    if table is None or table.draw or not stated:
        truth = draw_parameters(measurement, state.rng(Stream.TRUTH))
    else:
        truth = measurement.drawn
    for k, name in enumerate(measurement.names):
        truth[k] = stated.get(name, truth[k])
    if request is None:
        y = draw_readings(measurement, series, truth, state.rng(Stream.NOISE))
        return MeasuredReadings(series=tuple(series), y=y, truth=truth)
    from pkm_studies.stages.gap import diagnosis

    planned = diagnosis.empty_readings(measurement, series, request)
    exact, effects = diagnosis.exact_readings(
        measurement, planned, truth, request, state.rng(Stream.EFFECTS)
    )
    errors = draw_errors(
        measurement, planned.series, state.rng(Stream.NOISE), exact.shape
    )
    return MeasuredReadings(
        series=planned.series,
        y=exact + errors,
        truth=truth,
        effects=effects,
        covariates=planned.covariates,
    )


# What a run would refuse of a study before it computes anything, for `oed check`.

N_ASKED = 5  #: candidates at which an effect is asked for its coefficients
NOTHING_TO_RUN = (
    "`oed run` has neither readings nor a plan in it: add [readings], candidates or a"
    " reference plan, or give readings to `oed identify`"
)


def check_inputs(resolved: ResolvedStudy) -> list[str]:
    """Remarks on a study that is sound. Raises InputError as its run would.

    What only a search can say, such as whether a plan fits its time, is left to the run.
    """
    state = state_of(resolved, resolved.study.seed, Silent())
    if resolved.study.design is not None:
        from pkm_studies.stages.design import order, select

        select.check_design(resolved)
        order.check_reference(resolved)
    table = state.study.forecast
    if table is not None:
        from pkm_studies.stages.forecast import forecast_task, read_nodes

        task = forecast_task(state.resolved, None, state.rng(Stream.FORECAST))
        for name in filter(None, (table.readings, table.check)):
            read_nodes(task, state.study.folder / name)
    if state.study.readings is not None and state.study.readings.simulate:
        _check_virtual_machine(state)
    return [] if _has_work(resolved) else [NOTHING_TO_RUN]


def _check_virtual_machine(state: RunState) -> None:
    """Raises InputError for a virtual machine that cannot take the reference plan."""
    resolved = state.resolved
    if state.study.plan is None and not resolved.candidates:
        simulate_readings(state, planned_series(state))
        return
    some = [s.take(np.arange(min(len(s), N_ASKED))) for s in resolved.candidates[:1]]
    if some and resolved.gap is not None:
        from pkm_studies.stages.gap.diagnosis import check_coefficients

        check_coefficients(resolved.measurement, some, resolved.gap)


def _has_work(resolved: ResolvedStudy) -> bool:
    study = resolved.study
    tables = (study.readings, study.plan, study.forecast)
    planned = bool(resolved.candidates and study.design) or resolved.reference_plans
    return bool(planned) or any(table is not None for table in tables)
