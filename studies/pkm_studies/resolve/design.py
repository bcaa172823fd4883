"""What [design] requests: interest, wanted accuracy, retained readings, free settings."""

import dataclasses
import fnmatch
import importlib.util
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple, overload

import numpy as np

from oed import units
from oed.base import Array, Index, Mask
from oed.design import CRITERIA, QuotaSet
from oed.measurement import Measurement, Series
from oed.model import Machine
from oed.poses import Capsule, DirectionCone, ReadingLimits, Surroundings
from oed.text import suggest
from pkm_studies import quantities
from pkm_studies.base import Location
from pkm_studies.quantities import format_value
from pkm_studies.resolve import grids
from pkm_studies.resolve.grids import Circles, ReferencePlan, command_units
from pkm_studies.resolve.machine import known_name, matching_names
from pkm_studies.study import Study
from pkm_studies.tables import DesignTable, KappaTable, LimitsTable, QuotaTable

# Applies [design.limits]: which candidates can be read, and why the others cannot.

UNLIKELY = "leave the travel of the instrument on too many machines within tolerances"

Point = tuple[float, float, float]


def keep_within_limits(
    design: DesignTable, measurement: Measurement, series: Series, location: Location
) -> tuple[Series, dict[str, int]]:
    """Readings of a series within [design.limits], and the number refused, by reason.

    With `whole_runs`, one refused reading refuses its run. Raises InputError where a
    limit cannot be checked, or no reading is left.
    """
    table, location = design.limits, location.key("limits")
    if table is None:
        return series, {}
    try:
        limits = _limits(table, measurement, series.setup, location)
        verdict = limits.check(measurement, series)
        allowed, reasons = verdict.allowed.copy(), dict(verdict.refusal_counts)
        if table.travel_chance is not None:
            likely = _likely(table, limits, measurement, series, location)
            allowed &= likely
            if not likely.all():
                reasons[UNLIKELY] = int((~likely).sum())
    except ValueError as error:
        raise location.error(str(error), "mend or remove this limit") from error
    if design.whole_runs:
        broken = set(series.run[~allowed])
        allowed = np.array([run not in broken for run in series.run])
    if not allowed.any():
        counts = "; ".join(f"{count} {reason}" for reason, count in reasons.items())
        raise location.error(
            f"no candidate of {series.setup} is left: {counts}",
            "widen the limits, or move the candidates",
        )
    return series.take(np.flatnonzero(allowed)), reasons


def _likely(
    table: LimitsTable,
    limits: ReadingLimits,
    measurement: Measurement,
    series: Series,
    location: Location,
) -> Mask:
    """Held readings (n,) that stay within the travel with the wanted probability."""
    if table.travel_mm is None:
        raise location.key("travel_chance").error(
            "a chance to stay within which travel?", "give travel_mm as well"
        )
    if limits.travel is None:
        return np.ones(len(series), dtype=bool)
    covariance = measurement.prior_covariance
    chance = limits.travel_probability(measurement, series, covariance)
    return chance >= (table.travel_chance or 0.0)


def _limits(
    table: LimitsTable, measurement: Measurement, name: str, location: Location
) -> ReadingLimits:
    """The limits that apply to a set-up. Raises InputError for a cone without an axis."""
    cones: list[DirectionCone | None] = []
    for key, cone in (("cup_cone", table.cup_cone), ("tool_cone", table.tool_cone)):
        if cone is None:
            cones.append(None)
            continue
        if not any(cone.axis):
            raise location.path(key, "axis").error(
                "a cone needs an axis that is not zero",
                "give a direction, as [0, 0, 1]",
            )
        cones.append(DirectionCone(cone.axis, math.radians(cone.half_angle_deg)))
    base_cone, platform_cone = cones
    limits = ReadingLimits(
        joints=_joint_ranges(table, measurement, location.key("joints")),
        singularity=table.singularity,
        travel=_metres(table.travel_mm),
        base_cone=base_cone,
        platform_cone=platform_cone,
        surroundings=_surroundings(table, location),
    )
    return limits.for_setup(measurement.setups[name])


