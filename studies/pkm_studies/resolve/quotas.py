"""[[design.quota]] and [design] equal: numbers of readings from selections of candidates.

A candidate is a reading, or a whole run. Candidates are in the order of
`oed.design.candidates`: series by series, runs in order of appearance.
"""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from oed import units
from oed.base import Index, Mask
from oed.design import QuotaSet
from oed.measurement import Measurement, Series
from oed.model import Machine
from oed.text import suggest
from pkm_studies import quantities
from pkm_studies.base import Location
from pkm_studies.resolve import lookup
from pkm_studies.resolve.command_ranges import command_units
from pkm_studies.tables import DesignTable, QuotaTable

#: a coordinate may be outside a range by this (m, rad) and count as inside
SLACK = 1e-9
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
    quota_set, places = QuotaSet((), size), []
    for i, quota in enumerate(table.quota):
        field_location = location.key("quota").item(i)
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
    groups, start = [], 0
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


# -- fields ----------------------------------------------------------------------------


def _checked_size(table: DesignTable, location: Location) -> int:
    """The number of readings.

    Raises InputError for fields of [design] that do not go with quotas.
    """
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
            raise (
                location.key("quota")
                .item(i)
                .error(
                    "polishing moves the poses out of the ranges of a quota",
                    "leave polishing out, or select by setups and runs",
                )
            )
    return table.size


def _numbers(
    quota: QuotaTable, size: int, location: Location
) -> tuple[int, int | None]:
    """Least and largest number of a quota."""
    for number, share in (("min", "min_share"), ("max", "max_share")):
        stated = getattr(quota, number), getattr(quota, share)
        if None not in stated:
            raise location.key(share).error(
                f"{number} is given as well", "keep one of the two", stated[1]
            )
    least, most = quota.min, quota.max
    if quota.min_share is not None:
        least = math.ceil(quota.min_share * size - SLACK)
    if quota.max_share is not None:
        most = math.floor(quota.max_share * size + SLACK)
    if least is None and most is None:
        raise location.error(
            "how many readings?", "give min, max, min_share or max_share"
        )
    if least is not None and most is not None and least > most:
        raise location.key("min").error(
            f"more than the largest number, {most}", "lower it, or raise max", least
        )
    return least or 0, most


# -- selections ------------------------------------------------------------------------


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
        lookup.known_name(name, setups, location.key("setups").item(i))
    _check_runs(quota, groups, location.key("runs"))
    inside = _is_within_ranges(quota, measurement.machine, candidates, location)
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


def _is_within_ranges(
    quota: QuotaTable,
    machine: Machine,
    candidates: Sequence[Series],
    location: Location,
) -> Mask:
    """Which readings (N,) are within the ranges of all coordinates."""
    commands = np.vstack([series.reading_commands() for series in candidates])
    names = [c.name for c in machine.command]
    inside = np.ones(len(commands), dtype=bool)
    for key, span in quota.coordinates.items():
        name, unit = quantities.split_key(key, command_units(machine), location)
        if span.from_ is None and span.to is None:
            raise location.key(key).error(
                "the range has no end", "give from, to or both"
            )
        values = commands[:, names.index(name)]
        if span.from_ is not None:
            inside &= values >= float(units.to_si(span.from_, unit)) - SLACK
        if span.to is not None:
            inside &= values <= float(units.to_si(span.to, unit)) + SLACK
    return inside


def _join_equally(
    quota_set: QuotaSet, by: str, groups: Sequence[_Group], location: Location
) -> QuotaSet:
    """The quotas with equal numbers a set-up or a run."""
    labels = [group.setup for group in groups]
    if by == "run":
        labels = [f"{group.setup}, {group.run}" for group in groups]
    try:
        return quota_set.joined_equally(labels)
    except ValueError as error:
        remedy = "change readings accordingly, or give a quota for each"
        raise location.error(str(error), remedy, by) from error


# -- contradictions --------------------------------------------------------------------


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
