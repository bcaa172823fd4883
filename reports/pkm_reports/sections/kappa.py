"""Condition number over circles and points, for each parametrisation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from pkm_reports import style, words
from pkm_reports.blocks import Block, Picture, Table, absent, number_column, transposed
from pkm_reports.figures import kappa

ANCHOR: Final = "kappa"
TITLE: Final = "Condition number over circles and points"
MOST_COLUMNS: Final = 8


def blocks(result: Mapping[str, Any]) -> list[Block]:
    """One figure for all parametrisations, and the numbers behind it."""
    maps = result.get("kappa_maps") or []
    if not maps:
        return absent("A map of the condition number over circles and points")
    drawn = Picture("kappa", lambda: kappa.draw(maps), _caption(maps))
    return [drawn, *_tables(maps)]


def _caption(maps: list[Mapping[str, Any]]) -> str:
    """Where each parametrisation has its smallest kappa."""
    told = [_smallest(entry) for entry in maps]
    text = (
        "Condition number κ of the seen directions; rings mark the smallest of each"
        f" line, and values above {kappa.CUT:.0f} times the smallest leave the"
        " picture. " + " ".join(told)
    )
    if len(maps) > 1:
        text += (
            " κ depends on the parametrisation: compare within a panel, not between"
            " panels."
        )
    return text


def _smallest(entry: Mapping[str, Any]) -> str:
    table = style.array(entry["kappa"]).reshape(
        len(entry["circles"]), len(entry["points"])
    )
    if not np.isfinite(table).any():
        return f"“{entry['title']}”: no finite κ."
    i, j = np.unravel_index(int(np.nanargmin(table)), table.shape)
    m, n = entry["circles"][i], entry["points"][j]
    first = table[0]
    text = (
        f"“{entry['title']}”: smallest κ {words.num(table[i, j], 4)} at m = {m}, n ="
        f" {n} ({m * n} readings)"
    )
    if i and np.isfinite(first).any():
        k = int(np.nanargmin(first))
        text += (
            f"; with m = {entry['circles'][0]} it is {words.num(first[k], 4)} at n ="
            f" {entry['points'][k]}"
        )
    return f"{text}."


def _tables(maps: list[Mapping[str, Any]]) -> list[Table]:
    """One table for all parametrisations where it is not too wide, else one for each."""
    together = all(entry["points"] == maps[0]["points"] for entry in maps)
    if together and sum(len(entry["circles"]) for entry in maps) <= MOST_COLUMNS:
        return [_table(maps)]
    return [_table([entry]) for entry in maps]


def _table(maps: list[Mapping[str, Any]]) -> Table:
    letters = (
        [f"{chr(ord('A') + k)}, " for k in range(len(maps))] if len(maps) > 1 else [""]
    )
    cells, titles = [[str(n) for n in maps[0]["points"]]], ["n"]
    for letter, entry in zip(letters, maps, strict=True):
        titles += [f"{letter}m = {m}" for m in entry["circles"]]
        cells += [[words.num(k, 4) for k in line] for line in entry["kappa"]]
    told = [
        f"{letter.replace(', ', ': ')}{entry['title']}"
        for letter, entry in zip(letters, maps, strict=True)
    ]
    caption = (
        "The condition numbers behind the figure, over points n and circles m."
        f" {'; '.join(told)}."
    )
    return Table(number_column(*titles), transposed(cells), caption)