def _surroundings(table: LimitsTable, location: Location) -> Surroundings | None:
    """Obstacles and what moves between them; None without obstacles."""
    obstacles = []
    for sphere in table.spheres:
        centre = _metres_of(sphere.at_mm)
        obstacles.append(Capsule(centre, centre, _metres(sphere.radius_mm)))
    for rod in table.rods:
        start, end = _metres_of(rod.from_mm), _metres_of(rod.to_mm)
        obstacles.append(Capsule(start, end, _metres(rod.radius_mm)))
    if not obstacles:
        return None
    if table.links_mm is None and table.bar_mm is None:
        raise location.error(
            "obstacles are given, but nothing that moves near them",
            "give links_mm, bar_mm or both",
        )
    return Surroundings(
        obstacles=tuple(obstacles),
        links=_metres(table.links_mm),
        bar=_metres(table.bar_mm),
        margin=_metres(table.margin_mm),
        ignore=tuple(table.ignore),
    )


def _joint_ranges(
    table: LimitsTable, measurement: Measurement, location: Location
) -> dict[str, tuple[float, float]]:
    unit_of = {c.name: c.unit for c in measurement.machine.joints}
    ranges = {}
    for key, span in table.joints.items():
        name, unit = quantities.split_key(key, unit_of, location)
        low, high = units.to_si(span.from_, unit), units.to_si(span.to, unit)
        ranges[name] = float(low), float(high)
    return ranges


@overload
def _metres(mm: float) -> float: ...
@overload
def _metres(mm: float | None) -> float | None: ...
def _metres(mm: float | None) -> float | None:
    return None if mm is None else float(units.to_si(mm, "mm"))


def _metres_of(mm: Point) -> Point:
    return _metres(mm[0]), _metres(mm[1]), _metres(mm[2])


# Candidates of [design], given reference plans, and circles of [[kappa]].

#: largest share by which a reading may differ from what the instrument holds
HOLD_TOLERANCE = 0.01
NO_LENGTH = 1e-9  #: m; a shorter distance from the cup is rounding
CANNOT_HOLD = "cannot hold their reading"


def candidates(
    study: Study, measurement: Measurement
) -> tuple[tuple[Series, ...], dict[str, int], tuple[str, ...]]:
    """A series a [[design.candidates]], refusals by reason, warnings. Raises InputError."""
    if study.design is None:
        return (), {}, ()
    every: list[Series] = []
    refusals: Counter[str] = Counter()
    warnings: list[str] = []
    location = study.location.key("design")
    for i, table in enumerate(study.design.candidates):
        field = location.path("candidates", i)
        known_name(table.setup, measurement.setups, field.key("setup"))
        series, lost = grids.grid_series(table, measurement, field, strict=False)
        if lost:
            refusals[CANNOT_HOLD] += lost
            warnings.append(
                f"{field.field}: {lost} of {lost + len(series)} poses are left out,"
                f" because {table.setup} cannot hold its reading there"
            )
        count = len(series)
        series, reasons = keep_within_limits(
            study.design, measurement, series, location
        )
        for reason, number in reasons.items():
            refusals[reason] += number
            warnings.append(
                f"{field.field}: {number} of {count} candidates are left out: they"
                f" {reason}"
            )
        is_length = _is_length(measurement, series)
        if not is_length.all():
            warnings.append(
                f"{field.field}: {np.count_nonzero(~is_length)} of {len(series)} poses are"
                f" left out: {table.setup} would read 0 there, a length without direction"
            )
            series = series.take(np.flatnonzero(is_length))
        if study.design.limits is None or study.design.limits.travel_mm is None:
            warnings += _hold_warnings(measurement, series, field)
        every.append(series)
    return tuple(every), dict(refusals), tuple(warnings)


def _is_length(measurement: Measurement, series: Series) -> Mask:
    """Where (N,) an instrument of a length reads one: at 0 it has no derivatives."""
    setup = measurement.setups[series.setup]
    fixed = setup.instrument.fixed_reading
    if fixed is None or not fixed(setup.settings):
        return np.full(len(series), True)
    readings = measurement.expected_readings(series)
    return np.asarray(readings[:: len(setup.sigma)] > NO_LENGTH)


