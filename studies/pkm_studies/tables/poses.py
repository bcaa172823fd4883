"""Tables of poses as a user has them: circles, lines and cubes of tool points."""

from __future__ import annotations

from typing import Annotated, Final, Literal

import msgspec

from pkm_studies.tables.base import Count, Positive, StudyTable, Triple

#: poses on a circle, points on a line, and along an edge of a cube
CIRCLE_COUNT, LINE_COUNT, CUBE_COUNT = 36, 11, 3
#: columns of the first and second axis of a circle's plane
CIRCLE_PLANES: Final = {"xy": (0, 1), "yz": (1, 2), "zx": (2, 0)}


class CircleTable(StudyTable, frozen=True, kw_only=True):
    """A circle of tool points (ISO 230-4), in machine coordinates.

    centre_mm  of the circle
    radius_mm  of the circle
    plane      "xy", "yz" or "zx": the angle runs from the first axis to the second
    direction  "ccw", "cw", seen against the third axis, or "both": one run each
    start_deg  angle of the first point, from the plane's first axis
    arc_deg    how far round it goes
    count      number of points
    """

    centre_mm: Triple
    radius_mm: Positive
    plane: Literal["xy", "yz", "zx"] = "xy"
    direction: Literal["ccw", "cw", "both"] = "ccw"
    start_deg: float = 0.0
    arc_deg: Annotated[float, msgspec.Meta(gt=0, le=720)] = 360.0
    count: Count = CIRCLE_COUNT


class LineTable(StudyTable, frozen=True, kw_only=True):
    """Evenly spaced tool points on a straight line, in machine coordinates.

    from_mm  first point
    to_mm    last point
    count    number of points
    """

    from_mm: Triple
    to_mm: Triple
    count: Annotated[int, msgspec.Meta(ge=2, le=1_000_000)] = LINE_COUNT


class CubeTable(StudyTable, frozen=True, kw_only=True):
    """Tool points that fill a cube evenly, faces included, in machine coordinates.

    centre_mm  of the cube
    side_mm    length of its edges
    count      points along an edge: 3 gives 27
    """

    centre_mm: Triple
    side_mm: Positive
    count: Annotated[int, msgspec.Meta(ge=2, le=58)] = CUBE_COUNT
