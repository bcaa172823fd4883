"""Candidate runs of [gap.design]: each run of the named plans under each condition."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from oed.base.arrays import Array
from oed.gap.before.runs import Run
from oed.measurement.measurement import Measurement, Series
from pkm_studies.base import Place
from pkm_studies.resolve.conditions import FEED, MINUTE, PASS_SUFFIX, reading_time
from pkm_studies.resolve.grids import ReferencePlan
from pkm_studies.resolve.lookup import known_name
from pkm_studies.tables import ConditionsTable, GapDesignTable, RunCondition


def candidate_runs(
    table: GapDesignTable,
    plans: Mapping[str, ReferencePlan],
    measurement: Measurement,
    timing: ConditionsTable,
    place: Place,
) -> tuple[tuple[Run, ...], int]:
    """Runs of the retained plan, then candidate runs; the number of retained ones.

    Raises InputError for plans that do not exist.
    """
    _check_plans(table, plans, place)

    def runs_of_plan(name: str, conditions: Sequence[RunCondition]) -> list[Run]:
        """Runs of a reference plan under each condition."""
        prefix = name if len(plans) > 1 else ""
        runs: list[Run] = []
        for series in plans[name].series:
            runs += runs_of(series, prefix, conditions, measurement, timing, place)
        return runs

    retained: list[Run] = []
    if table.keep is not None:
        retained = runs_of_plan(table.keep, table.conditions[:1])
    free: list[Run] = []
    for name in table.candidates or plans:
        if name != table.keep:
            free += runs_of_plan(name, table.conditions)
    return (*retained, *free), len(retained)


def _check_plans(
    table: GapDesignTable, plans: Mapping[str, ReferencePlan], place: Place
) -> None:
    if not plans:
        raise place.error(
            "there are no runs to choose from",
            "add [[design.reference]] plans with `runs_by`",
        )
    for i, name in enumerate(table.candidates):
        known_name(name, plans, place.key("candidates").item(i), "plan")
    if table.keep is not None:
        known_name(table.keep, plans, place.key("keep"), "plan")
    if table.keep is not None and table.keep in table.candidates:
        raise place.key("keep").error(
            "a plan is kept or a candidate, not both", "remove it from one", table.keep
        )


def runs_of(
    series: Series,
    plan: str,
    conditions: Sequence[RunCondition],
    measurement: Measurement,
    timing: ConditionsTable,
    place: Place,
) -> list[Run]:
    """Each run of a series under each condition; `plan` starts their names.

    Of the passes of a run, only the first one forward is a candidate.
    """
    seconds = reading_time(measurement.setups[series.setup], timing)
    runs = []
    for label in dict.fromkeys(str(r) for r in series.run):
        repeat = PASS_SUFFIX.search(label)
        if repeat is not None and repeat.groups() != ("forward", "1"):
            continue
        rows = np.flatnonzero(series.run == label)
        command = _commands(series, rows)
        if np.isnan(command).any():
            raise place.key("candidates").error(
                "runs of recorded joints cannot be planned anew", "give commands"
            )
        for condition in conditions:
            parts = [plan, PASS_SUFFIX.sub("", label), *_condition_words(condition)]
            run = Run(
                name=", ".join(part for part in parts if part),
                setup=series.setup,
                command=command,
                condition=_condition_si(condition),
                seconds=seconds * len(rows),
            )
            runs.append(run)
    return runs


def _commands(series: Series, rows: np.ndarray) -> Array:
    """Commands of a run; where readings are relative, its first pose is the reference."""
    poses = series.index[rows, 0]
    if series.index.shape[1] == 2 and series.index[rows[0], 1] < poses.min():
        poses = np.concatenate([series.index[rows[:1], 1], poses])
    return np.asarray(series.command[poses])


def _condition_words(condition: RunCondition) -> list[str]:
    """The condition as parts of a run's name."""
    words = []
    if condition.payload is not None:
        words.append(f"{condition.payload:g} N")
    if condition.feed_mm_min is not None:
        words.append(f"{condition.feed_mm_min:g} mm/min")
    if condition.start_min is not None:
        words.append(f"at {condition.start_min:g} min")
    return [*words, "+1" if condition.direction == 1 else "-1"]


def _condition_si(condition: RunCondition) -> dict[str, float]:
    covariates = {"direction": float(condition.direction)}
    if condition.payload is not None:
        covariates["payload"] = condition.payload
    if condition.feed_mm_min is not None:
        covariates["feed"] = condition.feed_mm_min * FEED
    if condition.start_min is not None:
        covariates["time"] = condition.start_min * MINUTE
    return covariates
