"""Table of runs to take, each under its condition."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

from oed import units
from oed.result import ChosenRun, StudyResult
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Paragraph,
    Table,
    TableColumn,
    number_columns,
    wide_column,
)
from pkm_reports.sections.gap import runs

# Chapter: a second visit, and what its readings are expected to decide.


def blocks(result: StudyResult) -> list[Block]:
    """What the visit is worth, and its runs; nothing where the diagnosis is sure."""
    visit = None if result.gap is None else result.gap.second_visit
    if visit is None:
        return []
    caption = (
        "Runs of a second visit, in the file second_visit.csv with a row for each pose"
    )
    poses = [str(count) for count in visit.poses]
    return [
        Paragraph(" ".join(text.sentences(visit.words))),
        runs.table(visit.runs, "Poses", poses, f"{caption}."),
    ]


CHAPTER: Final = Chapter("second_visit", "A second visit", blocks, blocks)


DIRECTION_SIGNS: Final = {True: "+1", False: f"{text.MINUS}1"}


def _feed(value: float) -> str:
    return text.trimmed(units.number(value, "mm") * units.factor("min"))


#: column title and text of each condition of a run, from its SI value
CONDITIONS: Final[Mapping[str, tuple[str, Callable[[float], str]]]] = {
    "direction": ("Direction", lambda value: DIRECTION_SIGNS[value > 0.0]),
    "payload": ("Payload [N]", text.trimmed),
    "feed": ("Feed [mm/min]", _feed),
    "time": ("Start [min]", lambda value: text.trimmed(units.number(value, "min"))),
}


def table(
    runs: Sequence[ChosenRun], title: str, cells: Sequence[str], caption: str
) -> Table:
    """Set-up, run and conditions of each run, and a further column of a title."""
    conditions = [
        name for name in CONDITIONS if any(name in run.condition for run in runs)
    ]
    titles = [CONDITIONS[name][0] for name in conditions]
    columns = [
        TableColumn("Set-up"),
        wide_column("Run"),
        *number_columns(*titles, title),
    ]
    rows = [
        [run.setup, run.run, *[_condition(run, name) for name in conditions], cell]
        for run, cell in zip(runs, cells, strict=True)
    ]
    return Table(columns, rows, caption)


def _condition(run: ChosenRun, name: str) -> str:
    if name not in run.condition:
        return text.MISSING
    _, written = CONDITIONS[name]
    return written(run.condition[name])
