"""What [gap.design] requests: effects to separate, candidate runs, rules of choice."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import msgspec
import numpy as np

from oed.design.plan_limits import DistanceLimit, ReadingTimes, SetupLimit, TimeBudget
from oed.design.rules import Rules
from oed.gap.before.runs import Run
from oed.measurement.measurement import Measurement, Series
from oed.model.effect import Effect
from pkm_studies import catalogue
from pkm_studies.base import Place
from pkm_studies.resolve import candidate_runs
from pkm_studies.resolve.conditions import MINUTE
from pkm_studies.resolve.grids import ReferencePlan
from pkm_studies.study import Study
from pkm_studies.tables import PLAN, ConditionsTable, GapDesignTable


@dataclasses.dataclass(frozen=True)
class GapDesignRequest:
    """What [gap.design] means to the kernel.

    wanted    effects to separate from each other and from the rivals
    rivals    effects that are only rivals
    runs      candidate runs, each under one condition; the retained ones first
    retained  positions in `runs` of those that are part of the plan in any case
    rules     number, budget, set-ups and times; None while it waits for the plan of
              [plan], whose readings it retains
    table     [gap.design] as written
    timing    [gap.conditions] as written
    """

    wanted: tuple[Effect, ...]
    rivals: tuple[Effect, ...]
    runs: tuple[Run, ...]
    retained: tuple[int, ...]
    rules: Rules | None
    place: Place
    table: GapDesignTable
    timing: ConditionsTable

    @property
    def follows_plan(self) -> bool:
        """Whether it retains the readings of [plan], which are not known yet."""
        return self.rules is None


def gap_design_request(
    study: Study, references: Sequence[ReferencePlan], measurement: Measurement
) -> GapDesignRequest | None:
    """What [gap.design] requests; None without it. `measurement` has all set-ups.

    Raises InputError for unknown effects and plans, and for rules that allow nothing.
    """
    if study.gap is None or study.gap.design is None:
        return None
    table, place = study.gap.design, study.place.key("gap").key("design")
    timing, plans = study.gap.conditions, {plan.name: plan for plan in references}
    wanted = _effects(study, table.find, measurement, place.key("find"))
    rivals = _effects(study, table.rivals, measurement, place.key("rivals"))
    if len({e.name for e in (*wanted, *rivals)}) < 2:
        raise place.key("find").error(
            "there is nothing to tell apart", "name two effects, or rivals", table.find
        )
    follows_plan = (
        table.keep == PLAN
        and PLAN not in plans
        and study.plan is not None
        and bool(study.plan.measurement)
    )
    keep = None if follows_plan else table.keep
    runs, count = candidate_runs.candidate_runs(
        msgspec.structs.replace(table, keep=keep), plans, measurement, timing, place
    )
    rules = None
    if not follows_plan:
        rules = _rules(table, runs, count, measurement, timing, place)
    return GapDesignRequest(
        wanted=wanted,
        rivals=rivals,
        runs=runs,
        retained=tuple(range(count)),
        rules=rules,
        place=place,
        table=table,
        timing=timing,
    )


def with_planned_readings(
    request: GapDesignRequest,
    series: Sequence[Series],
    remaining: float,
    measurement: Measurement,
) -> GapDesignRequest:
    """The request with the readings of [plan] retained.

    remaining    time that the plan does not use, s: the budget where the table gives
                 neither a budget nor a number of runs

    Raises InputError where no time remains.
    """
    table, timing, place = request.table, request.timing, request.place
    if table.runs is None and table.budget_min is None:
        if remaining < 1.0:
            problem = (
                "[plan] uses all its time: none remains for runs that separate effects"
            )
            remedy = "give budget_min, which is taken from the plan's time, or runs"
            raise place.error(problem, remedy)
        table = msgspec.structs.replace(table, budget_min=remaining / MINUTE)
    retained: list[Run] = []
    for s in series:
        retained += candidate_runs.runs_of(
            s, PLAN, table.conditions[:1], measurement, timing, place
        )
    runs = (*retained, *request.runs)
    rules = _rules(table, runs, len(retained), measurement, timing, place)
    return dataclasses.replace(
        request, runs=runs, retained=tuple(range(len(retained))), rules=rules
    )


def _effects(
    study: Study, names: Sequence[str], measurement: Measurement, place: Place
) -> tuple[Effect, ...]:
    machine = measurement.machine
    effects: list[Effect] = []
    for i, name in enumerate(names):
        effect: Effect = catalogue.effect(name, study.origin, place.item(i))
        reason = effect.unfit(machine)
        if reason is not None:
            raise place.item(i).error(
                f"it cannot occur on {machine.name}: {reason}", "take another", name
            )
        effects.append(effect)
    return tuple(effects)


# -- rules -----------------------------------------------------------------------------


def _rules(
    table: GapDesignTable,
    runs: Sequence[Run],
    retained: int,
    measurement: Measurement,
    timing: ConditionsTable,
    place: Place,
) -> Rules:
    """Rules for the runs added to the first `retained`, whose set-ups are mounted."""
    _check_number(table, len(runs) - retained, place)
    timed = [run for run in runs if "time" in run.condition]
    if timed and len(timed) < len(runs):
        raise place.key("conditions").error(
            "some runs have a time and some have none", "give start_min to all or none"
        )
    cost = np.array([run.seconds for run in runs])
    time = ReadingTimes(cost)
    if table.budget_min is not None:
        time = TimeBudget(cost, table.budget_min * MINUTE)
    if timed:
        # runs at stated times must not overlap, whatever their set-up: mounting has to
        # fit into the gaps between them
        starts = np.array([[run.condition["time"]] for run in runs])
        apart = DistanceLimit(starts, float(cost.max()))
        return Rules(size=table.runs, time=time, distance=apart)
    setups = list(dict.fromkeys(run.setup for run in runs))
    owner = np.array([setups.index(run.setup) for run in runs], dtype=np.intp)
    mounting = SetupLimit(
        owner,
        _mounting_times(setups, measurement, timing),
        mounted=tuple(sorted({int(k) for k in owner[:retained]})),
    )
    return Rules(size=table.runs, time=time, setups=mounting)


def _check_number(table: GapDesignTable, candidates: int, place: Place) -> None:
    if table.runs is None and table.budget_min is None:
        raise place.error(
            "it does not say how many runs to choose", "give runs = 4, or budget_min"
        )
    if table.runs is not None and table.runs > candidates:
        raise place.key("runs").error(
            f"there are only {candidates} candidate runs",
            "choose fewer, or give more conditions",
            table.runs,
        )


def _mounting_times(
    setups: Sequence[str], measurement: Measurement, timing: ConditionsTable
) -> np.ndarray:
    """Time to mount each set-up, s."""
    if timing.setup_min is not None:
        return np.array([timing.setup_min * MINUTE for _ in setups])
    return np.array([measurement.setups[s].instrument.cost.setup for s in setups])
