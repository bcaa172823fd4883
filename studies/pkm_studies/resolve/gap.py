"""What [gap] requests: effects to try, effects of the virtual machine, conditions."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import operator
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from oed import dataset, design, gap, units
from oed.base import Array
from oed.effect_model import Effect
from oed.instrument import Setup
from oed.measurement import Measurement, Series
from oed.model import Machine
from oed.text import suggest
from pkm_studies import catalogue
from pkm_studies.base import InputError, Location
from pkm_studies.resolve.grids import ReferencePlan
from pkm_studies.resolve.machine import known_name
from pkm_studies.resolve.prediction import PredictionRequest
from pkm_studies.study import Study
from pkm_studies.tables import (
    ActingTable,
    ConditionsTable,
    DriveTable,
    GapDesignTable,
    GapTable,
    RunCondition,
)

if TYPE_CHECKING:
    import pandas as pd

    from oed.design import Rules
    from oed.effects import Course, PlannedEffects
    from oed.gap import GapProblem, Run

# Effects as a study states them: expected sizes ([effects], `leg_thermal_C = 1`), gears.

PER = "_per_"  #: how a quotient is written in the name of a field: `ppm_per_C`


def check_sizes(study: Study, effects: Iterable[Effect]) -> None:
    """Raises InputError for a field of [effects] that names no effect, or wrong units."""
    by_name = {e.name: e for e in effects}
    location = study.location.key("effects")
    for entry in catalogue.listing("effects"):
        if entry.name not in by_name:
            by_name[entry.name] = catalogue.effect(entry.name, study.origin, location)
    for field in study.effects:
        matching = [name for name in by_name if field.startswith(f"{name}_")]
        name = max(matching, key=len, default=None)
        field_location = location.key(field)
        if name is None:
            remedy = suggest(field, [f"{n}_{_names(e)[0]}" for n, e in by_name.items()])
            raise field_location.error("this begins with the name of no effect", remedy)
        unit = field.removeprefix(f"{name}_")
        if unit not in _factors(by_name[name]):
            names = ", ".join(f"{name}_{u}" for u in _names(by_name[name]))
            raise field_location.error(
                f"{name} is not measured in {unit}", f"write {names}"
            )


def effect_with_sizes(effect: Effect, study: Study) -> Effect:
    """The effect with the sizes that the study expects of it, and the study's drive."""
    drive = study.machine.drive
    if effect.of_drive and isinstance(drive, DriveTable):
        values = _drive_values(drive)
        if values:
            constants = {**effect.constants, effect.of_drive: values}
            effect = dataclasses.replace(effect, constants=constants)
    factors = _factors(effect)
    for field, value in study.effects.items():
        unit = field.removeprefix(f"{effect.name}_")
        if unit != field and unit in factors:
            si, factor = factors[unit]
            effect = effect.with_expected_size(si, value * factor)
    return effect


def _drive_values(drive: DriveTable) -> tuple[float, ...]:
    """Turns of each wheel a turn of the joint, or the lead of the screw, m."""
    if drive.kind == "screw":
        return () if drive.lead_mm is None else (drive.lead_mm * units.MM,)
    stages = drive.stages if drive.ratio is None else [drive.ratio]
    return tuple(itertools.accumulate([1.0, *stages], operator.mul)) if stages else ()


def _names(effect: Effect) -> list[str]:
    """Units in which reports state coefficients of an effect, as ends of fields."""
    return [_spelt(units.coefficient_unit(si)[0]) for si in effect.coefficient_units()]


def _factors(effect: Effect) -> Mapping[str, tuple[str, float]]:
    """{end of a field: (SI unit, factor to SI)} of an effect's coefficients."""
    table: dict[str, tuple[str, float]] = {}
    for si in effect.coefficient_units():
        name, factor = units.coefficient_unit(si)
        table[_spelt(name)] = (si, factor)
        for unit, (kind, to_si) in units.UNITS.items():
            if kind == si:
                table[unit] = (si, to_si)
    return table


