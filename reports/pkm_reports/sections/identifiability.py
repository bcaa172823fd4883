"""Chapter: what the readings determine: singular values, verdicts, variants."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from oed.base import Array
from oed.design import CRITERIA
from oed.result import (
    IdentifiabilityFinding,
    IdentifiabilitySection,
    KappaMap,
    StudyResult,
)
from pkm_reports import missing, style, text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    transposed,
)


# Singular values of the scaled identification matrix, and the tolerance of the rank.
def draw_singular_values(section: IdentifiabilitySection) -> style.Figure:
    """Filled marks for determined directions, hollow ones for lost directions."""
    values = missing.array(section.singular_values)
    largest = float(np.nanmax(values, initial=0.0))
    if not largest > 0.0:
        return style.empty("No singular values are stored in this result.")
    rank = section.rank
    n = max(section.n, len(values))
    limit = section.tolerance * largest
    determined = np.arange(1, len(values) + 1) <= rank
    # Round-off says nothing: all zeros stand on one line, a little below the tolerance.
    smallest = float(np.nanmin(values[determined], initial=np.inf))
    floor = min(limit, smallest) / 8.0
    figure = style.figure(2.6)
    axes = figure.subplots()
    line: Any = {"color": style.BLUE, "lw": 0.8, "label": f"determined: {rank}"}
    axes.plot(np.flatnonzero(determined) + 1, values[determined], "o-", **line)
    lost = np.arange(rank, n) + 1
    if len(lost):
        hollow: Any = {"mfc": "white", "mec": style.RED}
        label = f"lost (zero): {len(lost)}"
        axes.plot(lost, np.full(len(lost), floor), "v", label=label, **hollow)
    label = f"tolerance {text.number(limit, 2)}"
    axes.axhline(limit, ls="--", lw=0.9, color=style.GREY, label=label)
    axes.set_ylim(floor / 4.0, 6.0 * largest)
    style.log_axis(axes, "y")
    axes.set_xlabel("direction in parameter space, best determined first")
    axes.set_ylabel("singular value")
    axes.set_xlim(0.3, n + 0.7)
    style.few_ticks(axes.xaxis, 14, integer=True)
    axes.set_title(f"Rank {section.rank} of {section.n}")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.22), ncols=3)
    return figure


#: lost directions of a variant beyond which they are counted, not described
MAX_DESCRIBED_DIRECTIONS: Final = 8
#: verdict and mark of each kind of finding
VERDICTS: Final = {
    "seen": ("determined", "good"),
    "combination": ("only in combination", ""),
    "weak": ("weakly determined", "chosen"),
    "lost": ("lost", "bad"),
}


def blocks(result: StudyResult) -> list[Block]:
    """Singular values and verdicts of the plan, then the variants of the study."""
    section, variants = result.identifiability, result.identifiability_of
    chapter = [] if section is None else _plan(section)
    if variants:
        chapter.append(_variants(variants, section))
    if section is not None and section.indices:
        chapter.append(_indices(section, variants))
    return chapter


def _plan(section: IdentifiabilitySection) -> list[Block]:
    caption = _caption(section)
    chapter: list[Block] = [
        Paragraph(_verdict(section)),
        Picture("singular", lambda: draw_singular_values(section), caption),
    ]
    if section.words:
        chapter.append(_findings(section.words))
    # A parameter that is determined alone stands in the table of verdicts.
    combinations = [terms for terms in section.combinations if len(terms) > 1]
    chapter += _directions(
        "Determined only in combination", combinations, "combination"
    )
    return chapter + _directions("Lost directions", section.lost, "direction")


def lost_count(section: IdentifiabilitySection) -> int:
    """Number of directions that the readings leave as they were."""
    return section.n - section.rank


def condition(section: IdentifiabilitySection) -> float:
    """Largest over smallest non-zero singular value."""
    nonzero = section.singular_values[: section.rank]
    if not nonzero or not nonzero[-1] > 0.0:
        return math.nan
    return nonzero[0] / nonzero[-1]


def _verdict(section: IdentifiabilitySection) -> str:
    directions = text.count(section.n, "parameter direction")
    verdict = f"The readings determine {section.rank} of {directions}"
    match lost_count(section):
        case 0:
            verdict += ": nothing is lost"
        case 1:
            verdict += "; 1 direction is lost and keeps its tolerance"
        case lost:
            verdict += f"; {lost} directions are lost and keep their tolerance"
    return f"{verdict}. Scaling: {section.scaling}."


def _caption(section: IdentifiabilitySection) -> str:
    opening = "Singular values of the scaled identification matrix:"
    values, rank = section.singular_values, section.rank
    if not rank:
        return f"{opening} none stands above the tolerance."
    high, low = text.number(values[0]), text.number(values[rank - 1])
    caption = (
        f"{opening} {high} down to {low} over the {rank} determined directions"
        f" (condition number {text.number(condition(section), 4)})."
    )
    lost = lost_count(section)
    if not lost:
        return f"{caption} All stand above the tolerance (dashed)."
    largest = max(values[rank:], default=0.0)
    size = "exactly zero"
    if largest > 0.0:
        subject = "it" if lost == 1 else "the largest"
        size = f"{subject} is {text.number(largest, 2)} before it is set to zero"
    others = "The other one lies" if lost == 1 else f"The other {lost} lie"
    return f"{caption} {others} below the tolerance (dashed): {size}."


def _findings(findings: Sequence[IdentifiabilityFinding]) -> Table:
    columns = [
        TableColumn("Verdict"),
        TableColumn("What", wide=True),
        TableColumn("What would determine it", wide=True),
    ]
    rows, marks = [], []
    for finding in findings:
        verdict, mark = VERDICTS.get(finding.kind, (finding.kind, ""))
        remedies = "; ".join(finding.remedies) or text.MISSING
        rows.append([verdict, text.sentence(finding.text), remedies])
        marks.append(mark)
    return Table(columns, rows, "Identifiability by groups of parameters.", marks)


def _directions(
    title: str, directions: Sequence[Mapping[str, float]], noun: str
) -> list[Block]:
    if not directions:
        return []
    columns = [
        TableColumn(noun.capitalize(), number=True),
        TableColumn("Coefficients of the parameters (SI units)", wide=True),
    ]
    rows = [
        [str(k), text.linear_combination(terms)]
        for k, terms in enumerate(directions, 1)
    ]
    count = text.count(len(directions), noun)
    return [Table(columns, rows, f"{title}: {count}, the largest terms first.")]


def _variants(
    variants: Mapping[str, IdentifiabilitySection], plan: IdentifiabilitySection | None
) -> Table:
    entries = dict(variants)
    if plan is not None:
        entries = {"this plan": plan, **variants}
    sections = list(entries.values())
    columns = [
        TableColumn("Variant"),
        *TableColumn.numbers("Rank", "Lost", "κ"),
        TableColumn("What is lost", wide=True),
    ]
    cells = [
        list(entries),
        [f"{section.rank} of {section.n}" for section in sections],
        [str(lost_count(section)) for section in sections],
        [text.number(condition(section), 4) for section in sections],
        [_lost(section) for section in sections],
    ]
    best = min(variants, key=lambda name: lost_count(variants[name]))
    fewest = lost_count(variants[best])
    caption = (
        "What other arrangements would determine."
        f" “{best}” loses the fewest directions: {fewest}."
    )
    marks = ["chosen" if section is plan else "" for section in sections]
    return Table(columns, transposed(cells), caption, marks)


def _lost(section: IdentifiabilitySection) -> str:
    """What is lost, in words where it has a name; result.json lists all directions."""
    lost = lost_count(section)
    if lost > MAX_DESCRIBED_DIRECTIONS:
        return (
            f"{lost} directions: these readings alone are far too few, or too much"
            " alike."
        )
    described = [finding.text for finding in section.words if finding.kind == "lost"]
    if described:
        return " ".join(text.sentences(described))
    if not lost:
        return text.MISSING
    return "; ".join(text.linear_combination(terms) for terms in section.lost)


def _indices(
    section: IdentifiabilitySection, variants: Mapping[str, IdentifiabilitySection]
) -> Table:
    """The indices that the study asks for: of its readings, and of the variants."""
    entries = {"this plan": section, **variants}
    symbols = [CRITERIA.symbol(name) for name in section.indices]
    rows = [
        [plan, str(one.rank), *_values(one, section.indices)]
        for plan, one in entries.items()
    ]
    columns = [TableColumn("Readings"), *TableColumn.numbers("Rank", *symbols)]
    sentences = " ".join(map(text.sentence, CRITERIA.sentences(section.indices)))
    caption = (
        "Indices of the identification matrix over the directions that each determines;"
        f" compare plans of equal rank. Of this plan: {sentences}"
    )
    return Table(columns, rows, caption)


def _values(section: IdentifiabilitySection, names: Iterable[str]) -> list[str]:
    return [text.number(missing.entry(section.indices, name), 4) for name in names]


CHAPTER: Final = Chapter("identifiability", "What the readings can determine", blocks)

# Condition number over the number of circles and of points on each circle.

#: kappa above so many times the smallest leaves the panel, so that the minimum shows
MAX_KAPPA_RATIO: Final = 30.0


def draw_kappa(maps: Sequence[KappaMap]) -> style.Figure:
    """A panel a parametrisation, a line over n a number of circles, rings at the least."""
    shown = [entry for entry in maps if np.isfinite(missing.table(entry.kappa)).any()]
    if not shown:
        return style.empty("No finite condition number is stored in this result.")
    columns = min(2, len(shown))
    rows = math.ceil(len(shown) / columns)
    figure = style.figure(0.3 + 2.9 * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, entry in zip(grid, shown, strict=False):
        _kappa_panel(axes, entry)
    style.hide(grid[len(shown) :])
    return figure


def _kappa_panel(axes: style.Axes, entry: KappaMap) -> None:
    n = missing.array(entry.points)
    table = missing.table(entry.kappa)
    for k, (m, kappa) in enumerate(zip(entry.circles, table, strict=True)):
        colour = style.CYCLE[k % len(style.CYCLE)]
        label = f"m = {m}: {_smallest_of_line(n, kappa)}"
        axes.plot(n, kappa, marker=style.marker(k), ms=3, color=colour, label=label)
        if np.isfinite(kappa).any():
            smallest = int(np.nanargmin(kappa))
            ring: Any = {"ms": 9, "mfc": "none", "mec": colour, "mew": 1.2}
            axes.plot(n[smallest], kappa[smallest], "o", **ring)
    low, high = float(np.nanmin(table)), float(np.nanmax(table))
    axes.set_ylim(0.8 * low, min(MAX_KAPPA_RATIO * low, 1.25 * high))
    style.log_axis(axes, "y")
    style.few_ticks(axes.xaxis, 8, integer=True)
    axes.set(xlabel="points on each circle, n", ylabel="condition number κ")
    axes.set_title(style.label(entry.title, 44))
    legend: Any = {"loc": "upper center", "bbox_to_anchor": (0.48, -0.2)}
    axes.legend(ncols=2, handlelength=1.6, columnspacing=1.2, **legend)


def _smallest_of_line(n: Array, kappa: Array) -> str:
    if not np.isfinite(kappa).any():
        return "not finite"
    smallest = int(np.nanargmin(kappa))
    return f"{text.number(kappa[smallest], 4)} at n = {n[smallest]:.0f}"


# Chapter: the condition number over circles and points, for each parametrisation.

MAX_COLUMNS: Final = 8


def kappa_blocks(result: StudyResult) -> list[Block]:
    """One figure for all parametrisations, and the numbers behind it."""
    maps = result.kappa_maps
    if not maps:
        return []
    picture = Picture("kappa", lambda: draw_kappa(maps), _kappa_caption(maps))
    return [picture, *_kappa_tables(maps)]


def _kappa_caption(maps: Sequence[KappaMap]) -> str:
    """Where each parametrisation has its smallest condition number."""
    sentences = [
        "Condition number κ of the determined directions.",
        "Rings mark the smallest of each line; values above"
        f" {MAX_KAPPA_RATIO:.0f} times the smallest lie outside the figure.",
        *[_smallest_kappa(entry) for entry in maps],
    ]
    if len(maps) > 1:
        sentences.append(
            "κ depends on the parametrisation: compare within a panel, not between"
            " panels."
        )
    return " ".join(sentences)


def _smallest_kappa(entry: KappaMap) -> str:
    table = missing.table(entry.kappa)
    if not np.isfinite(table).any():
        return f"“{entry.title}”: no finite κ."
    i, j = np.unravel_index(int(np.nanargmin(table)), table.shape)
    m, n = entry.circles[i], entry.points[j]
    sentence = (
        f"“{entry.title}”: smallest κ {text.number(table[i, j], 4)} at m = {m}, n = {n}"
        f" ({m * n} readings)"
    )
    first = table[0]
    if i and np.isfinite(first).any():
        k = int(np.nanargmin(first))
        sentence += (
            f"; with m = {entry.circles[0]} it is {text.number(first[k], 4)} at n ="
            f" {entry.points[k]}"
        )
    return f"{sentence}."


def _kappa_tables(maps: Sequence[KappaMap]) -> list[Table]:
    """One table for all parametrisations where it is narrow enough, else one for each."""
    same_points = all(entry.points == maps[0].points for entry in maps)
    width = sum(len(entry.circles) for entry in maps)
    if same_points and width <= MAX_COLUMNS:
        return [_kappa_table(maps)]
    return [_kappa_table([entry]) for entry in maps]


def _kappa_table(maps: Sequence[KappaMap]) -> Table:
    letters = [chr(ord("A") + k) for k in range(len(maps))]
    titles, cells = ["n"], [[str(n) for n in maps[0].points]]
    meanings = []
    for letter, entry in zip(letters, maps, strict=True):
        several = len(maps) > 1
        titles += [
            f"{letter}, m = {m}" if several else f"m = {m}" for m in entry.circles
        ]
        cells += [[text.number(k, 4) for k in line] for line in entry.kappa]
        meanings.append(f"{letter}: {entry.title}" if several else entry.title)
    caption = (
        "The condition numbers behind the figure, over points n and circles m."
        f" {'; '.join(meanings)}."
    )
    return Table(TableColumn.numbers(*titles), transposed(cells), caption)


KAPPA_CHAPTER: Final = Chapter(
    "kappa", "Condition number over circles and points", kappa_blocks
)
