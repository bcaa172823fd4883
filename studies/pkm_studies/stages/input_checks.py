"""What a run would refuse of a study before it computes anything, for `oed check`."""

from __future__ import annotations

import numpy as np

from pkm_studies.base import Silent, Stream
from pkm_studies.resolve import ResolvedStudy
from pkm_studies.stages.design import order, select
from pkm_studies.stages.gap.virtual_readings import check_coefficients
from pkm_studies.stages.run_state import RunState, state_of
from pkm_studies.stages.steps import readings

#: candidates at which an effect is asked for its coefficients
FEW = 5
NOTHING_TO_RUN = (
    "`oed run` has neither readings nor a plan in it: add [readings], candidates or a"
    " reference plan, or give readings to `oed identify`"
)


def check_inputs(resolved: ResolvedStudy) -> list[str]:
    """Remarks on a study that is sound. Raises InputError as its run would.

    What only a search can say, such as whether a plan fits its time, is left to the run.
    """
    state = state_of(resolved, resolved.study.seed, Silent())
    select.check_design(resolved)
    order.check_reference(resolved)
    _check_forecast(state)
    _check_virtual_machine(state)
    return [] if _has_work(resolved) else [NOTHING_TO_RUN]


def _check_forecast(state: RunState) -> None:
    """Raises InputError for what [forecast] misstates, and for files of its nodes."""
    table = state.study.forecast
    if table is None:
        return
    from pkm_studies.stages.forecast.files import read_nodes
    from pkm_studies.stages.forecast.task import forecast_task

    task = forecast_task(state.resolved, None, state.rng(Stream.FORECAST))
    for name in filter(None, (table.readings, table.check)):
        read_nodes(task, state.study.folder / name)


def _check_virtual_machine(state: RunState) -> None:
    """Raises InputError for a virtual machine that cannot take the reference plan."""
    table, resolved = state.study.readings, state.resolved
    if table is None or not table.simulate:
        return
    if state.study.plan is None and not resolved.candidates:
        readings.simulate_readings(state, readings.planned_series(state))
        return
    some = [s.take(np.arange(min(len(s), FEW))) for s in resolved.candidates[:1]]
    if some and resolved.gap is not None:
        check_coefficients(resolved.measurement, some, resolved.gap)


def _has_work(resolved: ResolvedStudy) -> bool:
    study = resolved.study
    tables = (study.readings, study.plan, study.forecast)
    planned = bool(resolved.candidates and study.design) or resolved.reference_plans
    return bool(planned) or any(table is not None for table in tables)