def _spelt(unit: str) -> str:
    return unit.replace("/K", f"{PER}C").replace("/", PER)


# Effects beside the geometry that a design or plan of a study allows for.

#: values of `effects` that allow none, and all
NO_EFFECTS, ALL_EFFECTS = "none", "catalogue"
#: combinations of effects that are unknowns of candidates, at most
MAX_EFFECT_UNKNOWNS = 60
DRAWN_COURSES = 8  #: courses of a session that are drawn
SESSION_SECONDS = 7200.0  #: time that a session lasts where nothing says it, s

ALL = "all"


@dataclasses.dataclass(frozen=True)
class ActingEffect:
    """An effect of the virtual machine."""

    effect: Effect
    constants: Mapping[str, float]  #: its nonlinear constants, SI
    size: float  #: factor of all coefficients, in prior standard deviations
    draw: bool  #: whether coefficients are drawn from the prior
    #: by name, in prior standard deviations; None: the textbook's form
    coefficients: Mapping[str, float] | None
    location: Location  #: its table, for errors

    def unknown_coefficient(self, name: str, allowed: Sequence[str]) -> InputError:
        """The error for a coefficient that the effect does not have on this machine."""
        return self.location.path("coefficients", name).error(
            "the effect has no such coefficient here", suggest(name, allowed)
        )