def _hold_warnings(
    measurement: Measurement, series: Series, location: Location
) -> list[str]:
    """A warning where an instrument such as a ball bar cannot hold its reading."""
    setup = measurement.setups[series.setup]
    if setup.instrument.fixed_reading is None:
        return []
    length = setup.instrument.fixed_reading(setup.settings)
    unit = setup.instrument.channels[0].unit
    expected = measurement.expected_readings(series)
    readings = expected[:: len(setup.sigma)]
    # A constraint keeps 0: the machine's size stands for the length.
    off = np.abs(readings - length) > HOLD_TOLERANCE * (
        length or measurement.machine.lever
    )
    count = int(np.count_nonzero(off))
    if not count:
        return []
    low, high = readings.min(), readings.max()
    span = f"{format_value(low, unit)} to {format_value(high, unit)}"
    return [
        f"{location.field}: at {count} of {len(readings)} poses {setup.name} would read"
        f" {span}, but it holds {format_value(length, unit)}: let one coordinate be"
        ' "hold", or give poses that keep it'
    ]


def references(study: Study, measurement: Measurement) -> tuple[ReferencePlan, ...]:
    """The plans that the study gives; tables of one name make one plan."""
    tables = study.design.reference if study.design else []
    plans: dict[str, list[Series]] = {}
    for i, table in enumerate(tables):
        location = study.location.path("design", "reference", i)
        known_name(table.setup, measurement.setups, location.key("setup"))
        series, _ = grids.grid_series(table, measurement, location, strict=True)
        plans.setdefault(table.name, []).append(series)
    return tuple(
        ReferencePlan(name=name, series=tuple(series)) for name, series in plans.items()
    )


def circles(
    study: Study,
    table: KappaTable,
    i: int,
    measurement_with: Callable[[Iterable[str]], Measurement],
    plans: Sequence[ReferencePlan] = (),
) -> Circles:
    """The circles of [[kappa]] number `i`, and of a plan with them. Raises InputError."""
    location = study.location.path("kappa", i)
    setups = [s.name for s in study.setup]
    name = known_name(table.setup, setups, location.key("setup"))
    further = _further(table, plans, location)
    measurement = measurement_with({name, *(s.setup for s in further)})
    machine = measurement.machine
    columns = [c.name for c in machine.command]
    key, across, (lower, upper) = _spacing(table, machine, location)
    around = _angle_around(table, machine, across, location)
    ends = np.tile(machine.home_command, (2, 1))
    ends[:, columns.index(across)] = lower, upper
    tool = measurement.setups[table.setup].tool
    grids.check_tool_workspace(
        measurement.kinematics, ends, {across: key}, location, tool
    )
    return Circles(
        title=table.title or f"{table.setup}: circles over {across}",
        setup=table.setup,
        circles=tuple(table.circles),
        points=tuple(table.points),
        measurement=measurement,
        across=columns.index(across),
        around=columns.index(around),
        hold=table.coordinate,
        lower=lower,
        upper=upper,
        location=location,
        further=further,
    )


def _further(
    table: KappaTable, plans: Sequence[ReferencePlan], location: Location
) -> tuple[Series, ...]:
    if table.with_ is None:
        return ()
    by_name = {plan.name: plan.series for plan in plans}
    field = location.key("with")
    return by_name[known_name(table.with_, by_name, field, "reference plan")]


def _spacing(
    table: KappaTable, machine: Machine, location: Location
) -> tuple[str, str, tuple[float, float]]:
    """Key and name of the coordinate that spaces the circles, and its range, SI."""
    if len(table.coordinates) != 1:
        first = machine.command[0]
        example = (
            f"{quantities.column(first.name, first.unit)} = {{ from = ..., to = ... }}"
        )
        raise location.error(
            "one range spaces the circles", f"give one, as in {example}"
        )
    key, span = next(iter(table.coordinates.items()))
    name, unit = quantities.split_key(key, grids.command_units(machine), location)
    ends = float(units.to_si(span.from_, unit)), float(units.to_si(span.to, unit))
    return key, name, ends


def _angle_around(
    table: KappaTable, machine: Machine, across: str, location: Location
) -> str:
    """The angle that runs round each circle: the one coordinate not used otherwise."""
    location = location.key("coordinate")
    columns = [c.name for c in machine.command]
    if table.coordinate is not None:
        known_name(table.coordinate, columns, location, "coordinate")
    others = [c for c in machine.command if c.name not in (across, table.coordinate)]
    if len(others) != 1 or others[0].unit != "rad":
        problem = (
            "besides the range and the held coordinate, one angle must be left to run"
            " round"
        )
        remedy = f"coordinates are {', '.join(columns)}"
        raise location.error(problem, remedy, table.coordinate or "")
    return others[0].name


# [[design.quota]] and [design] equal: numbers of readings from selections of candidates.
#
# A candidate is a reading, or a whole run. Candidates are in the order of
# `oed.design.candidates`: series by series, runs in order of appearance.

