"""Chosen poses, and what may be moved of their set-ups, polished off the grid to a
local optimum.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed import result, units
from oed.arrays import Array
from oed.design import polish, symbolic_criterion
from oed.measurement import Measurement, Series
from pkm_studies.errors import Place
from pkm_studies.resolve import quantities
from pkm_studies.resolve.resolved import ResolvedStudy
from pkm_studies.stages import describe
from pkm_studies.stages.design.criteria import StudyCriteria

#: power means that stand for E and O3
POWER = 8


@dataclasses.dataclass(frozen=True)
class PolishedPlan:
    """Readings as polished, with their set-ups as they are now."""

    measurement: Measurement
    series: tuple[Series, ...]
    told: result.PolishSummary


def polished(
    resolved: ResolvedStudy,
    aims: StudyCriteria,
    measurement: Measurement,
    series: Sequence[Series],
    kept: Sequence[Series],
) -> PolishedPlan:
    """The chosen readings polished beside the kept ones, or as they are where that does
    not better the criterion.
    """
    said, place = aims.design.polish, resolved.study.place.key("design").key("polish")
    assert said is not None
    limits = aims.design.limits
    travel = (
        None
        if limits is None or limits.travel_mm is None
        else float(units.to_si(limits.travel_mm, "mm"))
    )
    free = _free(resolved, measurement, series, kept, place)
    name = aims.design.judged_by
    try:
        found = polish.polish_readings(
            measurement,
            series,
            _smooth(name, aims, measurement),
            aims.design.scaling,
            free=free,
            prior=_held(aims, measurement, kept),
            travel=travel,
            clearance=said.clearance,
            iterations=said.iterations,
        )
    except ValueError as error:
        raise place.error(str(error), "mend it, or leave polishing out") from error
    before, value = aims.judged(name, measurement, [*kept, *series])
    after, new = aims.judged(name, found.measurement, [*kept, *found.series])
    if not after > before:
        words = (
            found.summary
            if found.value_after == found.value_before
            else "polishing does not better the criterion"
        )
        return PolishedPlan(
            measurement, tuple(series), result.PolishSummary(value, value, words, {})
        )
    told = result.PolishSummary(
        value, new, found.summary, _moved(found.measurement, free)
    )
    return PolishedPlan(found.measurement, found.series, told)


def _free(
    resolved: ResolvedStudy,
    measurement: Measurement,
    series: Sequence[Series],
    kept: Sequence[Series],
    place: Place,
) -> Mapping[str, Mapping[str, tuple[float, float]]]:
    """What may be moved of the set-ups that the plan uses."""
    assert resolved.design is not None
    stuck = {s.setup for s in kept}
    for name in resolved.design.free_ranges:
        if name in stuck:
            problem = (
                f"readings of {name} are kept, which were taken with it as it stands"
            )
            raise place.key("free").key(name).error(problem, "move another set-up")
    used = {s.setup for s in series}
    return {
        name: ranges
        for name, ranges in resolved.design.free_ranges.items()
        if name in used
    }


def _held(
    aims: StudyCriteria, measurement: Measurement, kept: Sequence[Series]
) -> Array | None:
    """Information held beside the polished readings."""
    if kept:
        return aims.information(measurement, kept)
    return np.eye(int(measurement.free.sum())) if aims.design.prior else None


def _smooth(
    name: str, aims: StudyCriteria, measurement: Measurement
) -> symbolic_criterion.SymbolicCriterion:
    """The criterion as polishing knows it."""
    pieces = aims.pieces(name, measurement)
    if name == "Ds":
        return symbolic_criterion.determinant_of_interest(pieces["interest"])
    if name in ("c", "I"):
        return symbolic_criterion.variance(pieces["factor"].T @ pieces["factor"])
    if name in ("E", "O3"):
        return symbolic_criterion.power_mean(POWER)
    return (
        symbolic_criterion.variance()
        if name == "A"
        else symbolic_criterion.determinant()
    )


def _moved(
    measurement: Measurement, free: Mapping[str, Mapping[str, tuple[float, float]]]
) -> dict[str, dict[str, float]]:
    """Where what was free stands now, in user units."""
    moved: dict[str, dict[str, float]] = {}
    for name, ranges in free.items():
        setup = measurement.setups[name]
        unit = {s.name: s.unit for s in setup.instrument.settings}
        now = {
            **setup.settings,
            **dict(zip(("tool_x", "tool_y", "tool_z"), setup.tool, strict=True)),
        }
        kinds = {v: unit.get(v, "m") for v in ranges}
        moved[name] = {
            quantities.column(v, kinds[v]): describe.shown(now[v], kinds[v])
            for v in ranges
        }
    return moved
