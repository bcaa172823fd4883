"""Where the gap shows: legs, runs, times, directions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from oed.result import GapSection, PlaceRecord
from pkm_reports import text
from pkm_reports.blocks import Block, Table, number_columns, wide_column
from pkm_reports.missing import or_nan

MOST: Final = 8
#: p-value below which a place stands out from noise
SIGNIFICANT: Final = 0.05
#: p-values below which only "less than" is written
SMALLEST_P: Final = 1e-3
#: share by which what two legs explain may differ where they cannot be told apart
SAME: Final = 1e-6


def blocks(gap: GapSection) -> list[Block]:
    """Places with their p-value and their share of the gap."""
    places = gap.where[:MOST]
    if not places or gap.verdict == "none":
        return []
    columns = [
        wide_column("Where"),
        *number_columns("p-value", "Share of the gap"),
    ]
    rows = [
        [_name(p.block), _p_value(p.p_value), text.percent(p.strength)] for p in places
    ]
    caption = (
        "Where the gap shows, first the place that confines it best. The p-value is the chance that"
        " noise alone stands out as much there, corrected for the number of places"
        " examined. The share is the part of the gap that lies there. One gap shows in"
        " several places at once."
    )
    legs = tied_legs(places)
    if legs:
        caption += (
            f" The readings of {' and '.join(legs)} are the same, so nothing tells which"
            " of them it is."
        )
    marks = ["chosen" if is_significant(place) else "" for place in places]
    return [Table(columns, rows, caption, marks)]


def is_significant(place: PlaceRecord) -> bool:
    """Whether a place stands out from noise."""
    return place.p_value < SIGNIFICANT


def tied_legs(places: Sequence[PlaceRecord]) -> list[str]:
    """Legs that explain exactly as much as the first leg, where that is significant."""
    legs = [p for p in places if p.block.startswith("leg ") and is_significant(p)]
    if not legs:
        return []
    size = or_nan(legs[0].strength)
    same = [p.block for p in legs if abs(or_nan(p.strength) - size) < SAME * size]
    return same if len(same) > 1 else []


def _name(block: str) -> str:
    kind, _, where = block.partition(" ")
    if kind == "time":
        return f"time {where} s"
    if kind == "phase":
        return f"part of each run, {where}°"
    return block


def _p_value(p: float) -> str:
    return "< 0.001" if p < SMALLEST_P else text.number(p, 2)
