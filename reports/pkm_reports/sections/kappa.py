"""Chapter: the condition number over circles and points, for each parametrisation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from oed.result import KappaMap, StudyResult
from pkm_reports import missing, text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Picture,
    Table,
    number_columns,
    transposed,
)
from pkm_reports.sections.figures import kappa

MOST_COLUMNS: Final = 8


def blocks(result: StudyResult) -> list[Block]:
    """One figure for all parametrisations, and the numbers behind it."""
    maps = result.kappa_maps
    if not maps:
        return []
    picture = Picture("kappa", lambda: kappa.draw(maps), _caption(maps))
    return [picture, *_tables(maps)]


def _caption(maps: Sequence[KappaMap]) -> str:
    """Where each parametrisation has its smallest condition number."""
    sentences = [
        "Condition number κ of the determined directions.",
        "Rings mark the smallest of each line; values above"
        f" {kappa.CUT:.0f} times the smallest lie outside the figure.",
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
