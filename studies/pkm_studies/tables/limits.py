"""Tables of [design.limits]: joint travel, singularity, cones and obstacles."""

from __future__ import annotations

from pkm_studies.tables.base import NotNegative, Positive, StudyTable, Triple
from pkm_studies.tables.grids import Range


class ConeTable(StudyTable, frozen=True, kw_only=True):
    """Directions within a cone.

    axis            of the cone, of any length
    half_angle_deg  largest angle from the axis
    """

    axis: Triple
    half_angle_deg: Positive


class SphereTable(StudyTable, frozen=True, kw_only=True):
    """An obstacle: a sphere.

    at_mm      centre, base frame
    radius_mm  of the sphere
    """

    at_mm: Triple
    radius_mm: Positive


class RodTable(StudyTable, frozen=True, kw_only=True):
    """An obstacle: all points near a line segment.

    from_mm    one end of the segment, base frame
    to_mm      the other end
    radius_mm  distance from the segment within which the obstacle is
    """

    from_mm: Triple
    to_mm: Triple
    radius_mm: Positive


class LimitsTable(StudyTable, frozen=True, kw_only=True):
    """[design.limits]: candidates outside a limit are left out, and counted.

    joints         travel of joints, `{ q1_mm = { from = 350, to = 800 } }`, within that
                   of the machine
    singularity    least reciprocal condition number of the closure's slopes over the
                   pose, between 0 and 1
    travel_mm      largest difference of a held reading from what the instrument holds,
                   such as a ball bar's travel
    travel_chance  least probability that it stays within the travel on a machine with
                   errors of the size of its tolerances; needs `travel_mm`
    cup_cone       directions from the cup to the tool point, in the base frame
    tool_cone      directions from the tool point to the cup, in the platform's frame
    spheres        obstacles; they need `links_mm` or `bar_mm`
    rods           obstacles likewise
    links_mm       radius of the machine's links
    bar_mm         radius of the bar from cup to tool point
    margin_mm      clearance to keep
    ignore         numbers, from 0, of lines of the machine's skeleton that may touch

    Travel applies to instruments that hold a reading; cones and bar to those whose other
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
