"""[design.limits] applied to candidates: which readings can be taken at all, and why
the others can not.
"""

from __future__ import annotations

import math

import numpy as np

from oed import units
from oed.arrays import Mask
from oed.design import feasible
from oed.design.clearance import Capsule, Surroundings, cup_place
from oed.measurement import Measurement, Series
from pkm_studies.errors import Place
from pkm_studies.resolve import quantities
from pkm_studies.study.tables import ConeTable, LimitsTable

UNLIKELY = "leave the travel of the instrument on too many machines within tolerances"


def limited(
    said: LimitsTable,
    measurement: Measurement,
    series: Series,
    place: Place,
    *,
    whole_runs: bool,
) -> tuple[Series, dict[str, int]]:
    """Readings of a series within the limits, and {reason: readings refused}; whole
    runs go as a whole.

    Raises InputError where a limit cannot be looked at, or no reading is left.
    """
    try:
        found = feasible.check(
            measurement, series, _limits(said, measurement, series.setup, place)
        )
        allowed, reasons = found.allowed.copy(), dict(found.reasons)
        if said.travel_chance is not None:
            likely = _likely(said, measurement, series, place)
            allowed &= likely
            reasons |= {UNLIKELY: int((~likely).sum())} if not likely.all() else {}
    except ValueError as error:
        raise place.error(str(error), "mend or remove this limit") from error
    if whole_runs:
        broken = set(series.run[~allowed])
        allowed = np.array([run not in broken for run in series.run])
    if not allowed.any():
        told = "; ".join(f"{count} {reason}" for reason, count in reasons.items())
        raise place.error(
            f"no candidate of {series.setup} is left: {told}",
            "widen the limits, or move the candidates",
        )
    return series.take(np.flatnonzero(allowed)), reasons


def _likely(
    said: LimitsTable, measurement: Measurement, series: Series, place: Place
) -> Mask:
    """Which held readings (n,) stay within the travel with the wanted probability."""
    if said.travel_mm is None:
        raise place.key("travel_chance").error(
            "a chance to stay within which travel?", "give travel_mm as well"
        )
    if measurement.setups[series.setup].instrument.holds is None:
        return np.ones(len(series), dtype=bool)
    covariance = np.diag(measurement.tolerance**2)
    chance = feasible.within_travel(measurement, series, covariance, _m(said.travel_mm))
    return np.asarray(chance >= (said.travel_chance or 0.0))


def _limits(
    said: LimitsTable, measurement: Measurement, setup: str, place: Place
) -> feasible.Limits:
    """The limits that go for a set-up."""
    chosen = measurement.setups[setup]
    has_cup = chosen.teach is not None or {"at_x", "at_y", "at_z"} <= set(
        chosen.settings
    )
    return feasible.Limits(
        joints=_joints(said, measurement, place.key("joints")),
        singularity=said.singularity,
        travel=(
            _m(said.travel_mm)
            if said.travel_mm is not None and chosen.instrument.holds is not None
            else None
        ),
        base_cone=_cone(said.cup_cone, place.key("cup_cone")) if has_cup else None,
        platform_cone=(
            _cone(said.tool_cone, place.key("tool_cone")) if has_cup else None
        ),
        cup=_point(cup_place(measurement, setup)) if has_cup else None,
        surroundings=_surroundings(said, has_cup, place),
    )


def _joints(
    said: LimitsTable, measurement: Measurement, place: Place
) -> dict[str, tuple[float, float]]:
    known = {c.name: c.unit for c in measurement.machine.joints}
    found = {}
    for key, span in said.joints.items():
        name, unit = quantities.split(key, known, place)
        found[name] = (
            float(units.to_si(span.from_, unit)),
            float(units.to_si(span.to, unit)),
        )
    return found


def _cone(said: ConeTable | None, place: Place) -> feasible.Cone | None:
    if said is None:
        return None
    if not any(said.axis):
        raise place.key("axis").error(
            "a cone needs an axis that is not zero", "give a direction, as [0, 0, 1]"
        )
    return feasible.Cone(said.axis, math.radians(said.half_angle_deg))


def _surroundings(
    said: LimitsTable, has_cup: bool, place: Place
) -> Surroundings | None:
    obstacles = [
        Capsule(_si(s.at_mm), _si(s.at_mm), _m(s.radius_mm)) for s in said.spheres
    ]
    obstacles += [
        Capsule(_si(r.from_mm), _si(r.to_mm), _m(r.radius_mm)) for r in said.rods
    ]
    if not obstacles:
        return None
    if said.links_mm is None and said.bar_mm is None:
        raise place.error(
            "nothing that moves is looked at beside the obstacles",
            "give links_mm, bar_mm or both",
        )
    bar = said.bar_mm if has_cup else None
    if said.links_mm is None and bar is None:
        return None
    return Surroundings(
        obstacles=tuple(obstacles),
        links=None if said.links_mm is None else _m(said.links_mm),
        bar=None if bar is None else _m(bar),
        margin=_m(said.margin_mm),
        ignore=tuple(said.ignore),
    )


def _m(mm: float) -> float:
    return float(units.to_si(mm, "mm"))


def _si(mm: tuple[float, float, float]) -> tuple[float, float, float]:
    return _m(mm[0]), _m(mm[1]), _m(mm[2])


def _point(
    values: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
