"""What [gap.design] asks for, as objects: effects, candidate runs under conditions,
rules.

Raises InputError, naming file and field, for effects and plans that are not there, and
for rules that allow nothing.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from oed import units
from oed.design.rules import Rules
from oed.effect import Effect
from oed.gap.before.runs import Run
from oed.measurement import Measurement, Series
from pkm_studies import catalogue
from pkm_studies.errors import Place, suggest
from pkm_studies.resolve.grids import ReferencePlan
from pkm_studies.study import Study
from pkm_studies.study.tables import ConditionsTable, GapDesignTable, RunCondition
from pkm_studies.study.tables.gap_design import PLAN

MINUTE = units.factor("min")
FEED = units.factor("mm") / units.factor("min")
#: a pass of a run, as `Series.passes` names it; only the first one forward is a
#: candidate
PASS = re.compile(r", (forward|backward) (\d+)$")


@dataclasses.dataclass(frozen=True)
class GapDesignRequest:
    """What [gap.design] asks for.

    runs    candidates, each under one condition;  kept  numbers of those taken in any
            case
    rules   number, budget, set-ups, times; None where a plan is followed that is not
            made yet
    wanted, rivals   effects
    said, timing     the table, and how readings are taken
    """

    wanted: tuple[Effect, ...]
    rivals: tuple[Effect, ...]
    runs: tuple[Run, ...]
    kept: tuple[int, ...]
    rules: Rules | None
    place: Place
    said: GapDesignTable
    timing: ConditionsTable

    @property
    def follows(self) -> bool:
        """Whether the plan of [plan] is to be kept."""
        return self.rules is None


def gap_design_request(
    study: Study, references: Sequence[ReferencePlan], measurement: Measurement
) -> GapDesignRequest | None:
    """What the study asks; None where it has no [gap.design]. `measurement` has all
    set-ups.
    """
    if study.gap is None or study.gap.design is None:
        return None
    said, place = study.gap.design, study.place.key("gap").key("design")
    wanted = _effects(study, said.find, measurement, place.key("find"))
    rivals = _effects(study, said.rivals, measurement, place.key("rivals"))
    if len({e.name for e in (*wanted, *rivals)}) < 2:
        raise place.key("find").error(
            "there is nothing to tell apart", "name two effects, or rivals", said.find
        )
    timing, plans = study.gap.conditions, {p.name: p for p in references}
    follows = (
        said.keep == PLAN
        and PLAN not in plans
        and study.plan is not None
        and bool(study.plan.measurement)
    )
    runs, kept = _runs(
        msgspec.structs.replace(said, keep=None) if follows else said,
        plans,
        measurement,
        timing,
        place,
    )
    return GapDesignRequest(
        wanted=wanted,
        rivals=rivals,
        runs=runs,
        kept=tuple(range(kept)),
        rules=None if follows else _rules(said, runs, kept, measurement, timing, place),
        place=place,
        said=said,
        timing=timing,
    )


def following(
    gap_design_request: GapDesignRequest,
    series: Sequence[Series],
    left: float,
    measurement: Measurement,
) -> GapDesignRequest:
    """With the readings of the plan kept that was to be followed.

    left: what the plan leaves of its time, s: the budget where the table has neither
    that nor a number of runs. Raises InputError.
    """
    said, kept = gap_design_request.said, []
    if said.runs is None and said.budget_min is None:
        if left < 1.0:
            problem = "the plan leaves no time to find the cause of what it leaves"
            raise gap_design_request.place.error(
                problem, "give budget_min, which is taken from the plan's time, or runs"
            )
        said = msgspec.structs.replace(said, budget_min=left / MINUTE)
    for s in series:
        kept += _of(
            s,
            PLAN,
            said.conditions[:1],
            _step(measurement, s, gap_design_request.timing),
            gap_design_request.place,
        )
    runs = (*kept, *gap_design_request.runs)
    rules = _rules(
        said,
        runs,
        len(kept),
        measurement,
        gap_design_request.timing,
        gap_design_request.place,
    )
    return dataclasses.replace(
        gap_design_request, runs=runs, kept=tuple(range(len(kept))), rules=rules
    )


def _effects(
    study: Study, names: Sequence[str], measurement: Measurement, place: Place
) -> tuple[Effect, ...]:
    found: list[Effect] = []
    for i, name in enumerate(names):
        effect: Effect = catalogue.effect(name, study.folder, place.item(i))
        reason = effect.unfit(measurement.machine)
        if reason is not None:
            raise place.item(i).error(
                f"it cannot occur on {measurement.machine.name}: {reason}",
                "take another",
                name,
            )
        found.append(effect)
    return tuple(found)


# -- candidates ------------------------------------------------------------------------


def _runs(
    said: GapDesignTable,
    plans: Mapping[str, ReferencePlan],
    measurement: Measurement,
    timing: ConditionsTable,
    place: Place,
) -> tuple[tuple[Run, ...], int]:
    """Runs of the plan kept, then every run of the named plans under every condition;
    and how many are kept.
    """
    if not plans:
        raise place.error(
            "there are no runs to choose from",
            "add [[design.reference]] plans with `runs_by`",
        )
    for i, name in enumerate(said.candidates):
        if name not in plans:
            raise (
                place.key("candidates")
                .item(i)
                .error("no such plan", suggest(name, plans), name)
            )
    if said.keep is not None and said.keep not in plans:
        raise place.key("keep").error(
            "no such plan", suggest(said.keep, plans), said.keep
        )
    if said.keep is not None and said.keep in said.candidates:
        raise place.key("keep").error(
            "a plan is kept or a candidate, not both", "remove it from one", said.keep
        )

    def taken(name: str, conditions: Sequence[RunCondition]) -> list[Run]:
        found: list[Run] = []
        for series in plans[name].series:
            step = _step(measurement, series, timing)
            found += _of(
                series, name if len(plans) > 1 else "", conditions, step, place
            )
        return found

    kept = [] if said.keep is None else taken(said.keep, said.conditions[:1])
    free = [
        r
        for n in said.candidates or plans
        if n != said.keep
        for r in taken(n, said.conditions)
    ]
    return (*kept, *free), len(kept)


def _step(measurement: Measurement, series: Series, timing: ConditionsTable) -> float:
    """Time of one reading, s."""
    return (
        measurement.setups[series.setup].instrument.cost.reading
        if timing.reading_s is None
        else timing.reading_s
    )


def _of(
    series: Series,
    plan: str,
    conditions: Sequence[RunCondition],
    step: float,
    place: Place,
) -> list[Run]:
    found = []
    for label in dict.fromkeys(str(r) for r in series.run):
        told = PASS.search(label)
        if told is not None and told.groups() != ("forward", "1"):
            continue
        rows = np.flatnonzero(series.run == label)
        poses = series.index[rows, 0]
        if series.index.shape[1] == 2 and series.index[rows[0], 1] < poses.min():
            poses = np.concatenate(
                [series.index[rows[:1], 1], poses]
            )  # the reference of a run is its first pose
        command = series.command[poses]
        if np.isnan(command).any():
            raise place.key("candidates").error(
                "runs of recorded joints cannot be planned anew", "give commands"
            )
        for condition in conditions:
            words = [w for w in (plan, PASS.sub("", label), *_words(condition)) if w]
            found.append(
                Run(
                    name=", ".join(words),
                    setup=series.setup,
                    command=command,
                    condition=_si(condition),
                    seconds=step * len(rows),
                )
            )
    return found


def _words(condition: RunCondition) -> list[str]:
    """The condition as part of a run's name."""
    told = [] if condition.payload is None else [f"{condition.payload:g} N"]
    told += (
        [] if condition.feed_mm_min is None else [f"{condition.feed_mm_min:g} mm/min"]
    )
    told += [] if condition.start_min is None else [f"at {condition.start_min:g} min"]
    return [*told, "+1" if condition.direction == 1 else "-1"]


