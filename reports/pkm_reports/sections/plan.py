"""Chapter: the machine, and which readings to take in which order."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from oed import units
from oed.base import Array, Index
from oed.result import (
    DesignSection,
    Drawing,
    MachineInfo,
    PlannedReading,
    PlanSection,
    RecordedChoice,
    RecordingSection,
    SetupInfo,
    StudyResult,
    WorkingOrder,
)
from pkm_reports import missing, style, text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Items,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    headed_list,
    transposed,
)
from pkm_reports.sections.machine_figures import draw_machine
from pkm_reports.view import points_mm


# Times, budgets and goals of a plan in words.
def has_schedule(plan: PlanSection | None) -> bool:
    """Whether a plan has times of its stages."""
    return plan is not None and any(s.begin_min is not None for s in plan.stages)


def is_missed(plan: PlanSection) -> bool:
    """Whether there is a goal that the plan does not reach."""
    return bool(plan.goal) and not plan.reached


def minutes(value: float | None) -> str:
    """33 min."""
    return text.quantity(value, "min")


def budget_phrase(plan: PlanSection) -> str:
    """` within 120 min`, or nothing where there is no budget."""
    return "" if plan.budget_min is None else f" within {_budget(plan.budget_min)}"


def budget_share(plan: PlanSection) -> str:
    """` of a budget of 120 min`, or nothing where there is none."""
    if plan.budget_min is None:
        return ""
    return f" of a budget of {_budget(plan.budget_min)}"


def _budget(minutes: float) -> str:
    return text.append_unit(text.trimmed(minutes), "min")


# Chapter: the machine, and which readings to take in which order.

# The path through the poses in working order, a panel for each set-up.

#: where a number may stand about its place, in its own widths and heights
OFFSETS: Final = np.array(
    [[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, 1], [1, -1], [-1, -1]],
    dtype=float,
)
MAX_NUMBERS: Final = 3  #: numbers of readings written at one place
LETTER_SIZE: Final = 5.5  # points
FRAME = 0.45  #: half-width of a label's frame, in letter sizes
LETTER = 0.33  #: half-width of each letter of a label, in letter sizes
HALF_HEIGHT: Final = 0.8
#: distance of a label from its place, in half-widths and half-heights
LABEL_DISTANCE: Final = 2.2
POINTS_PER_INCH: Final = 72.0
FULL_TURN: Final = 360.0  #: a full turn, degrees
MAX_PANELS: Final = 12
MANY_POSES: Final = 100  #: readings from which the lines of the path are faint
#: what counts as one step of a coordinate, by its SI unit
STEP_IN_UNIT: Final = {"m": "mm", "rad": "deg"}


@dataclasses.dataclass(frozen=True, slots=True)
class Plane:
    """The two coordinates that the figure shows."""

    #: of the coordinates; "reading" is the number of the reading
    names: tuple[str, str]
    at: Array  #: place of each reading (n, 2)
    turn: Array  #: full turn (2,) of coordinates that go round, infinite for others
    limits: Array  #: lower and upper limit (2, 2)


def draw_path(poses: Sequence[PlannedReading]) -> style.Figure:
    """Readings by their numbers in working order, joined by lines."""
    plane = choose_plane(poses)
    if plane is None:
        return style.empty("No commanded poses are stored in this result.")
    setups = list(dict.fromkeys(pose.setup for pose in poses))[:MAX_PANELS]
    groups = [
        np.flatnonzero([pose.setup == setup for pose in poses]) for setup in setups
    ]
    columns = 1 if len(setups) == 1 else 2
    rows = math.ceil(len(setups) / columns)
    figure = style.figure(0.2 + (3.2 if columns == 1 else 2.35) * rows)
    shared: Any = {"sharex": True, "sharey": True}
    grid = figure.subplots(rows, columns, squeeze=False, **shared).ravel()
    for k, (axes, setup, group) in enumerate(zip(grid, setups, groups, strict=False)):
        _panel(axes, plane, group, style.CYCLE[k % len(style.CYCLE)])
        axes.tick_params(labelbottom=k + columns >= len(setups))
        number = "" if len(setups) == 1 else f"{k + 1}: "
        readings = text.count(len(group), "reading")
        axes.set_title(f"{number}{style.label(setup)}, {readings}")
    style.hide(grid[len(setups) :])
    figure.supxlabel(style.label(text.heading(plane.names[0])), fontsize=8)
    figure.supylabel(style.label(text.heading(plane.names[1])), fontsize=8)
    figure.lay_out()  # numbers need the panels' final size
    for k, (axes, group) in enumerate(zip(grid, groups, strict=False)):
        numbers = _numbers_by_place(plane, group)
        write_numbers(axes, numbers, style.CYCLE[k % len(style.CYCLE)])
    return figure


def path_coordinates(poses: Sequence[PlannedReading]) -> list[str]:
    """Commanded coordinates of the poses, in order of appearance."""
    return list(dict.fromkeys(name for pose in poses for name in pose.command))


def choose_plane(poses: Sequence[PlannedReading]) -> Plane | None:
    """The two coordinates, or one and the reading's number, that vary most; 1 mm as 1 deg."""
    names = path_coordinates(poses)
    table: dict[str, Array] = {}
    for name in names:
        values = missing.column([pose.command for pose in poses], name)
        if np.isfinite(values).any():
            table[name] = values
    if not table:
        return None
    spread = {
        name: np.ptp(values[np.isfinite(values)]) / _step(name)
        for name, values in table.items()
    }
    widest = sorted(table, key=lambda name: -spread[name])[:2]
    if len(widest) == 1 or spread[widest[1]] == 0.0:
        table["reading"] = np.arange(1.0, len(poses) + 1.0)
        first = "reading"
        second = widest[0]
    else:
        first, second = sorted(widest, key=names.index)
    return _plane((first, second), np.column_stack([table[first], table[second]]))


