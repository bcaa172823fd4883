"""Candidates of [design], given reference plans, and circles of [[kappa]]."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from oed import units
from oed.base import Array, Mask
from oed.measurement import Measurement, Series
from oed.model import Machine
from oed.poses import (
    Capsule,
    DirectionCone,
    ReadingLimits,
    Surroundings,
    check_readings,
    cup_position,
    travel_probability,
)
from pkm_studies import quantities
from pkm_studies.base import Location
from pkm_studies.quantities import format_value
from pkm_studies.resolve import command_ranges, grids, lookup
from pkm_studies.resolve.grids import Circles, ReferencePlan
from pkm_studies.study import Study
from pkm_studies.tables import ConeTable, DesignTable, KappaTable, LimitsTable

# Applies [design.limits]: which candidates can be read, and why the others cannot.

UNLIKELY = "leave the travel of the instrument on too many machines within tolerances"

Point = tuple[float, float, float]


def keep_within_limits(
    table: LimitsTable,
    measurement: Measurement,
    series: Series,
    location: Location,
    *,
    whole_runs: bool,
) -> tuple[Series, dict[str, int]]:
    """Readings of a series within the limits, and the number refused, by reason.

    With `whole_runs`, one refused reading refuses its run. Raises InputError where a
    limit cannot be checked, or no reading is left.
    """
    try:
        limits = _limits(table, measurement, series.setup, location)
        verdict = check_readings(measurement, series, limits)
        allowed, reasons = verdict.allowed.copy(), dict(verdict.refusal_counts)
        if table.travel_chance is not None:
            likely = _likely(table, measurement, series, location)
            allowed &= likely
            if not likely.all():
                reasons[UNLIKELY] = int((~likely).sum())
    except ValueError as error:
        raise location.error(str(error), "mend or remove this limit") from error
    if whole_runs:
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
    table: LimitsTable, measurement: Measurement, series: Series, location: Location
) -> Mask:
    """Held readings (n,) that stay within the travel with the wanted probability."""
    if table.travel_mm is None:
        raise location.key("travel_chance").error(
            "a chance to stay within which travel?", "give travel_mm as well"
        )
    if measurement.setups[series.setup].instrument.fixed_reading is None:
        return np.ones(len(series), dtype=bool)
    covariance = measurement.prior_covariance
    travel = _metres(table.travel_mm)
    chance = travel_probability(measurement, series, covariance, travel)
    return chance >= (table.travel_chance or 0.0)


def _limits(
    table: LimitsTable, measurement: Measurement, name: str, location: Location
) -> ReadingLimits:
    """The limits that apply to a set-up."""
    setup = measurement.setups[name]
    has_cup = setup.teach is not None or {"at_x", "at_y", "at_z"} <= {*setup.settings}
    cup_cone, tool_cone, cup = None, None, None
    if has_cup:
        cup_cone = _cone(table.cup_cone, location.key("cup_cone"))
        tool_cone = _cone(table.tool_cone, location.key("tool_cone"))
        cup = _point(cup_position(measurement, name))
    travel = None
    if table.travel_mm is not None and setup.instrument.fixed_reading is not None:
        travel = _metres(table.travel_mm)
    return ReadingLimits(
        joints=_joint_ranges(table, measurement, location.key("joints")),
        singularity=table.singularity,
        travel=travel,
        base_cone=cup_cone,
        platform_cone=tool_cone,
        cup=cup,
        surroundings=_surroundings(table, has_cup, location),
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


def _cone(table: ConeTable | None, location: Location) -> DirectionCone | None:
    if table is None:
        return None
    if not any(table.axis):
        raise location.key("axis").error(
            "a cone needs an axis that is not zero", "give a direction, as [0, 0, 1]"
        )
    return DirectionCone(table.axis, math.radians(table.half_angle_deg))


def _surroundings(
    table: LimitsTable, has_cup: bool, location: Location
) -> Surroundings | None:
    obstacles = _obstacles(table)
    if not obstacles:
        return None
    if table.links_mm is None and table.bar_mm is None:
        raise location.error(
            "obstacles are given, but nothing that moves near them",
            "give links_mm, bar_mm or both",
        )
    bar = table.bar_mm if has_cup else None
    if table.links_mm is None and bar is None:
        return None
    return Surroundings(
        obstacles=obstacles,
        links=None if table.links_mm is None else _metres(table.links_mm),
        bar=None if bar is None else _metres(bar),
        margin=_metres(table.margin_mm),
        ignore=tuple(table.ignore),
    )


def _obstacles(table: LimitsTable) -> tuple[Capsule, ...]:
    capsules = []
    for sphere in table.spheres:
        centre = _metres_of(sphere.at_mm)
        capsules.append(Capsule(centre, centre, _metres(sphere.radius_mm)))
    for rod in table.rods:
        start, end = _metres_of(rod.from_mm), _metres_of(rod.to_mm)
        capsules.append(Capsule(start, end, _metres(rod.radius_mm)))
    return tuple(capsules)


def _metres(mm: float) -> float:
    return float(units.to_si(mm, "mm"))


def _metres_of(mm: Point) -> Point:
    return _metres(mm[0]), _metres(mm[1]), _metres(mm[2])


def _point(values: Array) -> Point:
    return float(values[0]), float(values[1]), float(values[2])


#: largest share by which a reading may differ from what the instrument holds
HOLD_TOLERANCE = 0.01
CANNOT_HOLD = "cannot hold their reading"


def candidates(
    study: Study, measurement: Measurement
) -> tuple[tuple[Series, ...], dict[str, int], tuple[str, ...]]:
    """One series for each [[design.candidates]], refusals by reason, and warnings.

    Raises InputError where a grid does not fit or no candidate meets the limits.
    """
    if study.design is None:
        return (), {}, ()
    every: list[Series] = []
    refusals: Counter[str] = Counter()
    warnings: list[str] = []
    location = study.location.key("design")
    for i, table in enumerate(study.design.candidates):
        field = location.key("candidates").item(i)
        lookup.known_name(table.setup, measurement.setups, field.key("setup"))
        series, lost = grids.grid_series(table, measurement, field, strict=False)
        if lost:
            refusals[CANNOT_HOLD] += lost
            warnings.append(
                f"{field.field}: {lost} of {lost + len(series)} poses are left out,"
                f" because {table.setup} cannot hold its reading there"
            )
        count = len(series)
        series, reasons = _is_within_limits(study.design, measurement, series, location)
        for reason, number in reasons.items():
            refusals[reason] += number
            warnings.append(
                f"{field.field}: {number} of {count} candidates are left out: they"
                f" {reason}"
            )
        if study.design.limits is None or study.design.limits.travel_mm is None:
            warnings += _hold_warnings(measurement, series, field)
        every.append(series)
    return tuple(every), dict(refusals), tuple(warnings)


def _is_within_limits(
    table: DesignTable, measurement: Measurement, series: Series, location: Location
) -> tuple[Series, dict[str, int]]:
    """The series within [design.limits], and its refusals by reason."""
    if table.limits is None:
        return series, {}
    return keep_within_limits(
        table.limits,
        measurement,
        series,
        location.key("limits"),
        whole_runs=table.whole_runs,
    )


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
        location = study.location.key("design").key("reference").item(i)
        lookup.known_name(table.setup, measurement.setups, location.key("setup"))
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
    """The circles of the [[kappa]] table number `i`. Raises InputError.

    plans  reference plans, one of which may be read as well
    """
    location = study.location.key("kappa").item(i)
    setups = [s.name for s in study.setup]
    name = lookup.known_name(table.setup, setups, location.key("setup"))
    further = _further(table, plans, location)
    measurement = measurement_with({name, *(s.setup for s in further)})
    machine = measurement.machine
    columns = [c.name for c in machine.command]
    key, across, (lower, upper) = _spacing(table, machine, location)
    around = _angle_around(table, machine, across, location)
    ends = np.tile(machine.home_command, (2, 1))
    ends[:, columns.index(across)] = lower, upper
    tool = measurement.setups[table.setup].tool
    command_ranges.check_tool_workspace(
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
    """The readings of the reference plan that the table names, if any."""
    if table.with_ is None:
        return ()
    by_name = {plan.name: plan.series for plan in plans}
    field = location.key("with")
    return by_name[lookup.known_name(table.with_, by_name, field, "reference plan")]


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
    name, unit = quantities.split_key(
        key, command_ranges.command_units(machine), location
    )
    ends = float(units.to_si(span.from_, unit)), float(units.to_si(span.to, unit))
    return key, name, ends


def _angle_around(
    table: KappaTable, machine: Machine, across: str, location: Location
) -> str:
    """The angle that runs round each circle: the one coordinate not used otherwise."""
    location = location.key("coordinate")
    columns = [c.name for c in machine.command]
    if table.coordinate is not None:
        lookup.known_name(table.coordinate, columns, location, "coordinate")
    others = [c for c in machine.command if c.name not in (across, table.coordinate)]
    if len(others) != 1 or others[0].unit != "rad":
        problem = (
            "besides the range and the held coordinate, one angle must be left to run"
            " round"
        )
        remedy = f"coordinates are {', '.join(columns)}"
        raise location.error(problem, remedy, table.coordinate or "")
    return others[0].name
