"""What to measure: instrument, set-ups, number of readings, and a picture of them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from oed.result import Drawing, SetupInfo, StudyResult
from pkm_reports import missing, text
from pkm_reports.blocks import (
    Block,
    Facts,
    Picture,
    Table,
    TableColumn,
    number_columns,
    transposed,
)
from pkm_reports.sections.answer import duration
from pkm_reports.sections.figures.machine import draw_overview
from pkm_reports.sections.stages.chapter import has_schedule

#: set-ups and stages named one by one
MOST: Final = 6
#: readings in their order
MOST_READINGS: Final = 40
#: names of files with readings to fill in; numbered where an earlier one is filled in
POSES: Final = re.compile(r"(\w+_)?poses(-\d+)?\.csv")


def title(result: StudyResult) -> str:
    """Measure, before the readings are taken; measured, once they are recorded."""
    return "What to measure" if is_plan(result) else "What was measured"


def is_plan(result: StudyResult) -> bool:
    """Whether the report tells which readings to take; not where they are recorded."""
    prediction = result.judged_prediction
    of_readings = prediction is not None and prediction.mode != "plan"
    planned = result.design is not None or has_schedule(result.plan)
    return planned and not of_readings and result.gap is None


def blocks(result: StudyResult) -> list[Block]:
    """Instrument, set-ups and readings as facts; where they lie in the machine."""
    setups = used_setups(result)
    facts = [
        *_machine(result),
        *_instruments(setups),
        *_setups(setups),
        *_readings(result),
        *_time(result),
        *_stages(result),
        *_list_of_readings(result),
    ]
    content: list[Block] = [Facts(facts)] if facts else []
    drawing = result.drawing
    if drawing is not None and drawing.lines and drawing.tool_points:
        caption = _caption(drawing)
        picture = Picture("overview", lambda: draw_overview(drawing), caption)
        content.append(picture)
    return [*content, *_working_order(result)]


def used_setups(result: StudyResult) -> list[SetupInfo]:
    """The set-ups that readings are taken in; all of the study where none is named."""
    names: list[str] = []
    if result.design is not None:
        names = result.design.setups
    elif result.plan is not None:
        names = [name for stage in result.plan.stages for name in stage.setups]
    used = [setup for setup in result.setups if setup.name in names]
    return used or list(result.setups)


def _machine(result: StudyResult) -> list[tuple[str, str]]:
    if not result.machine.about:
        return []
    return [("Machine", text.sentence(result.machine.about))]


def _instruments(setups: Sequence[SetupInfo]) -> list[tuple[str, str]]:
    described = {setup.instrument: setup.about for setup in setups}
    phrases = [
        text.sentence(about or name.replace("_", " "))
        for name, about in described.items()
    ]
    return [("Instrument", " ".join(phrases))] if phrases else []


def _setups(setups: Sequence[SetupInfo]) -> list[tuple[str, str]]:
    if not setups:
        return []
    if len(setups) > MOST:
        named = text.listing([setup.name for setup in setups], MOST)
        return [("Set-ups", f"{len(setups)}: {named}.")]
    rows = [f"{setup.name}{_settings(setup)}" for setup in setups]
    term = "Set-up" if len(rows) == 1 else f"{len(rows)} set-ups"
    return [(term, f"{text.listing(rows)}.")]


def _settings(setup: SetupInfo) -> str:
    """Settings that are not zero: those a user must set."""
    numbers = {name: value for name, value in setup.numbers.items() if value}
    return f" ({text.named_quantities(numbers)})" if numbers else ""


def instrument_names(setups: Sequence[SetupInfo]) -> list[str]:
    """The instruments of set-ups, each once: double ball bar, laser tracker."""
    described = {setup.instrument: setup.about for setup in setups}
    names = [
        re.split("[,.(:]", about)[0].strip() or name.replace("_", " ")
        for name, about in described.items()
    ]
    # an abbreviation, as RM 4, stays as it is
    return [
        name if name[1:2].isupper() else f"{name[:1].lower()}{name[1:]}"
        for name in dict.fromkeys(names)
    ]


def planned_readings(result: StudyResult) -> int:
    """How many readings a plan takes."""
    if result.design is not None:
        return result.design.n
    return 0 if result.plan is None else sum(s.readings for s in result.plan.stages)


def recorded_readings(result: StudyResult) -> tuple[int, int]:
    """Readings that a fit uses, and their values."""
    if result.estimate is None:
        return 0, 0
    values = result.estimate.readings
    poses = 0 if result.drawing is None else len(result.drawing.tool_points)
    return poses or values, values


def _time(result: StudyResult) -> list[tuple[str, str]]:
    time = duration.minutes(result) if is_plan(result) else ""
    return [("Time", f"{time}.")] if time else []


def _readings(result: StudyResult) -> list[tuple[str, str]]:
    design = result.design
    if design is not None:
        phrase = f"{design.n}"
        if design.candidates:
            phrase += f", chosen from {design.candidates} candidates"
        return [("Readings", f"{phrase}.")]
    if has_schedule(result.plan) or result.estimate is None:
        return []
    number, values = recorded_readings(result)
    if values == number:
        return [("Readings", f"{number}.")]
    return [("Readings", f"{number}, with {text.count(values, 'value')}.")]


def _stages(result: StudyResult) -> list[tuple[str, str]]:
    plan = result.plan
    if plan is None or not has_schedule(plan):
        return []
    rows = [
        f"{k}. {stage.measurement}, {text.count(stage.readings, 'reading')}"
        for k, stage in enumerate(plan.stages[:MOST], 1)
    ]
    if len(plan.stages) > MOST:
        rows.append(f"and {len(plan.stages) - MOST} more")
    return [("Stages", f"{'; '.join(rows)}.")]


def _list_of_readings(result: StudyResult) -> list[tuple[str, str]]:
    files = [name for name in result.written if POSES.fullmatch(name)]
    if not files or not is_plan(result):
        return []
    return [("List", f"{text.listing(files)}, with cells for the readings.")]


def _working_order(result: StudyResult) -> list[Block]:
    """The readings to take, in their order; of many, the first."""
    poses = [] if result.design is None else result.design.poses
    shown = poses[:MOST_READINGS]
    names = list(dict.fromkeys(key for pose in shown for key in pose.command))
    if not names:
        return []
    cells = [[str(k) for k in range(1, len(shown) + 1)]]
    columns = [*number_columns("No.")]
    if len({pose.setup for pose in poses}) > 1:
        columns.append(TableColumn("Set-up"))
        cells.append([pose.setup for pose in shown])
    for name in names:
        columns += number_columns(text.heading(name))
        values = missing.column([pose.command for pose in shown], name)
        cells.append(text.aligned(values))
    of = "" if len(shown) == len(poses) else f", the first {len(shown)} of them"
    caption = f"{text.count(len(poses), 'reading')} in their order{of}."
    return [Table(columns, transposed(cells), caption)]


def _caption(drawing: Drawing) -> str:
    points = text.count(len(drawing.tool_points), "reading")
    return f"Machine at home and the tool points of {points}."