@dataclasses.dataclass(frozen=True)
class GapRequest:
    """What [gap] means to the kernel."""

    #: effects that the diagnosis tries, with the sizes expected of them
    effects: tuple[Effect, ...]
    gravity: tuple[float, float, float]  #: direction of gravity in the base frame
    acting: tuple[ActingEffect, ...]  #: effects that the virtual machine has
    conditions: ConditionsTable  #: how the virtual machine is read

    def named_effects(
        self, names: str | Sequence[str], location: Location
    ) -> list[Effect]:
        """The effects named, or with a word all. Raises InputError for other names."""
        if isinstance(names, str):
            return list(self.effects)
        by_name = {effect.name: effect for effect in self.effects}
        for k, name in enumerate(names):
            if name not in by_name:
                remedy = f"name some of {', '.join(by_name)}"
                raise location.item(k).error("no such effect is tried", remedy, name)
        return [by_name[name] for name in dict.fromkeys(names)]

    def planned_effects(
        self,
        measurement: Measurement,
        series: Sequence[Series],
        names: str | Sequence[str],
        location: Location,
        prediction: PredictionRequest,
        rng: np.random.Generator,
        most: int = MAX_EFFECT_UNKNOWNS,
        seconds: float | None = None,
    ) -> PlannedEffects | None:
        """What effects do to planned readings and workspace; None where nothing changes.

        names  of the effects, or the word for all or none. Raises InputError as
               `named_effects`
        most   number of their combinations that are unknowns, the others scatter

        The order of the readings is not known before they are chosen: what depends on
        sense of travel, time or temperatures counts as if it were not recorded.
        """
        from oed.effects import (
            CourseColumns,
            ExpectedColumns,
            PlannedEffects,
            SessionStates,
        )

        if names == NO_EFFECTS:
            return None
        problem, courses = self.planned_courses(measurement, series, rng, seconds)
        columns = ExpectedColumns.of(problem, self.named_effects(names, location))
        if columns is None:
            return None
        session = SessionStates.of(problem)
        where, reference = prediction.command, prediction.table.reference
        over = CourseColumns.of(
            problem, courses, columns, session, where, reference, rng
        )
        return PlannedEffects.of(over, columns, session, problem.sigma, most)

    def planned_courses(
        self,
        measurement: Measurement,
        series: Sequence[Series],
        rng: np.random.Generator,
        seconds: float | None = None,
        bodies: Sequence[str] = (),
        last: int = 0,
    ) -> tuple[GapProblem, list[Course]]:
        """Planned readings in courses that a session may take; the first is the problem's.

        Temperatures of `bodies` are recorded; `last` readings repeat the first ones.
        """
        from oed.effects import Course

        parted = [s.separate_poses() for s in series]
        empty = np.full(len(measurement.setup_of_readings(parted)), np.nan)
        rows = dataset.from_series(parted, empty, measurement, None).covariates
        lasting = SESSION_SECONDS if seconds is None else seconds
        courses = Course.draw(rows, lasting, DRAWN_COURSES, rng, bodies, last)
        problem = gap.assemble(
            measurement, parted, courses[0].covariates, gravity=self.gravity
        )
        return courses[0].of(problem), courses

    def planned_covariates(
        self, measurement: Measurement, series: Sequence[Series]
    ) -> pd.DataFrame:
        """Covariates of planned readings, SI, one row a reading; unknown columns left out.

        Runs follow one another in the order given; each takes the next of several feeds
        and payloads.
        """
        import pandas as pd

        table = self.conditions
        frames: list[pd.DataFrame] = []
        clock = table.start_min * MINUTE
        number = 0
        mounted = ""
        for s in series:
            setup = measurement.setups[s.setup]
            if s.setup != mounted:
                clock += mounting_time(setup, table)
                mounted = s.setup
            protocol = setup.protocol
            # at a pose, all passes are read where their mean is the reading
            passes = len(protocol.pass_names) if protocol.average else 1
            step = reading_time(setup, table) * passes
            both_ways = protocol.both_directions and protocol.average
            frame = pd.DataFrame(
                np.full((len(s), len(COLUMNS)), np.nan), columns=COLUMNS
            )
            for run in dict.fromkeys(s.run):
                rows = np.flatnonzero(s.run == run)
                backward, repeat = _pass_of(str(run))
                way = -1.0 if backward else 1.0
                frame.loc[rows, "time"] = clock + step * np.arange(1, len(rows) + 1)
                frame.loc[rows, "direction"] = np.nan if both_ways else way
                frame.loc[rows, "feed"] = (
                    _value_of_run(table.feed_mm_min, number) * FEED_MM_PER_MIN
                )
                frame.loc[rows, "payload"] = _value_of_run(table.payload, number)
                frame.loc[rows, "repeat"] = repeat
                clock += step * len(rows) + table.pause_s
                number += 1
            frames.append(frame)
        covariates = pd.concat(frames, ignore_index=True).dropna(axis=1, how="all")
        for body, warming in table.temperature.items():
            share = -np.expm1(-covariates["time"] / (warming.after_min * MINUTE))
            covariates[f"temp_{body}"] = warming.rise * share
        return covariates

    @classmethod
    def from_study(cls, study: Study, machine: Machine) -> GapRequest:
        """What [gap] requests, or its defaults without the table. Raises InputError."""
        table = GapTable() if study.gap is None else study.gap
        location = study.location.key("gap")
        if not np.linalg.norm(table.gravity) > 0.0:
            raise location.key("gravity").error(
                "gravity has no direction", "give where it pulls: [0, 0, -1]"
            )
        acting = [
            _acting_effect(study, entry, machine, location.path("acting", i))
            for i, entry in enumerate(table.acting)
        ]
        return cls(
            effects=_tried_effects(study, table, location),
            gravity=table.gravity,
            acting=tuple(acting),
            conditions=table.conditions,
        )


def stated_request(study: Study, machine: Machine) -> GapRequest | None:
    """What [gap] requests; None without the table. Raises InputError as `GapRequest.from_study`."""
    if study.gap is None:
        check_sizes(study, ())
        return None
    return GapRequest.from_study(study, machine)


def _tried_effects(
    study: Study, table: GapTable, location: Location
) -> tuple[Effect, ...]:
    """Effects in the order named; of two with one name, the later replaces the first."""
    effects: dict[str, Effect] = {}
    named: set[str] = set()
    for i, entry in enumerate(table.effects):
        field = location.path("effects", i)
        names = [entry]
        if entry == ALL:
            names = [e.name for e in catalogue.listing("effects")]
        for name in names:
            effect = catalogue.effect(name, study.origin, field)
            effects[effect.name] = effect
            if entry != ALL:
                named.add(effect.name)
    for i, name in enumerate(table.without):
        if name not in effects:
            field = location.path("without", i)
            raise field.error("no such effect is tried", suggest(name, effects), name)
    check_sizes(study, effects.values())
    instruments = _instruments(study)
    tried = tuple(
        effect_with_sizes(e, study)
        for name, e in effects.items()
        if name not in table.without and (name in named or e.is_offered(instruments))
    )
    if not tried:
        raise location.key("effects").error(
            "no effect is left to try", 'name some, or "all"'
        )
    return tried


