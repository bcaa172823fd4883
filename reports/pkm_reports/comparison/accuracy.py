"""Predicted accuracy of several results, component by component."""

from __future__ import annotations

import math
from collections.abc import Mapping

from oed.result import StudyResult
from oed.result.verdict import accuracy_verdicts
from pkm_reports import missing, text
from pkm_reports.blocks import Block, Picture, Table, TableColumn, number_columns
from pkm_reports.comparison import side_by_side
from pkm_reports.comparison.glance import rms_by_component
from pkm_reports.sections import wanted_accuracy


def blocks(results: Mapping[str, StudyResult]) -> list[Block]:
    """A table with what is wanted beside it, and bars."""
    sizes = rms_by_component(results)
    if not sizes:
        return []
    caption = (
        "Predicted rms error over the workspace afterwards; of what no drive corrects,"
        " the unknown part. Wanted: the strictest of the studies."
    )
    names = list(results)
    goals = _goals(results)
    columns = [TableColumn("Component"), *number_columns(*names)]
    with_goals = bool(goals)
    if with_goals:
        columns += [*number_columns("Wanted"), TableColumn("Passed by")]
    rows = [_row(name, of, results, goals) for name, of in sizes.items()]
    width = len(columns)
    table = Table(columns, [row[:width] for row in rows], caption)
    bars = "The same as bars, on a log scale."
    return [
        table,
        Picture("side_accuracy", lambda: side_by_side.draw(sizes, names), bars),
    ]


def _goals(results: Mapping[str, StudyResult]) -> dict[str, float]:
    """The strictest accuracy that a study asks for, by component and unit."""
    goals: dict[str, float] = {}
    for result in results.values():
        for key, value in wanted_accuracy(result).items():
            goals[key] = min(value, goals[key]) if key in goals else value
    return goals


def _row(
    component: str,
    sizes: Mapping[str, tuple[float, str]],
    results: Mapping[str, StudyResult],
    goals: Mapping[str, float],
) -> list[str]:
    unit = next(iter(sizes.values()))[1]
    cells = [text.number(sizes[n][0]) if n in sizes else text.MISSING for n in results]
    goal = missing.entry(goals, f"{component}_{unit}")
    stated = text.MISSING
    if math.isfinite(goal):
        passing = [
            name
            for name in sizes
            if accuracy_verdicts(results[name], {component: goal})[component].judgement
            == "pass"
        ]
        stated = text.listing(passing) or "none"
    title = f"{component} [{text.unit_symbol(unit)}]"
    return [title, *cells, text.number(goal), stated]