def _plane(names: tuple[str, str], points: Array) -> Plane:
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    span = high - low
    turn = np.array([_full_turn(name) for name in names])
    turn[(span <= FULL_TURN / 2.0) | (span > FULL_TURN)] = np.inf
    # A coordinate that goes round is shown over one full turn.
    around = (FULL_TURN - span) / 2.0
    margin = np.where(span > 0.0, 0.07 * span, 1.0)
    room = np.where(np.isfinite(turn), around, margin)
    return Plane(names, points, turn, np.array([low - room, high + room]))


def _full_turn(name: str) -> float:
    return FULL_TURN if text.split_unit(name)[1] == "deg" else math.inf


def _step(name: str) -> float:
    """What counts as one step of a coordinate, in its own unit: 1 mm, 1 degree."""
    unit = text.split_unit(name)[1]
    if not unit:
        return 1.0
    kind = units.si_unit(unit)
    step = units.factor(STEP_IN_UNIT[kind]) if kind in STEP_IN_UNIT else 1.0
    return units.number(step, unit)


def crosses_edge(plane: Plane, setups: Sequence[str]) -> bool:
    """Whether the path leaves the figure on one side and returns on the other."""
    for k, (setup, following) in enumerate(itertools.pairwise(setups)):
        start, end = plane.at[k], plane.at[k + 1]
        if setup == following and _turn_back(plane, start, end).any():
            return True
    return False


def _turn_back(plane: Plane, start: Array, end: Array) -> Array:
    """Full turns (2,) to take from the end, so that the way from the start is short."""
    far = np.isfinite(plane.turn) & (np.abs(end - start) > plane.turn / 2.0)
    return np.where(far, np.copysign(FULL_TURN, end - start), 0.0)