def _instruments(study: Study) -> list[str]:
    """Names of the instruments of the study's set-ups."""
    field = study.location.key("setup")
    return [
        catalogue.instrument(
            table.instrument, study.origin, field.path(i, "instrument")
        ).name
        for i, table in enumerate(study.setup)
    ]


def _acting_effect(
    study: Study, table: ActingTable, machine: Machine, location: Location
) -> ActingEffect:
    effect: Effect = catalogue.effect(
        table.effect, study.origin, location.key("effect")
    )
    reason = effect.unfit(machine)
    if reason is not None:
        raise location.key("effect").error(
            f"it cannot act on {machine.name}: {reason}", "take another", table.effect
        )
    for name in table.constants:
        if name not in effect.constants:
            field = location.path("constants", name)
            raise field.error("no such constant", suggest(name, effect.constants))
    # the middle value of the first constant, the first value of the others
    usual = {name: values[0] for name, values in effect.constants.items()}
    for name, values in list(effect.constants.items())[:1]:
        usual[name] = values[len(values) // 2]
    return ActingEffect(
        effect=effect_with_sizes(effect, study),
        constants=usual | table.constants,
        size=table.size,
        draw=table.draw,
        coefficients=table.coefficients or None,
        location=location,
    )


# Covariates of planned readings under [gap.conditions]: time, direction, feed, load.

#: how `Series.passes` ends the name of a run's pass
PASS_SUFFIX = re.compile(r", (forward|backward) (\d+)$")
MINUTE = units.factor("min")  #: seconds in a minute
FEED_MM_PER_MIN = units.factor("mm") / units.factor("min")  #: m/s in a mm/min
COLUMNS = ["time", "direction", "feed", "payload", "repeat"]


def reading_time(setup: Setup, table: ConditionsTable) -> float:
    """Time of one reading, s."""
    if table.reading_s is None:
        return setup.instrument.cost.reading
    return table.reading_s


def mounting_time(setup: Setup, table: ConditionsTable) -> float:
    """Time to mount a set-up, s."""
    if table.setup_min is None:
        return setup.instrument.cost.setup
    return table.setup_min * MINUTE


def _pass_of(run: str) -> tuple[bool, float]:
    """Whether a run is a pass backward, and which repeat it is."""
    match = PASS_SUFFIX.search(run)
    if match is None:
        return False, 1.0
    return match.group(1) == "backward", float(match.group(2))


def _value_of_run(stated: float | list[float] | None, number: int) -> float:
    """The value for run `number`: one for all, or those of a list in turn, or NaN."""
    if stated is None:
        return np.nan
    return stated[number % len(stated)] if isinstance(stated, list) else stated


def _commands(series: Series, rows: np.ndarray) -> Array:
    """Commands of a run; where readings are relative, its first pose is the reference."""
    poses = series.index[rows, 0]
    if series.index.shape[1] == 2 and series.index[rows[0], 1] < poses.min():
        poses = np.concatenate([series.index[rows[:1], 1], poses])
    return np.asarray(series.command[poses])


def _condition_si(condition: RunCondition) -> dict[str, float]:
    covariates = {"direction": float(condition.direction)}
    if condition.payload is not None:
        covariates["payload"] = condition.payload
    if condition.feed_mm_min is not None:
        covariates["feed"] = condition.feed_mm_min * FEED_MM_PER_MIN
    if condition.start_min is not None:
        covariates["time"] = condition.start_min * MINUTE
    return covariates


# What [gap.design] requests: effects to separate, candidate runs, rules of choice.

PLAN = "plan"  #: `keep` with this name is the plan that [plan] makes


@dataclasses.dataclass(frozen=True)
class GapDesignRequest:
    """What [gap.design] means to the kernel."""

    #: effects to separate from each other and from the rivals
    wanted: tuple[Effect, ...]
    rivals: tuple[Effect, ...]  #: effects that are only rivals
    measurement: Measurement  #: with all set-ups
    location: Location
    table: GapDesignTable  #: [gap.design] as written
    timing: ConditionsTable  #: [gap.conditions] as written
    #: whether it retains the readings of [plan], which are not known yet
    follows_plan: bool
    retained: tuple[Run, ...] = ()  #: runs that are part of the plan in any case
    candidates: tuple[Run, ...] = ()  #: further runs, each under one condition

    @property
    def runs(self) -> tuple[Run, ...]:
        """The retained runs, then the candidates."""
        return (*self.retained, *self.candidates)

    def with_runs(self, plans: Mapping[str, ReferencePlan]) -> GapDesignRequest:
        """The request with the runs of plans. Raises InputError."""
        table, location = self.table, self.location
        keep = None if self.follows_plan else table.keep
        if not plans:
            raise location.error(
                "there are no runs to choose from",
                "add [[design.reference]] plans with `runs_by`",
            )
        for i, name in enumerate(table.candidates):
            known_name(name, plans, location.path("candidates", i), "plan")
        if keep is not None:
            known_name(keep, plans, location.key("keep"), "plan")
        if keep in table.candidates:
            problem = "a plan is kept or a candidate, not both"
            raise location.key("keep").error(problem, "remove it from one", keep)

        def runs(name: str, conditions: Sequence[RunCondition]) -> list[Run]:
            prefix = name if len(plans) > 1 else ""
            return self._runs(plans[name].series, prefix, conditions)

        retained = [] if keep is None else runs(keep, table.conditions[:1])
        names = [name for name in table.candidates or plans if name != keep]
        candidates = [run for name in names for run in runs(name, table.conditions)]
        return dataclasses.replace(
            self, retained=tuple(retained), candidates=tuple(candidates)
        )

    def _runs(
        self, plan: Sequence[Series], prefix: str, conditions: Sequence[RunCondition]
    ) -> list[Run]:
        """Each run of a plan under each condition; the prefix starts their names.

        Of the passes of a run, only the first one forward is a candidate.
        """
        runs = []
        for series, label in ((s, str(r)) for s in plan for r in dict.fromkeys(s.run)):
            repeat = PASS_SUFFIX.search(label)
            if repeat is not None and repeat.groups() != ("forward", "1"):
                continue
            rows = np.flatnonzero(series.run == label)
            command = _commands(series, rows)
            if np.isnan(command).any():
                raise self.location.key("candidates").error(
                    "runs of recorded joints cannot be planned anew", "give commands"
                )
            setup = self.measurement.setups[series.setup]
            seconds = reading_time(setup, self.timing)
            for condition in conditions:
                phrases = []
                if condition.payload is not None:
                    phrases.append(f"{condition.payload:g} N")
                if condition.feed_mm_min is not None:
                    phrases.append(f"{condition.feed_mm_min:g} mm/min")
                if condition.start_min is not None:
                    phrases.append(f"at {condition.start_min:g} min")
                words = [*phrases, "+1" if condition.direction == 1 else "-1"]
                parts = [prefix, PASS_SUFFIX.sub("", label), *words]
                run = gap.Run(
                    name=", ".join(part for part in parts if part),
                    setup=series.setup,
                    command=command,
                    condition=_condition_si(condition),
                    seconds=seconds * len(rows),
                )
                runs.append(run)
        return runs

    @functools.cached_property
    def rules(self) -> Rules:
        """For the runs added to the retained ones, whose set-ups are mounted.

        Raises InputError for rules that fail.
        """
        table, timing, runs = self.table, self.timing, self.runs
        _check_number(table, len(self.candidates), self.location)
        timed = [run for run in runs if "time" in run.condition]
        if timed and len(timed) < len(runs):
            raise self.location.key("conditions").error(
                "some runs have a time and some have none",
                "give start_min to all or none",
            )
        cost = np.array([run.seconds for run in runs])
        budget = None if table.budget_min is None else table.budget_min * MINUTE
        if timed:
            # runs at stated times must not overlap, whatever their set-up: mounting has to
            # fit into the gaps between them
            return design.Rules.build(
                size=table.runs,
                seconds=cost,
                budget=budget,
                position=np.array([[run.condition["time"]] for run in runs]),
                least_distance=float(cost.max()),
            )
        setups = list(dict.fromkeys(run.setup for run in runs))
        owner = np.array([setups.index(run.setup) for run in runs], dtype=np.intp)
        mounting = [mounting_time(self.measurement.setups[s], timing) for s in setups]
        return design.Rules.build(
            size=table.runs,
            seconds=cost,
            budget=budget,
            setup=owner,
            mounting=np.array(mounting),
            mounted=tuple(sorted({int(k) for k in owner[: len(self.retained)]})),
        )

    def with_plan(self, series: Sequence[Series], remaining: float) -> GapDesignRequest:
        """The request with the readings of [plan] retained.

        remaining    time that the plan does not use, s: the budget where the table gives
                     neither a budget nor a number of runs

        Raises InputError where no time remains.
        """
        table = self.table
        if table.runs is None and table.budget_min is None:
            if remaining < 1.0:
                problem = "[plan] uses all its time: none remains for runs that separate effects"
                remedy = "give budget_min, which is taken from the plan's time, or runs"
                raise self.location.error(problem, remedy)
            table = replace(table, budget_min=remaining / MINUTE)
        retained = tuple(self._runs(series, PLAN, table.conditions[:1]))
        return dataclasses.replace(
            self, table=table, follows_plan=False, retained=retained
        )


def gap_design_request(
    study: Study, references: Sequence[ReferencePlan], measurement: Measurement
) -> GapDesignRequest | None:
    """What [gap.design] requests of all set-ups; None without it. Raises InputError."""
    if study.gap is None or study.gap.design is None:
        return None
    table = study.gap.design
    location = study.location.path("gap", "design")
    timing = study.gap.conditions
    plans = {plan.name: plan for plan in references}
    wanted = _effects(study, table.find, measurement, location.key("find"))
    rivals = _effects(study, table.rivals, measurement, location.key("rivals"))
    if len({e.name for e in (*wanted, *rivals)}) < 2:
        raise location.key("find").error(
            "there is nothing to tell apart", "name two effects, or rivals", table.find
        )
    follows_plan = (
        table.keep == PLAN
        and PLAN not in plans
        and study.plan is not None
        and bool(study.plan.measurement)
    )
    request = GapDesignRequest(
        wanted, rivals, measurement, location, table, timing, follows_plan
    ).with_runs(plans)
    if not follows_plan:
        request.rules  # noqa: B018 - raises for rules that fail
    return request


def _effects(
    study: Study, names: Sequence[str], measurement: Measurement, location: Location
) -> tuple[Effect, ...]:
    machine = measurement.machine
    effects: list[Effect] = []
    for i, name in enumerate(names):
        effect: Effect = catalogue.effect(name, study.origin, location.item(i))
        reason = effect.unfit(machine)
        if reason is not None:
            raise location.item(i).error(
                f"it cannot occur on {machine.name}: {reason}", "take another", name
            )
        effects.append(effect)
    return tuple(effects)


def _check_number(table: GapDesignTable, candidates: int, location: Location) -> None:
    if table.runs is None and table.budget_min is None:
        raise location.error(
            "it does not say how many runs to choose", "give runs = 4, or budget_min"
        )
    if table.runs is not None and table.runs > candidates:
        problem = f"there are only {candidates} candidate runs"
        remedy = "choose fewer, or give more conditions"
        raise location.key("runs").error(problem, remedy, table.runs)
