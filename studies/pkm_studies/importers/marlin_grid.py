"""Marlin: the bilinear grid that G29 and M420 V print, as heights of a mesh.

The grid has a number for each column (x) and row (y), and no places: G29 L R F B, or lines
mesh_x_mm and mesh_y_mm that a user adds, say where it is. Nodes that a delta cannot probe
are extrapolated from others; they lie outside the circle through the middles of the
sides, unless a line mesh_radius_mm says another radius.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from oed.base.arrays import Array
from pkm_studies.importers import gcode
from pkm_studies.importers.bed_mesh import ROUNDING, BedMesh
from pkm_studies.importers.gcode import TextLine
from pkm_studies.importers.probed_point import ProbedPoint

HEADING: Final = re.compile(r"Bilinear Leveling Grid:")
#: a row of the grid, after what a host writes before it
ROW: Final = re.compile(r"(?:^|[\s:<>])(\d+)((?:\s+(?:[-+]\d*\.\d+|=+|nan))+)\s*$")
#: the beginning of a row, whatever follows
ROW_NUMBER: Final = re.compile(r"(?:^|[\s:<>])(\d+)\s+[-+=n.\d]")
NOT_PROBED: Final = "=nN"
#: words of G29 for the ends of the grid along x and y
ENDS: Final = {"mesh_x_mm": ("L", "R"), "mesh_y_mm": ("F", "B")}
NO_ROW: Final = "this row of the grid does not follow those above"
WHERE: Final = (
    "The grid of G29 (line {line}) is not read: add lines mesh_x_mm = from, to and mesh_y_mm"
    " = from, to with the places of its first and last nodes, and mesh_radius_mm where it"
    " was not probed on the whole circle between them."
)
TWICE: Final = "The grid of G29 (line {line}) is not read: its heights are among the readings already."
OUTSIDE: Final = "outside the circle that was probed, where the firmware extrapolates, or without a height"


def grids(
    lines: Sequence[TextLine],
    given: Mapping[str, tuple[float, ...]],
    offset: tuple[float, float],
    contacts: Sequence[ProbedPoint],
) -> tuple[list[BedMesh], list[str]]:
    """The last grid of a log, if any; and sentences. Raises InputError.

    given     numbers of lines that a user added
    offset    of the probe from the nozzle, mm
    contacts  that the log has as well
    """
    starts = [k for k, line in enumerate(lines) if HEADING.search(line.text)]
    if not starts:
        return [], []
    at = starts[-1]
    heights = _heights(lines[at + 1 :], lines[at])
    ends = [_ends(name, lines[:at], given) for name in ENDS]
    if None in ends:
        return [], [WHERE.format(line=lines[at].number)]
    count_y, count_x = heights.shape
    (x_ends, y_ends) = (end for end in ends if end is not None)
    x, y = np.linspace(*x_ends, count_x), np.linspace(*y_ends, count_y)
    middle = np.array([x.mean(), y.mean()])
    reach = given.get("mesh_radius_mm", (min(np.ptp(x), np.ptp(y)) / 2.0,))[0]
    points = [
        ProbedPoint(float(px) - offset[0], float(py) - offset[1], float(z))
        for py, row in zip(y, heights, strict=True)
        for px, z in zip(x, row, strict=True)
        if math.isfinite(z)
        and math.hypot(px - middle[0], py - middle[1]) <= reach + ROUNDING
    ]
    if _share_among(points, contacts) > 0.5:
        return [], [TWICE.format(line=lines[at].number)]
    mesh = BedMesh("G29", tuple(points), heights.size - len(points), OUTSIDE)
    notes = []
    if len(starts) > 1:
        notes.append(f"Not read: {len(starts) - 1} earlier grids of G29.")
    return [mesh], notes


def _heights(lines: Sequence[TextLine], heading: TextLine) -> Array:
    """Heights (ny, nx), mm; NaN of nodes without one. Raises InputError."""
    rows: list[list[float]] = []
    for line in lines:
        match = ROW.search(line.text)
        if match is None:
            begun = ROW_NUMBER.search(line.text)
            if begun and rows and int(begun[1]) == len(rows):
                raise line.error(NO_ROW, "give the grid as printed")
            if rows:
                break
            continue
        cells = match[2].split()
        if int(match[1]) != len(rows) or (rows and len(cells) != len(rows[0])):
            raise line.error(NO_ROW, "give the grid as printed")
        rows.append(
            [math.nan if c[0] in NOT_PROBED else gcode.finite(c, line) for c in cells]
        )
    if len(rows) < 2 or len(rows[0]) < 2:
        raise heading.error("there is no grid below it", "log the whole answer")
    return np.array(rows)


def _ends(
    name: str, lines: Sequence[TextLine], given: Mapping[str, tuple[float, ...]]
) -> tuple[float, float] | None:
    """Places of the first and last nodes along an axis, mm; None where nothing says."""
    if name in given:
        return given[name][0], given[name][1]
    low, high = ENDS[name]
    for command in reversed(list(gcode.commands(lines, "G29"))):
        if {low, high} <= set(command.words):
            return command.number(low), command.number(high)
    return None


def _share_among(
    points: Sequence[ProbedPoint], contacts: Sequence[ProbedPoint]
) -> float:
    """Share of the points at whose place there is a contact."""
    if not points or not contacts:
        return 0.0
    places = np.array([p[:2] for p in contacts])
    distances = [np.hypot(*(places - np.array(p[:2])).T).min() for p in points]
    return float(np.mean(np.array(distances) < 1.0))