#: a coordinate may be outside a range by this (m, rad) and count as inside
RANGE_TOLERANCE = 1e-9
RELAX = "relax one of them, or change the number of readings"


class _Group(NamedTuple):
    """One candidate: set-up, run, and the rows of its readings among all commands."""

    setup: str
    run: str
    rows: Index


def quota_set(
    table: DesignTable,
    measurement: Measurement,
    candidates: Sequence[Series],
    location: Location,
) -> QuotaSet | None:
    """The quotas of [design] over its candidates; None without any.

    Raises InputError for a selection without candidates, for numbers that contradict
    each other, and for fields that do not go with quotas.
    """
    if not candidates or (not table.quota and table.equal is None):
        return None
    size = _checked_size(table, location)
    groups = _groups(candidates, table.whole_runs)
    quota_set = QuotaSet((), size)
    places = []
    for i, quota in enumerate(table.quota):
        field_location = location.path("quota", i)
        members = _members(quota, measurement, candidates, groups, field_location)
        least, most = _numbers(quota, size, field_location)
        name = quota.name or f"quota {i + 1}"
        quota_set = quota_set.joined(name, members, least, most)
        places.append(field_location)
    if table.equal is not None:
        field_location = location.key("equal")
        quota_set = _join_equally(quota_set, table.equal, groups, field_location)
        places += [field_location] * (len(quota_set.quotas) - len(places))
    _check_feasible(quota_set, places, location)
    return quota_set


def _groups(candidates: Sequence[Series], whole_runs: bool) -> list[_Group]:
    groups = []
    start = 0
    for series in candidates:
        if whole_runs:
            for run in dict.fromkeys(series.run):
                rows = start + np.flatnonzero(series.run == run)
                groups.append(_Group(series.setup, str(run), rows))
        else:
            for k, run in enumerate(series.run):
                row = np.array([start + k])
                groups.append(_Group(series.setup, str(run), row))
        start += len(series)
    return groups


def _checked_size(table: DesignTable, location: Location) -> int:
    """The number of readings. Raises InputError for fields that do not go with quotas."""
    field = "quota" if table.quota else "equal"
    if table.size is None or table.budget_min is not None:
        problem = f"{field} needs the number of readings, which a budget leaves open"
        remedy = "give readings instead of budget_min"
        raise location.key("budget_min").error(problem, remedy, table.budget_min)
    if table.setups_max is not None:
        problem = f"{field} does not go with a choice of set-ups"
        remedy = "remove setups_max, and give candidates of the set-ups you mount"
        raise location.key("setups_max").error(problem, remedy, table.setups_max)
    if table.how_many is not None:
        problem = f"{field} holds for one number of readings, not for a curve of them"
        raise location.key("how_many").error(problem, f"remove {field} or how_many")
    polished = table.polish is not None and table.polish.enabled
    for i, quota in enumerate(table.quota):
        if polished and quota.coordinates:
            raise location.path("quota", i).error(
                "polishing moves the poses out of the ranges of a quota",
                "leave polishing out, or select by setups and runs",
            )
    return table.size


def _numbers(
    quota: QuotaTable, size: int, location: Location
) -> tuple[int, int | None]:
    for number, share in (("min", "min_share"), ("max", "max_share")):
        stated = getattr(quota, number), getattr(quota, share)
        if None not in stated:
            raise location.key(share).error(
                f"{number} is given as well", "keep one of the two", stated[1]
            )
    least, most = quota.min, quota.max
    if quota.min_share is not None:
        least = math.ceil(quota.min_share * size - RANGE_TOLERANCE)
    if quota.max_share is not None:
        most = math.floor(quota.max_share * size + RANGE_TOLERANCE)
    if least is None and most is None:
        raise location.error(
            "how many readings?", "give min, max, min_share or max_share"
        )
    if least is not None and most is not None and least > most:
        raise location.key("min").error(
            f"more than the largest number, {most}", "lower it, or raise max", least
        )
    return least or 0, most


