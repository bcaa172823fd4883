"""Polishes the chosen poses, and free settings of their set-ups, off the grid."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from oed import units
from oed.base import Array
from oed.identifiability import prior_information
from oed.measurement import Measurement, Series
from oed.poses import polish_readings
from oed.result import PolishSummary
from pkm_studies.base import Location
from pkm_studies.describe import field
from pkm_studies.resolve import CommandRanges
from pkm_studies.stages.design.criteria import StudyCriteria
from pkm_studies.tables import PolishTable


@dataclasses.dataclass(frozen=True)
class PolishedPlan:
    """Readings as polished, with their set-ups as moved."""

    measurement: Measurement
    series: tuple[Series, ...]
    summary: PolishSummary


def polish_plan(
    study_criteria: StudyCriteria,
    asked: PolishTable,
    measurement: Measurement,
    series: Sequence[Series],
    retained: Sequence[Series],
) -> PolishedPlan:
    """The chosen readings polished, or as they are where that gains nothing.

    `retained` readings are part of the plan and do not move. Raises InputError.
    """
    table, name = study_criteria.table, study_criteria.table.judged_by
    location = study_criteria.resolved.study.location.key("design").key("polish")
    ranges = _free_ranges(study_criteria, series, retained, location)
    try:
        polished = polish_readings(
            measurement,
            series,
            study_criteria.parameters_criterion(name, measurement),
            table.scaling,
            free=ranges,
            prior=_prior_information(study_criteria, measurement, retained),
            travel=_travel(study_criteria),
            clearance=asked.clearance,
            iterations=asked.iterations,
        )
    except ValueError as error:
        raise location.error(str(error), "mend it, or leave polishing out") from error
    before, value = study_criteria.score(name, measurement, [*retained, *series])
    after, new_value = study_criteria.score(
        name, polished.measurement, [*retained, *polished.series]
    )
    if after > before:
        moved = _moved_settings(polished.measurement, ranges)
        summary = PolishSummary(value, new_value, polished.summary, moved)
        return PolishedPlan(polished.measurement, polished.series, summary)
    phrase = "polishing does not improve the criterion"
    if polished.value_after == polished.value_before:
        phrase = polished.summary
    summary = PolishSummary(value, value, phrase, {})
    return PolishedPlan(measurement, tuple(series), summary)


def _travel(study_criteria: StudyCriteria) -> float | None:
    """How far a held reading may differ from what the instrument holds, m."""
    limits = study_criteria.table.limits
    if limits is None or limits.travel_mm is None:
        return None
    return float(units.to_si(limits.travel_mm, "mm"))


def _free_ranges(
    study_criteria: StudyCriteria,
    series: Sequence[Series],
    retained: Sequence[Series],
    location: Location,
) -> CommandRanges:
    """What polishing may move of the set-ups that the plan uses."""
    ranges = study_criteria.request.free_ranges
    fixed = {s.setup for s in retained}
    for name in ranges:
        if name in fixed:
            raise (
                location.key("free")
                .key(name)
                .error(
                    f"the retained readings of {name} were taken where it stands",
                    "move another set-up",
                )
            )
    used = {s.setup for s in series}
    return {name: limits for name, limits in ranges.items() if name in used}


def _prior_information(
    study_criteria: StudyCriteria, measurement: Measurement, retained: Sequence[Series]
) -> Array | None:
    """Information (n, n) before the polished readings: retained ones, tolerances."""
    if retained:
        return study_criteria.information(measurement, retained)
    if study_criteria.table.prior:
        return prior_information(measurement)
    return None


def _moved_settings(
    measurement: Measurement, ranges: CommandRanges
) -> dict[str, dict[str, float]]:
    """Where each free setting stands now, by set-up and column."""
    moved: dict[str, dict[str, float]] = {}
    for name, limits in ranges.items():
        setup = measurement.setups[name]
        unit = {s.name: s.unit for s in setup.instrument.settings}
        tool = zip(("tool_x", "tool_y", "tool_z"), setup.tool, strict=True)
        values = {**setup.settings, **dict(tool)}
        moved[name] = {}
        for setting in limits:
            si = unit.get(setting, "m")
            key, value = field(setting, values[setting], si)
            moved[name][key] = value
    return moved
