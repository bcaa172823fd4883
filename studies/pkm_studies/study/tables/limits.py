"""Tables for [design.limits]: joint travel, cones and obstacles."""

from __future__ import annotations

from pkm_studies.study.tables.base import (
    NotNegative,
    Positive,
    StudyTable,
    Triple,
)
from pkm_studies.study.tables.grids import Range


class ConeTable(StudyTable, frozen=True, kw_only=True):
    """Directions within `half_angle_deg` of `axis` (any length)."""

    axis: Triple
    half_angle_deg: Positive


class SphereTable(StudyTable, frozen=True, kw_only=True):
    """An obstacle: a sphere in the base frame."""

    at_mm: Triple
    radius_mm: Positive


class RodTable(StudyTable, frozen=True, kw_only=True):
    """An obstacle: all points within `radius_mm` of a straight line, in the base frame."""

    from_mm: Triple
    to_mm: Triple
    radius_mm: Positive


class LimitsTable(StudyTable, frozen=True, kw_only=True):
    """[design.limits]: candidates that break one are left out, and counted. What is not
    given is not asked.

    joints         travel of joints by name and unit, `{ q1_mm = { from = 350, to = 800
                   } }`, within the machine's own
    singularity    least reciprocal condition number of the closure's slopes over the
                   pose, between 0 and 1
    travel_mm      by how much a held reading may differ from what the instrument holds
                   (a ball bar's travel)
    travel_chance  least probability that it stays within the travel on a machine with
                   errors of the size of its tolerances; needs `travel_mm`
    cup_cone       where the line from the cup to the tool point may point, in the base
                   frame
    tool_cone      where the line from the tool point to the cup may point, in the
                   platform's frame
    spheres, rods  obstacles; they need `links_mm` or `bar_mm`
    links_mm       radius of the machine's links;  bar_mm of the bar from cup to tool
                   point
    margin_mm      clearance to keep;  ignore: numbers, from 0, of the skeleton's lines
                   that are not looked at

    travel goes for instruments that hold a reading, cones and bar for those whose other
    end has a place.
    """

    joints: dict[str, Range] = {}
    singularity: Positive | None = None
    travel_mm: NotNegative | None = None
    travel_chance: Positive | None = None
    cup_cone: ConeTable | None = None
    tool_cone: ConeTable | None = None
    spheres: list[SphereTable] = []
    rods: list[RodTable] = []
    links_mm: Positive | None = None
    bar_mm: Positive | None = None
    margin_mm: NotNegative = 0.0
    ignore: list[int] = []