def _members(
    quota: QuotaTable,
    measurement: Measurement,
    candidates: Sequence[Series],
    groups: Sequence[_Group],
    location: Location,
) -> Mask:
    """Which candidates (C,) a quota selects."""
    setups = [series.setup for series in candidates]
    for i, name in enumerate(quota.setups):
        known_name(name, setups, location.path("setups", i))
    _check_runs(quota, groups, location.key("runs"))
    commands = np.vstack([series.reading_commands() for series in candidates])
    names = [c.name for c in measurement.machine.command]
    inside = np.ones(len(commands), dtype=bool)
    for key, span in quota.coordinates.items():
        coordinate, unit = quantities.split_key(
            key, command_units(measurement.machine), location
        )
        if span.from_ is None and span.to is None:
            raise location.key(key).error(
                "the range has no end", "give from, to or both"
            )
        values = commands[:, names.index(coordinate)]
        if span.from_ is not None:
            inside &= values >= float(units.to_si(span.from_, unit)) - RANGE_TOLERANCE
        if span.to is not None:
            inside &= values <= float(units.to_si(span.to, unit)) + RANGE_TOLERANCE
    members = np.zeros(len(groups), dtype=bool)
    for k, group in enumerate(groups):
        by_setup = not quota.setups or group.setup in quota.setups
        by_run = not quota.runs or any(
            fnmatch.fnmatchcase(group.run, pattern) for pattern in quota.runs
        )
        members[k] = by_setup and by_run and inside[group.rows].all()
    if not members.any():
        raise location.error(
            "no candidate is selected", "widen the selection, or remove the quota"
        )
    return members


def _check_runs(
    quota: QuotaTable, groups: Sequence[_Group], location: Location
) -> None:
    runs = list(dict.fromkeys(group.run for group in groups))
    for i, pattern in enumerate(quota.runs):
        if not fnmatch.filter(runs, pattern):
            remedy = suggest(pattern.strip("*"), runs)
            raise location.item(i).error("no run has this name", remedy, pattern)


def _join_equally(
    quota_set: QuotaSet, by: str, groups: Sequence[_Group], location: Location
) -> QuotaSet:
    labels = [group.setup for group in groups]
    if by == "run":
        labels = [f"{group.setup}, {group.run}" for group in groups]
    try:
        return quota_set.joined_equally(labels)
    except ValueError as error:
        remedy = "change readings accordingly, or give a quota for each"
        raise location.error(str(error), remedy, by) from error


def _check_feasible(
    quota_set: QuotaSet, places: Sequence[Location], location: Location
) -> None:
    """Raises InputError where the quotas contradict each other or the size."""
    conflict = quota_set.conflict()
    if conflict is None:
        return
    if not conflict:
        problem = f"there are only {quota_set.members.shape[1]} candidates"
        remedy = "choose fewer, or give more candidates"
        raise location.key("readings").error(problem, remedy, quota_set.size)
    fields = {places[k].field: k for k in conflict}
    if len(fields) == 1:
        (index,) = list(fields.values())[:1]
        raise places[index].error(
            f"with {quota_set.size} readings to choose, the candidates do not allow"
            f" {quota_set.quotas[index].sentence}",
            "change its numbers, give other candidates, or change readings",
        )
    statements = [quota_set.quotas[k].sentence for k in fields.values()]
    first = next(iter(fields.values()))
    raise places[first].error(
        f"{' and '.join(statements)} of {quota_set.size} readings contradict each other",
        RELAX,
    )


#: remedy for what needs prior tolerances
USE_PRIOR = 'write scaling = "tolerance" and prior = true'

CommandRanges = Mapping[str, Mapping[str, tuple[float, float]]]


@dataclasses.dataclass(frozen=True, kw_only=True)
class DesignRequest:
    """What [design] means to the kernel, in SI."""

    interest: tuple[str, ...]  #: names of the parameters that Ds judges
    combination: Mapping[str, float]  #: coefficients of criterion c, by parameter
    #: wanted accuracy that scales I and G, by component; the others do not count
    accuracy: Mapping[str, float]
    #: (n_dof,) least distance of two readings along each command coordinate, 0 where
    #: there is none; None: no such rule
    least_distance: Array | None
    retained: tuple[Series, ...]  #: readings that are part of the plan already
    #: what polishing may move: set-up -> setting or tool coordinate -> lowest and
    #: highest value
    free_ranges: CommandRanges
    quotas: QuotaSet | None  #: numbers of readings from selections of the candidates