def _panel(axes: style.Axes, plane: Plane, group: Index, colour: str) -> None:
    look: Any = {"color": colour, "lw": 0.7, "zorder": 1}
    look["alpha"] = 0.55 if len(group) < MANY_POSES else 0.2
    for start, end in itertools.pairwise(plane.at[group]):
        back = _turn_back(plane, start, end)
        axes.plot(*np.array([start, end - back]).T, **look)
        if back.any():  # out on one side, in on the other
            axes.plot(*np.array([start + back, end]).T, **look)
    for k, which in enumerate("xy"):
        getattr(axes, f"set_{which}lim")(*plane.limits[:, k])
        axis = getattr(axes, f"{which}axis")
        if math.isfinite(plane.turn[k]):
            style.ticks_every(axis, plane.turn[k] / 4.0)
        else:
            whole = plane.names[k] == "reading"
            style.few_ticks(axis, 6, steps=[1, 2, 5, 10], integer=whole)


def _numbers_by_place(
    plane: Plane, group: Index
) -> Mapping[tuple[float, float], list[int]]:
    """Numbers of the readings at each place, first and last reading's places first."""
    finite = [int(k) for k in group if np.isfinite(plane.at[k]).all()]
    places = {k: tuple(plane.at[k].round(3).tolist()) for k in finite}
    numbers: dict[tuple[float, float], list[int]] = {
        places[k]: [] for k in [*finite[:1], *finite[-1:], *finite]
    }
    for k in finite:
        numbers[places[k]].append(k + 1)
    return numbers


def write_numbers(
    axes: style.Axes, numbers: Mapping[tuple[float, float], Sequence[int]], colour: str
) -> None:
    """Mark each place and write its numbers; where there is no room, only the mark."""
    points = POINTS_PER_INCH / axes.figure.dpi
    corners = axes.bbox.get_points() * points
    taken: list[tuple[Array, Array]] = []
    for point, readings in numbers.items():
        axes.plot(*point, "o", color=colour, ms=2.4, zorder=2)
        phrase = _joined(readings)
        half = LETTER_SIZE * np.array([FRAME + LETTER * len(phrase), HALF_HEIGHT])
        pixel = np.asarray(axes.transData.transform(point)) * points
        centre = _free_centre(pixel, half, corners, taken)
        if centre is not None:
            taken.append((centre, half))
            _annotate(axes, phrase, point, centre - pixel, colour)


def _joined(readings: Sequence[int]) -> str:
    """1 2 3, or 1 … 9 where they are many."""
    numbers = [str(n) for n in readings]
    if len(numbers) > MAX_NUMBERS:
        numbers = [numbers[0], "…", numbers[-1]]
    return " ".join(numbers)


def _free_centre(
    point: Array, half: Array, corners: Array, taken: Sequence[tuple[Array, Array]]
) -> Array | None:
    """The first centre about a place where a label covers no other, in points."""
    middle = corners.mean(axis=0)
    room = np.ptp(corners, axis=0) / 2.0
    for offset in OFFSETS:
        centre = point + LABEL_DISTANCE * half * offset
        outside = offset.any() and (np.abs(centre - middle) > room).any()
        if not outside and not _covered(centre, half, taken):
            return np.asarray(centre)
    return None


def _covered(centre: Array, half: Array, taken: Sequence[tuple[Array, Array]]) -> bool:
    return any(
        (np.abs(centre - other) < half + other_half).all()
        for other, other_half in taken
    )


