"""Tables of grids: ranges and spaced values of coordinates, and a set-up's poses."""

from typing import Annotated, Final, Literal

import msgspec

from pkm_studies.tables.base import Count, Positive, StudyTable, Triple

# Tables of poses as a user has them: circles, lines and cubes of tool points.

#: poses on a circle
CIRCLE_COUNT = 36
#: points on a line
LINE_COUNT = 11
#: points along an edge of a cube
CUBE_COUNT = 3
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


# Tables of grids: ranges and spaced values of coordinates, and a set-up's poses.


class Span(StudyTable, frozen=True, kw_only=True):
    """Evenly spaced values in the unit of the field.

    As in `{ from = 0, to = 360, count = 12, endpoint = false }`.

    from      first value
    to        last value, or the end that is left out
    count     number of values
    endpoint  whether `to` is one of them
    """

    from_: float = msgspec.field(name="from")
    to: float
    count: Count
    endpoint: bool = True


class Range(StudyTable, frozen=True, kw_only=True):
    """Lowest and highest value, in the unit of the field.

    from  lowest value
    to    highest value
    """

    from_: float = msgspec.field(name="from")
    to: float


class OpenRange(StudyTable, frozen=True, kw_only=True):
    """Lowest value, highest value, or both, as in `{ from = 1200 }`.

    from   lowest value, in the unit of the field
    to     highest value
    """

    from_: float | None = msgspec.field(name="from", default=None)
    to: float | None = None


#: values of one command coordinate: a number, a list, evenly spaced, or led by the
#: instrument
Axis = float | list[float] | Span | Literal["hold"]


class GridTable(StudyTable, frozen=True, kw_only=True):
    """[[design.candidates]]: poses of one set-up, all combinations of coordinate values.

    In place of a grid, one of the other fields gives the poses. Beside a circle, a line
    or a cube, a coordinate has one value, such as an angle of the tool. With no
    coordinate and none of these fields, poses are sampled over the workspace.

    setup      the set-up that reads
    runs_by    coordinate of which each value makes one run
    pairs_mm   pairs of points, the second read against the first
    poses      a list: one value a pose for each coordinate, as in
               `{ x_mm = [0, 50], y_mm = [0, 20], z_mm = [100, 90] }`
    file       a CSV of poses, relative to the study: one column a coordinate, with its
               unit, and a column `run` if there are several
    circle     a circle of tool points
    line       a line of tool points
    cube       tool points that fill a cube
    sample     number of poses spread evenly over the workspace, or over the ranges of
               the coordinates given; those out of reach are left out
    further    coordinates with their unit, as in `z_mm = [1086, 1246]`; `theta = "hold"`
               for the one that the instrument leads
    """

    free_keys = "coordinates"
    setup: str
    runs_by: str | None = None
    pairs_mm: list[tuple[Triple, Triple]] | None = None
    poses: dict[str, list[float]] | None = None
    file: str | None = None
    circle: CircleTable | None = None
    line: LineTable | None = None
    cube: CubeTable | None = None
    sample: Count | None = None
    coordinates: dict[str, Axis] = {}


class ReferenceTable(GridTable, frozen=True, kw_only=True):
    """[[design.reference]]: a plan to compare with, in the fields of candidates.

    name  of the plan; tables of one name make one plan
    """

    free_keys = "coordinates"
    name: str


class KappaTable(StudyTable, frozen=True, kw_only=True):
    """[[kappa]]: map of the condition number over m circles of n points.

    title       above the map
    setup       the set-up that reads
    circles     numbers of circles to try
    points      numbers of points on a circle to try
    coordinate  the coordinate that the instrument leads, if any
    with        a plan of [[design.reference]] whose readings are taken as well
    further     the range that spaces the circles, as in `z_mm = { from = 0, to = 10 }`
    """

    free_keys = "coordinates"
    title: str = ""
    setup: str
    circles: Annotated[list[Count], msgspec.Meta(min_length=1)]
    points: Annotated[list[Count], msgspec.Meta(min_length=1)]
    coordinate: str | None = None
    with_: str | None = msgspec.field(name="with", default=None)
    coordinates: dict[str, Range] = {}