def design_request(
    study: Study,
    measurement: Measurement,
    references: Sequence[ReferencePlan],
    candidates: Sequence[Series],
) -> DesignRequest | None:
    """What [design] requests of all set-ups; None without it. Raises InputError."""
    table = study.design
    if table is None:
        return None
    location = study.location.key("design")
    _check_criteria(study, table, location)
    _check_prior(table, location)
    if table.branch_nodes:
        _check_branching(table, location)
    _check_method(table, location)
    if table.how_many is not None:
        _check_needs(study, table, "I", location.key("how_many"))
    if table.polish is not None and table.polish.enabled:
        _check_polish(study, table, location.key("polish"))
    if table.keep is not None and table.keep_readings is not None:
        raise location.key("keep").error(
            "keep_readings is given as well", "keep one of the two", table.keep
        )
    return DesignRequest(
        interest=_interest(table, measurement, location.key("interest")),
        combination=_combination(table, measurement, location.key("combination")),
        accuracy=_accuracy(table, measurement, location.key("accuracy")),
        least_distance=_least_distance(table, measurement, location.key("apart")),
        retained=_retained(study, table, measurement, references, location),
        free_ranges=_free_ranges(table, measurement, location.path("polish", "free")),
        quotas=quota_set(table, measurement, candidates, location),
    )


# -- fields that need each other -------------------------------------------------------
def _check_polish(study: Study, table: DesignTable, location: Location) -> None:
    polished = CRITERIA.polished
    if table.judged_by not in polished:
        raise location.error(
            f"criterion {table.judged_by} has no gradient to polish along",
            f"take one of {', '.join(polished)}, or leave polishing out",
        )
    if study.machine.controller is not None:
        raise location.error(
            "polishing moves poses of a controller with nominal numbers",
            "leave polishing out: [machine] controller holds others",
        )


def _check_criteria(study: Study, table: DesignTable, location: Location) -> None:
    for name in table.compound:
        field_location = location.path("compound", name)
        known_name(name, CRITERIA.plan_names, field_location, "criterion")
    for i, name in enumerate(table.compare):
        field_location = location.path("compare", i)
        known_name(name, CRITERIA.plan_names, field_location, "criterion")
    if table.compound and table.criterion != "D":
        raise location.key("compound").error(
            "a criterion is given as well", "keep criterion or compound"
        )
    if table.prior and table.scaling != "tolerance":
        raise location.key("prior").error(
            "tolerances enter in their own unit", 'write scaling = "tolerance" as well'
        )
    field = "compound" if table.compound else "criterion"
    for name in table.criteria:
        _check_needs(study, table, name, location.key(field))
    for name in table.compare:
        _check_needs(study, table, name, location.key("compare"))


def _check_prior(table: DesignTable, location: Location) -> None:
    """Raises InputError for fields that make sense only with prior tolerances."""
    if table.prior:
        return
    if table.robust is not None:
        problem = "without tolerances, not all drawn machines see the same directions"
        raise location.key("robust").error(problem, USE_PRIOR)
    if table.setups_max is not None:
        problem = (
            "each set-up adds unknown parameters: without tolerances, fewer set-ups"
            " always leave fewer"
        )
        raise location.key("setups_max").error(problem, USE_PRIOR, table.setups_max)


def _check_branching(table: DesignTable, location: Location) -> None:
    """Raises InputError for fields that a tree's bound does not hold under."""
    nodes, location = table.branch_nodes, location.key("branch_nodes")
    smooth = CRITERIA.smooth
    rough = [name for name in table.criteria if name not in smooth]
    if rough:
        problem = f"branch and bound needs a smooth criterion, not {', '.join(rough)}"
        remedy = f"take one of {', '.join(smooth)}, or leave branch_nodes out"
        raise location.error(problem, remedy, nodes)
    for name, value in _given_rules(table).items():
        if value:
            problem = f"branch and bound does not know the rule {name}"
            raise location.error(problem, f"leave branch_nodes or {name} out", nodes)


def _given_rules(table: DesignTable) -> Mapping[str, bool]:
    """Rules besides the number of readings, and whether they are given."""
    return {
        "budget_min": table.budget_min is not None,
        "setups_max": table.setups_max is not None,
        "apart": bool(table.apart),
        "quota": bool(table.quota),
        "equal": table.equal is not None,
        "robust": table.robust is not None,
    }


