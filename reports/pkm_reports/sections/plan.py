"""Chapter: the machine, and which readings to take in which order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from oed.result import (
    DesignSection,
    Drawing,
    MachineInfo,
    PlannedReading,
    PlanSection,
    SetupInfo,
    StudyResult,
    WorkingOrder,
)
from pkm_reports import missing, text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Items,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    headed_list,
    number_columns,
    text_columns,
    transposed,
    wide_column,
)
from pkm_reports.sections.figures import machine, path
from pkm_reports.sections.stages.chapter import has_schedule
from pkm_reports.view import points_mm

# The machine's parameters and the set-ups, explained where they first stand.

#: columns of the machine's table that hold sentences
SENTENCES: Final = ("about", "text")
#: titles of the columns of the machine's table
TITLES: Final = {
    "name": "Parameter",
    "about": "What it is",
    "held": "In the controller",
    "expected": "Prior mean",
}


def setup_blocks(setups: Sequence[SetupInfo]) -> list[Block]:
    """Settings, noise and unknowns of each set-up."""
    if not setups:
        return []
    columns = [
        TableColumn("Set-up"),
        wide_column("Instrument"),
        wide_column("Settings"),
        wide_column("Noise (1 sigma)"),
        wide_column("Unknowns and tolerances"),
    ]
    rows = [
        [
            setup.name,
            _instrument(setup),
            text.named_quantities(setup.numbers),
            text.named_quantities(setup.sigma),
            text.named_quantities(setup.unknowns),
        ]
        for setup in setups
    ]
    caption = (
        f"{text.count(len(setups), 'set-up')} as used: settings, noise, and the"
        " unknowns that the fit identifies as well."
    )
    return [Table(columns, rows, caption)]


def _instrument(setup: SetupInfo) -> str:
    if not setup.about:
        return setup.instrument
    return f"{setup.instrument}: {text.sentence(setup.about)}"


def parameter_blocks(machine: MachineInfo) -> list[Block]:
    """Each parameter with what it is, its nominal value and its tolerance."""
    table = machine.parameters
    if not table:
        return []
    keys = list(dict.fromkeys(key for row in table for key in row))
    numeric = {
        key
        for key in keys
        if all(key in row and not isinstance(row[key], str) for row in table)
    }
    columns = [
        TableColumn(_title(key), number=key in numeric, wide=key in SENTENCES)
        for key in keys
    ]
    rows = [[_cell(key, row.get(key)) for key in keys] for row in table]
    caption = (
        f"The parameters of {machine.name}. The tolerance is the standard deviation"
        " before any reading."
    )
    if machine.frame:
        caption += (
            " These stay at nominal, because they only choose the base frame:"
            f" {text.listing(machine.frame)}."
        )
    return [Table(columns, rows, caption)]


def _title(key: str) -> str:
    return TITLES[key] if key in TITLES else text.heading(key).capitalize()


def _cell(key: str, value: str | float | None) -> str:
    if isinstance(value, str):
        return text.unit_symbol(value) if key == "unit" else value
    return text.trimmed(value, 7)


def blocks(result: StudyResult) -> list[Block]:
    """Drawing, stages, working order, readings."""
    design, drawing, plan = result.design, result.drawing, result.plan
    chapter: list[Block] = [Paragraph(_introduction(result.machine))]
    if drawing is not None:
        caption = _drawing_caption(drawing)
        chapter.append(Picture("machine", lambda: machine.draw(drawing), caption))
    chapter += parameter_blocks(result.machine)
    chapter += setup_blocks(result.setups)
    if plan is not None and not has_schedule(plan):
        chapter += _stages(plan)
    if design is not None:
        chapter.append(Paragraph(_choice(design)))
        chapter += working_order(design)
        chapter += _readings(design.poses)
    return chapter


def _introduction(info: MachineInfo) -> str:
    about = f"{info.name}: {text.sentence(info.about)}"
    if not info.source:
        return about
    return f"{about} Source: {text.sentence(info.source)}"


def _drawing_caption(drawing: Drawing) -> str:
    """What is labelled, how many readings where, and how far they reach."""
    caption = "The machine at its home pose in the base frame, equal scale on all axes."
    if drawing.labels:
        caption += (
            " Each parameter stands at the point or the leg that it moves; the table"
            " explains them."
        )
    tips = points_mm(drawing.tool_points)
    if not len(tips):
        return caption
    setups = drawing.reading_of
    counts = [f"{setups.count(name)} in {name}" for name in dict.fromkeys(setups)]
    where = f": {text.listing(counts, 5)}" if counts else ""
    sides = [text.number(side) for side in np.ptp(tips, axis=0)]
    span = f"{' × '.join(sides)}{text.NO_BREAK}mm (x, y, z)"
    points = text.count(len(tips), "tool point")
    return f"{caption} {points}{where}; together they span {span}."


# -- readings --------------------------------------------------------------------------


def _choice(design: DesignSection) -> str:
    """What was chosen, by what, out of how many."""
    readings = text.count(design.n, "reading")
    choice = f"Criterion {design.criterion} chose {readings}"
    if design.candidates:
        choice += f" out of {text.count(design.candidates, 'candidate')}"
    if design.retained:
        choice += f"; {design.retained} of them belong to the earlier plan"
    return f"{choice}."


def _readings(poses: Sequence[PlannedReading]) -> list[Block]:
    if not poses:
        return []
    commands = list(dict.fromkeys(key for pose in poses for key in pose.command))
    channels = list(dict.fromkeys(key for pose in poses for key in pose.reading))
    columns = [
        TableColumn("No.", number=True),
        *text_columns("Set-up", "Run"),
        *number_columns("Order in run"),
        *number_columns(*[text.heading(name) for name in commands]),
        *number_columns(*[f"{text.heading(name)}, nominal" for name in channels]),
    ]
    cells = [
        [str(k) for k in range(1, len(poses) + 1)],
        [pose.setup for pose in poses],
        [pose.run for pose in poses],
        [str(pose.order) for pose in poses],
    ]
    for name in commands:
        cells.append(
            text.aligned(missing.column([pose.command for pose in poses], name))
        )
    for name in channels:
        cells.append(
            text.aligned(missing.column([pose.reading for pose in poses], name))
        )
    return [Table(columns, transposed(cells), _readings_caption(poses), linked=True)]


def _readings_caption(poses: Sequence[PlannedReading]) -> str:
    """What to do, set-up by set-up."""
    entries = []
    for setup in dict.fromkeys(pose.setup for pose in poses):
        of_setup = [pose for pose in poses if pose.setup == setup]
        entry = f"{text.count(len(of_setup), 'reading')} in {setup}"
        runs = list(dict.fromkeys(pose.run for pose in of_setup))
        if runs != ["1"]:
            entry += f" ({text.listing(runs, 4)})"
        entries.append(entry)
    return (
        f"The readings to take, from top to bottom: {text.listing(entries, 5)}. Each row"
        " holds the command to the machine."
    )


# -- stages without a schedule ---------------------------------------------------------


def _stages(plan: PlanSection) -> list[Block]:
    considered = [entry for entry in plan.alternatives if isinstance(entry, str)]
    alternatives = headed_list("Alternatives considered:", text.sentences(considered))
    stages = plan.stages
    if len(stages) == 1:
        return []
    if not stages:
        return alternatives
    columns = [
        TableColumn("Stage", number=True),
        TableColumn("Measurement"),
        wide_column("Set-ups"),
        *number_columns("Readings", "Rank", "Cost [min]", "κ"),
        wide_column("Predicted afterwards"),
    ]
    rows = [
        [
            str(k),
            stage.measurement,
            text.listing(stage.setups),
            str(stage.readings),
            str(stage.identifies),
            text.number(stage.cost),
            text.number(stage.kappa, 4),
            text.named_quantities(stage.predicted, 3),
        ]
        for k, stage in enumerate(stages, 1)
    ]
    cost = text.quantity(plan.cost, "min")
    caption = f"The plan in stages; together they take {cost} of machine time."
    return [Table(columns, rows, caption), *alternatives]


CHAPTER: Final = Chapter("plan", "Machine and plan", blocks)


# -- working order ---------------------------------------------------------------------


def working_order(design: DesignSection) -> list[Block]:
    """Travel, set-ups in order, path through the poses."""
    poses, order = design.poses, design.order
    content: list[Block] = []
    setups = design.setups
    if order is not None:
        content.append(Paragraph(_travel(order)))
        setups = order.setups or setups
    if len(setups) > 1:
        items = [_setup(name, poses) for name in setups]
        content += [
            Paragraph("Set-ups, in working order:"),
            Items(items, numbered=True),
        ]
    if any(pose.command for pose in poses):
        content.append(Picture("path", lambda: path.draw(poses), _path_caption(poses)))
    return content


def _travel(order: WorkingOrder) -> str:
    before, after = order.before_s, order.after_s
    travel = f"In working order the joints travel for {text.quantity(after, 's')}"
    if before > after:
        saved = text.percent(1.0 - after / before)
        travel += (
            f", {saved} less than the {text.quantity(before, 's')} in the order of the"
            " candidates"
        )
    sentences = [f"{travel}."]
    if order.exact:
        sentences.append("Within each set-up no path is shorter (proven).")
    if order.references:
        readings = text.count(order.references, "thermal reference reading")
        verb = "is" if order.references == 1 else "are"
        sentences.append(f"{readings} {verb} put between.")
    if order.minutes:
        minutes = text.quantity(order.minutes, "min")
        sentences.append(f"Mounting, travel and readings take {minutes} together.")
    return " ".join(sentences)


def _setup(name: str, poses: Sequence[PlannedReading]) -> str:
    """How many readings, and which of the table."""
    numbers = [k for k, pose in enumerate(poses, 1) if pose.setup == name]
    if not numbers:
        return name
    first, last = numbers[0], numbers[-1]
    entry = f"{name}: {text.count(len(numbers), 'reading')}"
    consecutive = last - first == len(numbers) - 1
    if len(numbers) > 1 and consecutive:
        return f"{entry}, no. {first} to {last}"
    return entry


def _path_caption(poses: Sequence[PlannedReading]) -> str:
    readings = text.count(len(poses), "reading")
    sentences = [
        f"The path through the {readings} in working order; the numbers are those of"
        " the table."
    ]
    plane = path.choose_plane(poses)
    if plane is None:
        return sentences[0]
    hidden = [name for name in path.coordinates(poses) if name not in plane.names]
    axes = f"Shown: {_stems(plane.names)}"
    sentences.append(f"{axes} (not shown: {_stems(hidden)})." if hidden else f"{axes}.")
    if path.crosses_edge(plane, [pose.setup for pose in poses]):
        sentences.append(
            "A path over a full turn leaves the figure on one side and returns on the"
            " other."
        )
    more = len({pose.setup for pose in poses}) - path.MOST_PANELS
    if more > 0:
        sentences.append(f"{more} more set-ups are not shown.")
    return " ".join(sentences)


def _stems(names: Sequence[str]) -> str:
    return text.listing(text.split_unit(name)[0] for name in names)
