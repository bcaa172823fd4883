"""Chapter: the condition number over circles and points, for each parametrisation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from oed.base import Array
from oed.result import KappaMap, StudyResult
from pkm_reports import missing, style, text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Picture,
    Table,
    number_columns,
    transposed,
)

# Condition number over the number of circles and of points on each circle.

#: kappa above so many times the smallest leaves the panel, so that the minimum shows
CUT: Final = 30.0


def draw_kappa(maps: Sequence[KappaMap]) -> Figure:
    """A panel for each parametrisation, a line over n for each number of circles m.

    A ring marks the smallest of each line.
    """
    shown = [entry for entry in maps if np.isfinite(missing.table(entry.kappa)).any()]
    if not shown:
        return style.empty("No finite condition number is stored in this result.")
    columns = min(2, len(shown))
    rows = math.ceil(len(shown) / columns)
    figure = style.figure(0.3 + 2.9 * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, entry in zip(grid, shown, strict=False):
        _panel(axes, entry)
    style.hide(grid[len(shown) :])
    return figure


def _panel(axes: Axes, entry: KappaMap) -> None:
    n = missing.array(entry.points)
    table = missing.table(entry.kappa)
    for k, (m, kappa) in enumerate(zip(entry.circles, table, strict=True)):
        colour = style.CYCLE[k % len(style.CYCLE)]
        label = f"m = {m}: {_smallest_of_line(n, kappa)}"
        axes.plot(
            n,
            kappa,
            marker=style.marker(k),
            ms=3,
            color=colour,
            label=label,
        )
        if np.isfinite(kappa).any():
            smallest = int(np.nanargmin(kappa))
            ring: Any = {
                "ms": 9,
                "mfc": "none",
                "mec": colour,
                "mew": 1.2,
            }
            axes.plot(n[smallest], kappa[smallest], "o", **ring)
    low, high = float(np.nanmin(table)), float(np.nanmax(table))
    axes.set_ylim(0.8 * low, min(CUT * low, 1.25 * high))
    style.log_axis(axes, "y")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
    axes.set(xlabel="points on each circle, n", ylabel="condition number κ")
    axes.set_title(style.label(entry.title, 44))
    legend: Any = {"loc": "upper center", "bbox_to_anchor": (0.48, -0.2)}
    axes.legend(ncols=2, handlelength=1.6, columnspacing=1.2, **legend)


def _smallest_of_line(n: Array, kappa: Array) -> str:
    """Smallest value of a line and where it is."""
    if not np.isfinite(kappa).any():
        return "not finite"
    smallest = int(np.nanargmin(kappa))
    return f"{text.number(kappa[smallest], 4)} at n = {n[smallest]:.0f}"


MOST_COLUMNS: Final = 8


def blocks(result: StudyResult) -> list[Block]:
    """One figure for all parametrisations, and the numbers behind it."""
    maps = result.kappa_maps
    if not maps:
        return []
    picture = Picture("kappa", lambda: draw_kappa(maps), _caption(maps))
    return [picture, *_tables(maps)]


def _caption(maps: Sequence[KappaMap]) -> str:
    """Where each parametrisation has its smallest condition number."""
    sentences = [
        "Condition number κ of the determined directions.",
        "Rings mark the smallest of each line; values above"
        f" {CUT:.0f} times the smallest lie outside the figure.",
        *[_smallest(entry) for entry in maps],
    ]
    if len(maps) > 1:
        sentences.append(
            "κ depends on the parametrisation: compare within a panel, not between"
            " panels."
        )
    return " ".join(sentences)


def _smallest(entry: KappaMap) -> str:
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


def _tables(maps: Sequence[KappaMap]) -> list[Table]:
    """One table for all parametrisations where it is narrow enough, else one for each."""
    same_points = all(entry.points == maps[0].points for entry in maps)
    width = sum(len(entry.circles) for entry in maps)
    if same_points and width <= MOST_COLUMNS:
        return [_table(maps)]
    return [_table([entry]) for entry in maps]


def _table(maps: Sequence[KappaMap]) -> Table:
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
    return Table(number_columns(*titles), transposed(cells), caption)


CHAPTER: Final = Chapter("kappa", "Condition number over circles and points", blocks)
