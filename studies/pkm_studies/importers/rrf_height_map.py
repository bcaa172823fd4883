"""RepRapFirmware: `heightmap.csv`, the mesh that G29 S0 saves.

The third line has the grid, the lines below it a row of y each. Heights are those of the
nozzle over the trigger height, at the places of the probe; a node that was not probed
(outside the radius) is written as 0 without decimals (`GridProbing` of the firmware).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from pkm_studies.base import files
from pkm_studies.base.errors import InputError
from pkm_studies.base.plain_number import plain_number
from pkm_studies.importers.base import line_field
from pkm_studies.importers.bed_mesh import BedMesh
from pkm_studies.importers.probed_point import ProbedPoint

HEADING: Final = re.compile(r"RepRapFirmware height map file v(\d+)")
LIMIT: Final = 4_000_000
#: mm; no place and no height is beyond it
LARGEST: Final = 1e4
#: mm; numbers of the grid are rounded by as much
ROUNDING: Final = 0.02
#: names of the numbers of the grid, as versions write them
GRIDS: Final = (
    ("xmin", "xmax", "ymin", "ymax", "radius", "spacing", "xnum", "ynum"),
    ("xmin", "xmax", "ymin", "ymax", "radius", "xspacing", "yspacing", "xnum", "ynum"),
    (
        *("axis0", "axis1", "min0", "max0", "min1", "max1"),
        *("radius", "spacing0", "spacing1", "num0", "num1"),
    ),
)
REMEDY: Final = "give heightmap.csv as G29 saved it"
#: letters of axes; other ones have no place on the bed
AXES: Final = "XY"
NOT_PROBED: Final = "they were not probed"


def is_height_map(path: Path) -> bool:
    """Whether a file is a height map: by its first line, or its name.

    The firmware has no other CSV. A file that cannot be read is none.
    """
    if path.suffix.lower() == ".csv":
        return True
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return HEADING.match(file.readline()) is not None
    except OSError:
        return False


def height_map(path: Path, offset: tuple[float, float]) -> BedMesh:
    """The probed nodes of a file. Raises InputError.

    offset  of the probe from the nozzle, mm
    """
    lines = files.read_text(path, limit=LIMIT, what="height map").splitlines()
    grid = _grid(lines, path)
    x = grid["xmin"] + grid["xspacing"] * np.arange(round(grid["xnum"]))
    y = grid["ymin"] + grid["yspacing"] * np.arange(round(grid["ynum"]))
    rows = [(k, line) for k, line in enumerate(lines[3:], start=4) if line.strip()]
    if len(rows) != len(y):
        problem = f"{len(rows)} rows of heights, where the grid has {len(y)}"
        raise _error(path, len(lines), problem)
    points = []
    for (number, line), along in zip(rows, y, strict=True):
        cells = [cell.strip() for cell in line.split(",")]
        if len(cells) != len(x):
            problem = f"{len(cells)} heights, where the grid has {len(x)}"
            raise _error(path, number, problem)
        for across, cell in zip(x, cells, strict=True):
            if cell == "0":
                continue
            height = _number(cell, path, number)
            points.append(
                ProbedPoint(float(across) - offset[0], float(along) - offset[1], height)
            )
    for places, axis in ((x, "x"), (y, "y")):
        if places[-1] > grid[f"{axis}max"] + ROUNDING:
            raise _error(path, 3, f"its nodes go beyond its {axis}max")
    left_out = len(x) * len(y) - len(points)
    return BedMesh(path.stem, tuple(points), left_out, NOT_PROBED)


def _grid(lines: Sequence[str], path: Path) -> dict[str, float]:
    """Ends, spacing and numbers of nodes along x and y. Raises InputError."""
    if len(lines) < 3:
        raise _error(path, len(lines), "the lines of the grid are missing")
    names = tuple(name.strip() for name in lines[1].split(","))
    cells = [cell.strip() for cell in lines[2].split(",")]
    if names not in GRIDS or len(cells) != len(names):
        raise _error(path, 2, "this version's grid is not known")
    words = dict(zip(names, cells, strict=True))
    axes = words.pop("axis0", "X") + words.pop("axis1", "Y")
    if axes != AXES:
        raise _error(path, 3, f"its axes are {axes}, not {AXES}")
    grid = {name: _number(cell, path, 3) for name, cell in words.items()}
    for k, axis in enumerate("xy"):
        for stem in ("min", "max", "spacing", "num"):
            grid.setdefault(f"{axis}{stem}", grid.get(f"{stem}{k}", np.nan))
        if "spacing" in grid:
            grid[f"{axis}spacing"] = grid["spacing"]
        step, number = (grid[f"{axis}{stem}"] for stem in ("spacing", "num"))
        if step <= 0.0 or number < 1 or number % 1:
            raise _error(path, 3, f"{number:g} nodes {step:g} mm apart are no grid")
    return grid


def _number(cell: str, path: Path, line: int) -> float:
    number = plain_number(cell)
    if number is None or abs(number) > LARGEST:
        raise _error(path, line, f"{cell} is no number of a height map")
    return number


def _error(path: Path, line: int, problem: str) -> InputError:
    return InputError(problem, REMEDY, file=str(path), field=line_field(line))
