"""Chapter: what planned readings could detect, and runs that tell effects apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from oed import units
from oed.base import Array
from oed.result import (
    ChosenRun,
    ChosenRuns,
    DetectabilityRecord,
    DetectabilityTable,
    RivalRecord,
    SeparationRecord,
    SharedRecord,
    StudyResult,
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
)
from pkm_reports.sections.gap_figures import MIN_VISIBLE_RMS, sizes_by_channel, spoken

# Which effects can be distinguished from which others: a matrix of sqrt(lambda).

LIMIT = 5.0  #: sqrt(lambda) below which two effects are not distinguished
CLEAR = 10.0  #: sqrt(lambda) above which they clearly are
#: colours and legend of: not distinguished, barely, clearly
COLOURS: Final = ("#f3c4a5", "#f7ecc8", "#cfe6dd")
MEANINGS: Final = (
    f"below {LIMIT:g}: not distinguished",
    f"{LIMIT:g} to {CLEAR:g}: barely",
    f"above {CLEAR:g}: distinguished",
)
MAX_CELL = 0.42  #: inches of one cell, at most
SMALL_CELL = 0.34  #: inches of a cell from which its number has normal size
MIN_WHOLE_NUMBER: Final = 9.95  #: size from which a number has no decimal


def draw_confusable(table: DetectabilityTable) -> style.Figure:
    """Effects by those that could explain them; on the diagonal, how well each is seen."""
    from matplotlib.colors import BoundaryNorm, ListedColormap
    from matplotlib.patches import Patch

    names = table.names
    if len(names) < 2:
        return style.empty("Fewer than two effects can be tested with these readings.")
    values = missing.table(table.separation)
    cell = min(MAX_CELL, (style.FIGURE_WIDTH - 1.5) / len(names))
    figure = style.figure(cell * len(names) + 1.75)
    axes = figure.subplots()
    shade: Any = {"cmap": ListedColormap(COLOURS)}
    shade["norm"] = BoundaryNorm([0.0, LIMIT, CLEAR, np.inf], len(COLOURS))
    finite = np.where(np.isfinite(values), values, 0.0)
    axes.imshow(finite, aspect="equal", **shade)
    _write_numbers(axes, values, 7.0 if cell > SMALL_CELL else 6.0)
    _set_labels(axes, [spoken(name) for name in names])
    patches = [
        Patch(color=colour, label=meaning)
        for colour, meaning in zip(COLOURS, MEANINGS, strict=True)
    ]
    figure.legend(handles=patches, loc="outside lower center", ncols=3)
    return figure


def short_label(value: float) -> str:
    """The number of a cell: one decimal below 10, none above."""
    if not np.isfinite(value):
        return text.MISSING
    return f"{value:.1f}" if value < MIN_WHOLE_NUMBER else f"{value:.0f}"


def _write_numbers(axes: style.Axes, values: Array, size: float) -> None:
    """Numbers in the cells; those of the diagonal bold, in a frame."""
    from matplotlib.patches import Rectangle

    letters: Any = {"ha": "center", "va": "center", "fontsize": size}
    for (row, column), value in np.ndenumerate(values):
        weight = "bold" if row == column else "normal"
        number = short_label(value)
        axes.text(column, row, number, color=style.INK, fontweight=weight, **letters)
    for k in range(len(values)):
        frame: Any = {"fill": False, "edgecolor": style.INK, "linewidth": 0.9}
        axes.add_patch(Rectangle((k - 0.5, k - 0.5), 1.0, 1.0, **frame))


def _set_labels(axes: style.Axes, names: Sequence[str]) -> None:
    places = list(range(len(names)))
    style.fixed_ticks(axes, "y", places, names)
    style.fixed_ticks(axes, "x", places, names)
    axes.xaxis.tick_top()
    axes.xaxis.set_label_position("top")
    for label in axes.get_xticklabels():
        label.set(rotation=55, ha="left", rotation_mode="anchor")
    axes.set_xlabel("what else could explain it")
    axes.set_ylabel("effect")
    axes.grid(False)
    axes.tick_params(length=0)
    between = np.arange(len(names) + 1) - 0.5
    axes.set_xticks(between, minor=True)
    axes.set_yticks(between, minor=True)
    axes.grid(True, which="minor", color="white", linewidth=1.2)
    axes.tick_params(which="minor", length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)


# Chapter: what planned readings could detect, and runs that tell effects apart.

MAX_IMITATION_ROWS: Final = 16  #: rows of the table of imitated combinations
#: weight of the detectability in the order of these rows, where separations are equal
TIE_BREAK: Final = 1e-3


def blocks(result: StudyResult) -> list[Block]:
    """Findings, chosen runs, detectable sizes, confusability, untestable effects."""
    before = result.gap_before
    if before is None:
        return []
    findings = Items(text.sentences(before.words), numbered=True)
    chosen, channel_units = before.chosen, before.units
    if chosen is None:
        table = _detectability(
            before.table, channel_units, "these readings", "gap_before"
        )
        return [findings, *table]
    of_chosen = _detectability(
        chosen.table, channel_units, "the chosen runs", "gap_before_chosen"
    )
    of_planned = _detectability(
        before.table, channel_units, "the planned readings", "gap_before"
    )
    return [findings, _runs(chosen), _separations(chosen), *of_chosen, *of_planned]


def printed(result: StudyResult) -> list[Block]:
    """Findings, and the chosen runs."""
    before = result.gap_before
    if before is None:
        return []
    findings = Items(text.sentences(before.words), numbered=True)
    return [findings, *([] if before.chosen is None else [_runs(before.chosen)])]


def _runs(chosen: ChosenRuns) -> Block:
    minutes = [text.number(units.number(run.seconds, "min"), 2) for run in chosen.runs]
    return runs_table(chosen.runs, "Takes [min]", minutes, _runs_caption(chosen))


def _runs_caption(chosen: ChosenRuns) -> str:
    runs = text.count(len(chosen.runs) - chosen.retained, "run")
    caption = f"{runs} chosen out of {chosen.candidates}"
    if chosen.retained:
        caption += f", in addition to {chosen.retained} of the earlier plan"
    minutes = text.number(units.number(chosen.seconds, "min"))
    share = text.percent_at_least(chosen.efficiency)
    verdict = (
        "All plans were tried: none is better."
        if chosen.proven
        else f"At least {share} of the best plan."
    )
    return f"{caption}: {minutes} min with mounting. {verdict}"


def _separations(chosen: ChosenRuns) -> Block:
    columns = [
        TableColumn("Effect", wide=True),
        TableColumn("Told from"),
        *TableColumn.numbers("Before", "Now", "Without the rival"),
    ]
    rows = [
        [
            _form(separation),
            spoken(separation.rival),
            text.number(separation.before),
            text.number(separation.separation),
            text.number(separation.detectability),
        ]
        for separation in chosen.separations
    ]
    marks = [
        "good" if separation.separation >= LIMIT else ""
        for separation in chosen.separations
    ]
    limit = text.trimmed(LIMIT)
    caption = (
        "How well each form of an effect can be distinguished from its rival, in units of the"
        f" noise; {limit} and more is good. Before: with the readings planned without"
        " the choice of runs. No plan has a smallest value above"
        f" {text.number(chosen.bound)}."
    )
    return Table(columns, rows, caption, marks)


def _form(separation: SeparationRecord) -> str:
    name = spoken(separation.effect)
    return name if separation.words == name else f"{name}, {separation.words}"


def _detectability(
    table: DetectabilityTable, channel_units: Mapping[str, str], of: str, name: str
) -> list[Block]:
    """Sizes, confusability and what is imitated, of readings named by `of`."""
    testable = [record for record in table.effects if not record.not_testable]
    testable.sort(key=lambda record: -record.detectability)
    content: list[Block] = []
    if testable:
        caption = (
            f"How well {of} tell effects from one another, in units of the noise:"
            " detectability of the row's effect at its expected size, once the column's"
            " effect of any size may explain it too. Framed: detectability where nothing"
            " else acts."
        )
        content.append(_sizes(testable, table, channel_units, of))
        content.append(Picture(name, lambda: draw_confusable(table), caption))
    return content + _imitated(testable, of) + _untestable(table)


def _sizes(
    testable: Sequence[DetectabilityRecord],
    table: DetectabilityTable,
    channel_units: Mapping[str, str],
    of: str,
) -> Block:
    titles = ("Expected rms", "Absorbed", "Detectability", "Chance", "Smallest rms")
    columns = [
        TableColumn("Effect", wide=True),
        *TableColumn.numbers(*titles),
        TableColumn("Hardest rival", wide=True),
    ]
    rows = [
        [
            spoken(record.name),
            _sizes_by_channel(record.signature, channel_units),
            text.percent(record.absorbed),
            text.number(record.detectability),
            text.percent(record.power),
            _sizes_by_channel(record.median, channel_units),
            _hardest_rival(record),
        ]
        for record in testable
    ]
    marks = ["good" if record.visible else "bad" for record in testable]
    readings = text.count(table.readings, "reading")
    caption = (
        f"What {of} ({readings}) could detect. Absorbed: share that calibration"
        " mistakes for geometry. Detectability: what remains, in units of the noise. Chance: of"
        " detection at 1 % false alarm. Smallest rms: size that is detected 9 times in"
        " 10, typically. Hardest rival: the effect that explains most of it, and the"
        " detectability that then remains. The noise is that stated in the study."
    )
    return Table(columns, rows, caption, marks)


def _hardest_rival(record: DetectabilityRecord) -> str:
    if not record.rivals:
        return text.MISSING
    rival = record.rivals[0]
    return f"{spoken(rival.name)} ({short_label(rival.separation)})"


def _sizes_by_channel(
    sizes: Mapping[str, float | None], channel_units: Mapping[str, str]
) -> str:
    """Rms by channel; one channel alone needs no name."""
    visible = [rms for rms in sizes.values() if rms is None or rms > MIN_VISIBLE_RMS]
    return sizes_by_channel(sizes, channel_units, named=len(visible) > 1)


#: an effect, its rival, and a combination of coefficients that the rival imitates
Imitation = tuple[DetectabilityRecord, RivalRecord, SharedRecord]


def _imitated(testable: Sequence[DetectabilityRecord], of: str) -> list[Block]:
    imitations = [
        (record, rival, shared)
        for record in testable
        for rival in record.rivals
        for shared in rival.shared
    ]
    if not imitations:
        return []
    imitations.sort(key=_nearness)
    shown = imitations[:MAX_IMITATION_ROWS]
    columns = [
        TableColumn("Effect"),
        TableColumn("Coefficients", wide=True),
        TableColumn("Imitated by"),
        *TableColumn.numbers("Alone", "With the rival"),
    ]
    rows = [
        [
            spoken(record.name),
            shared.words,
            spoken(rival.name),
            text.number(shared.detectability, 2),
            text.number(shared.separation, 2),
        ]
        for record, rival, shared in shown
    ]
    caption = (
        f"Forms of an effect that {of} could detect, but not tell from another effect:"
        " detectability alone, and with the rival."
    )
    if len(imitations) > len(shown):
        caption += f" The {len(shown)} nearest of {len(imitations)}."
    return [Table(columns, rows, caption)]


def _nearness(imitation: Imitation) -> float:
    """Sorts combinations that the rival imitates best to the front."""
    shared = imitation[2]
    return shared.separation - TIE_BREAK * shared.detectability


def _untestable(table: DetectabilityTable) -> list[Block]:
    reasons = [
        text.sentence(f"{spoken(record.name).capitalize()}: {record.not_testable}")
        for record in table.effects
        if record.not_testable
    ]
    return headed_list("Effects that could not be tested:", reasons)


CHAPTER: Final = Chapter(
    "gap-before", "What these readings could detect", blocks, printed
)


# Chapter: a second visit, and what its readings are expected to decide.
def visit_blocks(result: StudyResult) -> list[Block]:
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
        runs_table(visit.runs, "Poses", poses, f"{caption}."),
    ]


VISIT_CHAPTER: Final = Chapter(
    "second_visit", "A second visit", visit_blocks, visit_blocks
)

# Table of runs to take, each under its condition.

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


def runs_table(
    runs: Sequence[ChosenRun], title: str, cells: Sequence[str], caption: str
) -> Table:
    """Set-up, run and conditions of each run, and a further column of a title."""
    conditions = [
        name for name in CONDITIONS if any(name in run.condition for run in runs)
    ]
    titles = [CONDITIONS[name][0] for name in conditions]
    columns = [
        TableColumn("Set-up"),
        TableColumn("Run", wide=True),
        *TableColumn.numbers(*titles, title),
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
