"""What to measure, or what was: instrument, set-ups, readings, their time and order."""

import re
from collections.abc import Sequence
from typing import Final

from oed.result import DesignSection, PlanSection, SetupInfo, StudyResult
from oed.text import capitalised
from pkm_reports import text
from pkm_reports.blocks import Block, Facts, Picture, Table, TableColumn, transposed
from pkm_reports.sections.machine_figures import draw_overview
from pkm_reports.sections.plan import budget_share, has_schedule, minutes

MAX_NAMED: Final = 6  #: set-ups and stages named one by one
MAX_READINGS: Final = 40  #: readings in their order
#: names of files with readings to fill in; numbered where an earlier one is filled in
POSES: Final = re.compile(r"(\w+_)?poses(-\d+)?\.csv")


def measure_title(result: StudyResult) -> str:
    """Measure, before the readings are taken; measured, once they are recorded."""
    return "What to measure" if is_plan(result) else "What was measured"


def is_plan(result: StudyResult) -> bool:
    """Whether the report tells which readings to take; not where they are recorded."""
    prediction = result.judged_prediction
    of_readings = prediction is not None and prediction.mode != "plan"
    planned = result.design is not None or has_schedule(result.plan)
    return planned and not of_readings and result.gap is None


def measure_blocks(result: StudyResult) -> list[Block]:
    """Instrument, set-ups and readings as facts; where they lie in the machine."""
    setups = used_setups(result)
    about = result.machine.about
    stated = [
        ("Machine", text.sentence(about) if about else ""),
        ("Instrument", _instruments(setups)),
        _setups(setups),
        ("Readings", _number_of_readings(result)),
        ("Time", _time(result)),
        ("Stages", _stages(result.plan)),
        ("List", _list_of_readings(result)),
    ]
    facts = [(term, phrase) for term, phrase in stated if phrase]
    content: list[Block] = [Facts(facts)] if facts else []
    drawing = result.drawing
    if drawing is not None and drawing.lines and drawing.tool_points:
        points = text.count(len(drawing.tool_points), "reading")
        caption = f"Machine at home and the tool points of {points}."
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


def _instruments(setups: Sequence[SetupInfo]) -> str:
    described = {setup.instrument: setup.about for setup in setups}
    phrases = [
        capitalised(text.sentence(about or name.replace("_", " ")))
        for name, about in described.items()
    ]
    return " ".join(phrases)


def _setups(setups: Sequence[SetupInfo]) -> tuple[str, str]:
    """How the set-ups are called, and which there are."""
    if len(setups) > MAX_NAMED:
        named = text.listing([setup.name for setup in setups], MAX_NAMED)
        return "Set-ups", f"{len(setups)}: {named}."
    rows = [f"{setup.name}{_settings(setup)}" for setup in setups]
    term = "Set-up" if len(rows) == 1 else f"{len(rows)} set-ups"
    return term, f"{text.listing(rows)}." if rows else ""


def _settings(setup: SetupInfo) -> str:
    """Settings that are not zero: those a user must set."""
    numbers = {name: value for name, value in setup.numbers.items() if value}
    return f" ({text.named_quantities(numbers)})" if numbers else ""


def instrument_names(setups: Sequence[SetupInfo]) -> list[str]:
    """The instruments of set-ups, each once: double ball bar, laser tracker."""
    described = {setup.instrument: setup.about for setup in setups}
    names = []
    for name, about in described.items():
        first = re.split("[,.(:]", about)[0].strip() or name.replace("_", " ")
        # an abbreviation stands after what it is of
        if first[1:2].isupper() and "," in about:
            first = f"{about.rpartition(',')[2].strip(' .')} ({first})"
        names.append(first)
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


def _time(result: StudyResult) -> str:
    time = plan_minutes(result) if is_plan(result) else ""
    if result.forecast is not None:
        time = text.quantity(result.forecast.minutes, "min", 2)
    return f"{time}." if time else ""


def _has_planned_readings(result: StudyResult) -> bool:
    """Whether the readings are those of the design: to be taken, or as many recorded."""
    design = result.design
    if design is None or is_plan(result):
        return design is not None
    return recorded_readings(result)[0] in (0, len(design.poses))


def _number_of_readings(result: StudyResult) -> str:
    design, forecast = result.design, result.forecast
    if design is not None and _has_planned_readings(result):
        chosen = f", chosen from {design.candidates} candidates"
        return f"{design.n}{chosen if design.candidates else ''}."
    if forecast is not None and forecast.readings:
        return f"{forecast.readings}, one a node."
    if has_schedule(result.plan) or result.estimate is None:
        return ""
    number, values = recorded_readings(result)
    more = "" if values == number else f", with {text.count(values, 'value')}"
    return f"{number}{more}."


def _stages(plan: PlanSection | None) -> str:
    if plan is None or not has_schedule(plan):
        return ""
    rows = [
        f"{k}. {stage.measurement}, {text.count(stage.readings, 'reading')}"
        for k, stage in enumerate(plan.stages[:MAX_NAMED], 1)
    ]
    if len(plan.stages) > MAX_NAMED:
        rows.append(f"and {len(plan.stages) - MAX_NAMED} more")
    return f"{'; '.join(rows)}."


def _list_of_readings(result: StudyResult) -> str:
    files = [name for name in result.written if POSES.fullmatch(name)]
    if not files or not is_plan(result):
        return ""
    return f"{text.listing(files)}, with cells for the readings."


def _working_order(result: StudyResult) -> list[Block]:
    """The readings to take, in their order; of many, the first."""
    design = result.design
    if design is None or not _has_planned_readings(result):
        return []
    poses, shown = design.poses, design.poses[:MAX_READINGS]
    commands = text.aligned_columns([pose.command for pose in shown])
    if not commands:
        return []
    cells = [[str(k) for k in range(1, len(shown) + 1)]]
    columns = [*TableColumn.numbers("No.")]
    if len({pose.setup for pose in poses}) > 1:
        columns.append(TableColumn("Set-up"))
        cells.append([pose.setup for pose in shown])
    columns += TableColumn.numbers(*map(text.heading, commands))
    cells += commands.values()
    of = "" if len(shown) == len(poses) else f", the first {len(shown)} of them"
    caption = f"{text.count(len(poses), 'reading')} in their order{of}."
    return [Table(columns, transposed(cells), caption)]


# How long the measurement takes, and what it costs.
def plan_minutes(result: StudyResult) -> str:
    """The time of the plan and what it holds; empty for readings that exist already."""
    plan, design = result.plan, result.design
    if plan is not None and has_schedule(plan):
        return _scheduled(plan)
    return "" if design is None else _designed(design)


def _scheduled(plan: PlanSection) -> str:
    phrase = f"{minutes(plan.cost)}{budget_share(plan)}"
    if not plan.price:
        return phrase
    return f"{phrase}, at a price of {text.trimmed(plan.price)}"


def _designed(design: DesignSection) -> str:
    if design.order is not None:
        time = text.quantity(design.order.minutes, "min", 2)
        return f"{time} with mounting and travel"
    if design.cost_min is None:
        return ""
    time = text.quantity(design.cost_min, "min", 2)
    return f"{time} with mounting, without travel"
