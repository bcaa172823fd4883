"""Applies [design.limits]: which candidates can be read, and why the others cannot."""

from __future__ import annotations

import math

import numpy as np

from oed.base import units
from oed.base.arrays import Array, Mask
from oed.design import feasible
from oed.design.clearance import Surroundings, cup_place
from oed.design.segments import Capsule
from oed.measurement.measurement import Measurement, Series
from pkm_studies import quantities
from pkm_studies.base import Place
from pkm_studies.tables import ConeTable, LimitsTable

UNLIKELY = "leave the travel of the instrument on too many machines within tolerances"

Point = tuple[float, float, float]


def within_limits(
    table: LimitsTable,
    measurement: Measurement,
    series: Series,
    place: Place,
    *,
    whole_runs: bool,
) -> tuple[Series, dict[str, int]]:
    """Readings of a series within the limits, and the number refused, by reason.

    With `whole_runs`, one refused reading refuses its run. Raises InputError where a
    limit cannot be checked, or no reading is left.
    """
    try:
        limits = _limits(table, measurement, series.setup, place)
        verdict = feasible.check_readings(measurement, series, limits)
        allowed, reasons = verdict.allowed.copy(), dict(verdict.refusal_counts)
        if table.travel_chance is not None:
            likely = _likely(table, measurement, series, place)
            allowed &= likely
            if not likely.all():
                reasons[UNLIKELY] = int((~likely).sum())
    except ValueError as error:
        raise place.error(str(error), "mend or remove this limit") from error
    if whole_runs:
        broken = set(series.run[~allowed])
        allowed = np.array([run not in broken for run in series.run])
    if not allowed.any():
        counts = "; ".join(f"{count} {reason}" for reason, count in reasons.items())
        raise place.error(
            f"no candidate of {series.setup} is left: {counts}",
            "widen the limits, or move the candidates",
        )
    return series.take(np.flatnonzero(allowed)), reasons


def _likely(
    table: LimitsTable, measurement: Measurement, series: Series, place: Place
) -> Mask:
    """Held readings (n,) that stay within the travel with the wanted probability."""
    if table.travel_mm is None:
        raise place.key("travel_chance").error(
            "a chance to stay within which travel?", "give travel_mm as well"
        )
    if measurement.setups[series.setup].instrument.fixed_reading is None:
        return np.ones(len(series), dtype=bool)
    covariance = measurement.prior_covariance
    travel = _metres(table.travel_mm)
    chance = feasible.within_travel(measurement, series, covariance, travel)
    return chance >= (table.travel_chance or 0.0)


def _limits(
    table: LimitsTable, measurement: Measurement, name: str, place: Place
) -> feasible.ReadingLimits:
    """The limits that apply to a set-up."""
    setup = measurement.setups[name]
    has_cup = setup.teach is not None or {"at_x", "at_y", "at_z"} <= {*setup.settings}
    cup_cone, tool_cone, cup = None, None, None
    if has_cup:
        cup_cone = _cone(table.cup_cone, place.key("cup_cone"))
        tool_cone = _cone(table.tool_cone, place.key("tool_cone"))
        cup = _point(cup_place(measurement, name))
    travel = None
    if table.travel_mm is not None and setup.instrument.fixed_reading is not None:
        travel = _metres(table.travel_mm)
    return feasible.ReadingLimits(
        joints=_joint_ranges(table, measurement, place.key("joints")),
        singularity=table.singularity,
        travel=travel,
        base_cone=cup_cone,
        platform_cone=tool_cone,
        cup=cup,
        surroundings=_surroundings(table, has_cup, place),
    )


def _joint_ranges(
    table: LimitsTable, measurement: Measurement, place: Place
) -> dict[str, tuple[float, float]]:
    known = {c.name: c.unit for c in measurement.machine.joints}
    ranges = {}
    for key, span in table.joints.items():
        name, unit = quantities.split_key(key, known, place)
        low, high = units.to_si(span.from_, unit), units.to_si(span.to, unit)
        ranges[name] = float(low), float(high)
    return ranges


def _cone(table: ConeTable | None, place: Place) -> feasible.DirectionCone | None:
    if table is None:
        return None
    if not any(table.axis):
        raise place.key("axis").error(
            "a cone needs an axis that is not zero", "give a direction, as [0, 0, 1]"
        )
    return feasible.DirectionCone(table.axis, math.radians(table.half_angle_deg))


def _surroundings(
    table: LimitsTable, has_cup: bool, place: Place
) -> Surroundings | None:
    obstacles = _obstacles(table)
    if not obstacles:
        return None
    if table.links_mm is None and table.bar_mm is None:
        raise place.error(
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
