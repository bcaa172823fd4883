"""Where the gap lies: legs, set-ups, runs, times, directions."""

from __future__ import annotations

from typing import Final

from oed.result import GapSection, PlaceRecord
from pkm_reports.page import text
from pkm_reports.page.blocks import Block, Table, number_columns, wide_column

MOST: Final = 8
#: probability of an even share below which a place stands out
SIGNIFICANT: Final = 0.05


def blocks(gap: GapSection) -> list[Block]:
    """Places with their share of the gap."""
    places = gap.where[:MOST]
    if not places or not gap.effect_reported:
        return []
    columns = [
        wide_column("Where"),
        *number_columns("Share of the gap", "Chance of no more than an even share"),
    ]
    rows = [
        [_place(p), text.percent(p.strength), text.number(p.p_value, 2)] for p in places
    ]
    caption = (
        "Where the gap lies, first the place that confines it best. The share is the"
        " posterior mean of the part of the gap's energy, as calibration leaves it, that"
        " lies there; of a stretch of time, or a direction, as it acts. A time is a place"
        " only of what varies with time, a set-up of what belongs to set-ups; directions"
        " are compared at the same poses. The last column is the posterior probability"
        " that the place holds no more than it would if the gap were spread evenly over"
        " all legs, or all readings. One gap lies in several places at once."
    )
    marks = ["chosen" if is_significant(place) else "" for place in places]
    return [Table(columns, rows, caption, marks)]


def is_significant(place: PlaceRecord) -> bool:
    """Whether a place stands out."""
    return place.p_value < SIGNIFICANT


def _place(place: PlaceRecord) -> str:
    """A place, and the one of another kind that has the same readings."""
    name = _name(place.block)
    return f"{name} (the same as {_name(place.same_as)})" if place.same_as else name


def _name(block: str) -> str:
    kind, _, where = block.partition(" ")
    if kind == "time":
        return f"time {where} s"
    if kind == "phase":
        return f"part of each run, {where}°"
    return block
