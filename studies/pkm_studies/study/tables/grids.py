"""Tables for grids of poses: ranges, spaced values, and a set-up's poses."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from pkm_studies.study.tables.base import (
    Count,
    StudyTable,
    Triple,
)


class Span(StudyTable, frozen=True, kw_only=True):
    """Evenly spaced values, in the unit of the field: `{ from = 0, to = 360, count =
    12, endpoint = false }`.
    """

    from_: float = msgspec.field(name="from")
    to: float
    count: Count
    endpoint: bool = True


class Range(StudyTable, frozen=True, kw_only=True):
    """Lowest and highest value, in the unit of the field."""

    from_: float = msgspec.field(name="from")
    to: float


#: values of one command coordinate: a number, a list, evenly spaced, or held by the
#: instrument
Axis = float | list[float] | Span | Literal["hold"]


class GridTable(StudyTable, frozen=True, kw_only=True):
    """[[design.candidates]]: poses of one set-up, all values of each coordinate
    combined.
    """

    rest = "coordinates"
    setup: str
    runs_by: str | None = None
    pairs_mm: list[tuple[Triple, Triple]] | None = None
    coordinates: dict[str, Axis] = {}


class ReferenceTable(GridTable, frozen=True, kw_only=True):
    """[[design.reference]]: as candidates, but a given plan; tables of one name make
    one plan.
    """

    rest = "coordinates"
    name: str


class KappaTable(StudyTable, frozen=True, kw_only=True):
    """[[kappa]]: condition number over m circles of n points. The range, `z_mm = {
    from, to }`, spaces the circles.
    """

    rest = "coordinates"
    title: str = ""
    setup: str
    circles: Annotated[list[Count], msgspec.Meta(min_length=1)]
    points: Annotated[list[Count], msgspec.Meta(min_length=1)]
    coordinate: str | None = None
    coordinates: dict[str, Range] = {}