def _annotate(
    axes: style.Axes, phrase: str, point: tuple[float, float], shift: Array, colour: str
) -> None:
    frame: Any = {"boxstyle": "round,pad=0.18", "fc": "white", "ec": colour, "lw": 0.7}
    look: Any = {"fontsize": LETTER_SIZE, "annotation_clip": False, "zorder": 3}
    look |= {"ha": "center", "va": "center", "bbox": frame}
    offset: Any = tuple(shift)
    note = axes.annotate(phrase, point, offset, textcoords="offset points", **look)
    note.set_in_layout(False)


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
        TableColumn("Instrument", wide=True),
        TableColumn("Settings", wide=True),
        TableColumn("Noise (1 sigma)", wide=True),
        TableColumn("Unknowns and tolerances", wide=True),
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
        chapter.append(Picture("machine", lambda: draw_machine(drawing), caption))
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
    commands = text.aligned_columns([pose.command for pose in poses])
    channels = text.aligned_columns([pose.reading for pose in poses])
    columns = [
        TableColumn("No.", number=True),
        *TableColumn.texts("Set-up", "Run"),
        *TableColumn.numbers("Order in run"),
        *TableColumn.numbers(*[text.heading(name) for name in commands]),
        *TableColumn.numbers(*[f"{text.heading(name)}, nominal" for name in channels]),
    ]
    cells = [
        [str(k) for k in range(1, len(poses) + 1)],
        [pose.setup for pose in poses],
        [pose.run for pose in poses],
        [str(pose.order) for pose in poses],
        *commands.values(),
        *channels.values(),
    ]
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
        TableColumn("Set-ups", wide=True),
        *TableColumn.numbers("Readings", "Rank", "Cost [min]", "κ"),
        TableColumn("Predicted afterwards", wide=True),
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
        content.append(Picture("path", lambda: draw_path(poses), _path_caption(poses)))
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
    plane = choose_plane(poses)
    if plane is None:
        return sentences[0]
    hidden = [name for name in path_coordinates(poses) if name not in plane.names]
    axes = f"Shown: {_stems(plane.names)}"
    sentences.append(f"{axes} (not shown: {_stems(hidden)})." if hidden else f"{axes}.")
    if crosses_edge(plane, [pose.setup for pose in poses]):
        sentences.append(
            "A path over a full turn leaves the figure on one side and returns on the"
            " other."
        )
    more = len({pose.setup for pose in poses}) - MAX_PANELS
    if more > 0:
        sentences.append(f"{more} more set-ups are not shown.")
    return " ".join(sentences)


def _stems(names: Sequence[str]) -> str:
    return text.listing(text.split_unit(name)[0] for name in names)


# A plan that allows for effects: what it leaves, and what else to record.
def remaining_errors(
    errors: Mapping[str, Mapping[str, float]], keys: Iterable[str], caption: str
) -> Table:
    """Rms errors by title and component with unit (`z_um`), a row a component."""
    columns = [
        TableColumn("Error after compensation, rms", wide=True),
        *TableColumn.numbers(*errors),
    ]
    rows = []
    for key in keys:
        stem, unit = text.split_unit(key)
        cells = [text.quantity(accuracy[key], unit) for accuracy in errors.values()]
        rows.append([stem, *cells])
    return Table(columns, rows, caption)


def recording_blocks(recording: RecordingSection | None) -> list[Block]:
    """A sentence and the table; nothing where no effect depends on a covariate."""
    if recording is None or not recording.choices:
        return []
    keys = list(recording.accuracy)
    columns = [
        TableColumn("Record as well", wide=True),
        TableColumn("Effects that depend on it", wide=True),
        *TableColumn.numbers("error falls by", "worth", *map(_accuracy_heading, keys)),
    ]
    known = _accuracy_values(recording.accuracy, keys)
    rows = [["nothing", "", "", "", *known]]
    for choice in recording.choices:
        cells = [choice.words, ", ".join(choice.effects) or "-"]
        cells += [text.percent(choice.gain), _worth(choice)]
        rows.append([*cells, *_accuracy_values(choice.accuracy, keys)])
    floor = _accuracy_values(recording.floor, keys)
    rows.append(["nothing, with any number of readings", "", "", "", *floor])
    sentence = (
        "What else to record: the predicted error where nothing but poses and readings is"
        " recorded, and what each covariate or choice takes off it. The same covariate must"
        " be known when the machine is used."
    )
    caption = (
        f"Rms errors over the workspace after compensation by {recording.readings}"
        " readings, to first order. Worth: further readings like these that would give the"
        " same without it; floor: no number does."
    )
    return [Paragraph(sentence), Table(columns, rows, caption)]


def _accuracy_heading(key: str) -> str:
    stem, unit = text.split_unit(key)
    return f"{stem}, {unit}"


def _worth(choice: RecordedChoice) -> str:
    if choice.readings is None:
        return "floor"
    return text.count(choice.readings, "reading")


def _accuracy_values(accuracy: dict[str, float], keys: list[str]) -> list[str]:
    return [f"{accuracy[key]:.3g}" if key in accuracy else "-" for key in keys]