def _check_method(table: DesignTable, location: Location) -> None:
    """Raises InputError for fields that do not go with the method."""
    if table.method == "exchange":
        if table.solver is not None:
            problem = "only weights have a solver"
            remedy = 'write method = "relaxed", or leave solver out'
            raise location.key("solver").error(problem, remedy, table.solver)
        return
    if table.solver == "scs" and importlib.util.find_spec("scs") is None:
        remedy = "pip install pkm-oed[scs], or leave solver out"
        raise location.key("solver").error("SCS is not installed", remedy, table.solver)
    field_location = location.key("method")
    weighed = CRITERIA.weighed
    if table.judged_by not in weighed:
        problem = f"weights are for {', '.join(weighed)}, not {table.judged_by}"
        remedy = f"take one of {', '.join(weighed)}, or leave method out"
        raise field_location.error(problem, remedy, table.method)
    fields = {
        **_given_rules(table),
        "branch_nodes": table.branch_nodes > 0,
        "compare": bool(table.compare),
        "how_many": table.how_many is not None,
    }
    for name, value in fields.items():
        if value:
            problem = f"weights do not go with {name}"
            raise field_location.error(
                problem, f"leave method or {name} out", table.method
            )


def _check_needs(
    study: Study, table: DesignTable, name: str, location: Location
) -> None:
    """Raises InputError where a criterion lacks its workspace, prior or combination."""
    needs = CRITERIA[name].needs
    if needs == "accuracy" and study.prediction is None:
        raise location.error(
            "accuracy over which workspace?", "add a [prediction] table", name
        )
    if needs == "accuracy" and not table.prior:
        problem = "accuracy depends on the tolerances of what no reading sees"
        raise location.error(problem, USE_PRIOR, name)
    if needs == "combination" and not table.combination:
        raise location.error(
            "which combination?", "add combination = { PARAMETER = 1.0 }", name
        )


# -- what is judged --------------------------------------------------------------------
def _interest(
    table: DesignTable, measurement: Measurement, location: Location
) -> tuple[str, ...]:
    free = measurement.free_names
    if not table.interest:
        return tuple(name for name in free if "." not in name)
    return tuple(matching_names(table.interest, free, location))


def _combination(
    table: DesignTable, measurement: Measurement, location: Location
) -> dict[str, float]:
    free = measurement.free_names
    for name in table.combination:
        known_name(name, free, location.key(name), "parameter")
    if table.combination and not any(table.combination.values()):
        raise location.error("all coefficients are 0", "give one that is not")
    return dict(table.combination)


def _accuracy(
    table: DesignTable, measurement: Measurement, location: Location
) -> dict[str, float]:
    machine = measurement.machine
    unit_of = {c.name: c.unit for c in machine.components}
    if table.accuracy:
        return quantities.read_values(table.accuracy, unit_of, location)
    angle = 1.0 / machine.lever
    return {name: 1.0 if unit == "m" else angle for name, unit in unit_of.items()}


def _least_distance(
    table: DesignTable, measurement: Measurement, location: Location
) -> Array | None:
    if not table.apart:
        return None
    machine = measurement.machine
    values = quantities.read_values(table.apart, grids.command_units(machine), location)
    return np.array([values.get(c.name, 0.0) for c in machine.command])


def _retained(
    study: Study,
    table: DesignTable,
    measurement: Measurement,
    references: Sequence[ReferencePlan],
    location: Location,
) -> tuple[Series, ...]:
    if table.keep is not None:
        plans = {plan.name: plan for plan in references}
        field_location = location.key("keep")
        return plans[
            known_name(table.keep, plans, field_location, "reference plan")
        ].series
    if table.keep_readings is None:
        return ()
    from pkm_studies import sources

    path = study.folder / table.keep_readings
    return tuple(sources.read_files([path], measurement).series)


def _free_ranges(
    table: DesignTable, measurement: Measurement, location: Location
) -> CommandRanges:
    if table.polish is None:
        return {}
    ranges: dict[str, dict[str, tuple[float, float]]] = {}
    for name, limits in table.polish.free.items():
        field_location = location.key(name)
        setup = measurement.setups[known_name(name, measurement.setups, field_location)]
        unit_of = {s.name: s.unit for s in setup.instrument.settings}
        unit_of |= dict.fromkeys(("tool_x", "tool_y", "tool_z"), "m")
        ranges[name] = {}
        for key, (low, high) in limits.items():
            moved, unit = quantities.split_key(key, unit_of, field_location)
            ends = float(units.to_si(low, unit)), float(units.to_si(high, unit))
            ranges[name][moved] = ends
    return ranges