def _si(condition: RunCondition) -> dict[str, float]:
    made = {"direction": float(condition.direction)}
    if condition.payload is not None:
        made["payload"] = condition.payload
    if condition.feed_mm_min is not None:
        made["feed"] = condition.feed_mm_min * FEED
    if condition.start_min is not None:
        made["time"] = condition.start_min * MINUTE
    return made


# -- rules -----------------------------------------------------------------------------


def _rules(
    said: GapDesignTable,
    runs: Sequence[Run],
    kept: int,
    measurement: Measurement,
    timing: ConditionsTable,
    place: Place,
) -> Rules:
    """Rules of the runs added to those `kept`, the first of `runs`, whose set-ups are
    mounted already.
    """
    if said.runs is None and said.budget_min is None:
        raise place.error(
            "it does not say how many runs to choose", "give runs = 4, or budget_min"
        )
    if said.runs is not None and said.runs > len(runs) - kept:
        problem = f"there are only {len(runs) - kept} candidate runs"
        raise place.key("runs").error(
            problem, "choose fewer, or give more conditions", said.runs
        )
    names = list(dict.fromkeys(r.setup for r in runs))
    cost = np.array([r.seconds for r in runs])
    mounting = [measurement.setups[n].instrument.cost.setup for n in names]
    mounting = [
        m if timing.setup_min is None else timing.setup_min * MINUTE for m in mounting
    ]
    budget = None if said.budget_min is None else said.budget_min * MINUTE
    timed = [r for r in runs if "time" in r.condition]
    if timed and len(timed) < len(runs):
        raise place.key("conditions").error(
            "some runs have a time and some have none", "give start_min to all or none"
        )
    # runs at stated times must not overlap, whatever their set-up: mounting is then up
    # to the gaps between them
    return Rules(
        size=said.runs,
        budget=budget,
        cost=cost,
        setup=(
            None
            if timed
            else np.array([names.index(r.setup) for r in runs], dtype=np.intp)
        ),
        setup_cost=None if timed else np.array(mounting),
        position=np.array([[r.condition["time"]] for r in runs]) if timed else None,
        min_distance=float(cost.max()) if timed else 0.0,
        mounted=(
            () if timed else tuple(sorted({names.index(r.setup) for r in runs[:kept]}))
        ),
    )
