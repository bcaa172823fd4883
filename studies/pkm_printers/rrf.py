"""RepRapFirmware: M665 and M666 of a delta, the points of bed.g, the heights of G32.

`config.g` has M665 and M666, `config-override.g` those that M500 stored, which M501 reads;
`bed.g` has one `G30 P<n> X Y` a point, and the console's log the line "G32 bed probe
heights: ..." that `G30 P<n> S-1` gives. Answers of M665 and M666 in the log count as
commands. G31 X Y says where the probe is, M666 A B how z is raised for a bed that leans.

The third line of `heightmap.csv`, which G29 S0 saves, has the grid, the lines below it a
row of y each. Heights are those of the nozzle over the trigger height, at the places of
the probe; a node that was not probed (outside the radius) is written as 0 without
decimals (`GridProbing` of the firmware).
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from pkm_printers import facts, gcode, rotary_delta, rrf_five_bar, rrf_rotary
from pkm_printers.bed_mesh import BedMesh
from pkm_printers.delta_geometry import FACTORS, TOWER_ANGLES, DeltaGeometry
from pkm_printers.delta_probe import delta_session
from pkm_printers.delta_study import OTHER_MACHINES, PrinterGeometry
from pkm_printers.gcode import NUMBER, Command, TextLine
from pkm_printers.probed_point import ProbedPoint
from pkm_printers.repeated import repeated_in_log
from pkm_printers.rrf_points import has_heights, mesh_offset, probed_points
from pkm_printers.rrf_sequence import ExecutionOrder, capitals, execution_order
from pkm_printers.rrf_words import WORDS
from pkm_studies import files
from pkm_studies.base import InputError
from pkm_studies.csv_table import plain_number
from pkm_studies.importers import ImportedSession, ImportRequest, line_field
from pkm_studies.tables import ControllerTable

DELTA = re.compile(
    rf"Diagonals?\s+(?P<L>{NUMBER}(?::{NUMBER})*),\s*delta radius\s+(?P<R>{NUMBER}),"
    rf"\s*homed height\s+(?P<H>{NUMBER}),\s*bed radius\s+(?P<B>{NUMBER}),"
    rf"\s*X\s+(?P<X>{NUMBER})[^,]*,\s*Y\s+(?P<Y>{NUMBER})[^,]*,\s*Z\s+(?P<Z>{NUMBER})"
)
STOPS = re.compile(
    rf"Endstop adjustments\s+X(?P<X>{NUMBER})\s+Y(?P<Y>{NUMBER})\s+Z(?P<Z>{NUMBER}),"
    rf"\s*tilt\s+X(?P<A>{NUMBER})%\s+Y(?P<B>{NUMBER})%"
)
PROBE = re.compile(
    rf"Z probe(?: (?P<K>\d+))?: current reading.*offsets\s+X(?P<X>{NUMBER})"
    rf"\s+Y(?P<Y>{NUMBER})"
)
REPLIES = {"M665": DELTA, "M666": STOPS, "G31": PROBE}
#: machines by M669 K
LINEAR: Final = "3"
KINEMATICS: Final = {
    LINEAR: "linear delta",
    rrf_five_bar.KINEMATICS: "five-bar",
    rrf_rotary.KINEMATICS: "rotary delta",
}
#: M666 A and B are in percent
PERCENT = 1e-2
VERSION = re.compile(r"RepRapFirmware.*?\b(\d+\.\d+(?:\.\d+)*)")
MESH_HEADING: Final = re.compile(r"RepRapFirmware height map file v(\d+)")
MESH_FILE_LIMIT: Final = 4_000_000
#: mm; no place and no height is beyond it
LARGEST_MESH_NUMBER: Final = 1e4
#: mm; numbers of the grid are rounded by as much
MESH_ROUNDING: Final = 0.02
#: names of the numbers of the grid, as versions write them
MESH_GRIDS: Final = (
    ("xmin", "xmax", "ymin", "ymax", "radius", "spacing", "xnum", "ynum"),
    ("xmin", "xmax", "ymin", "ymax", "radius", "xspacing", "yspacing", "xnum", "ynum"),
    (
        *("axis0", "axis1", "min0", "max0", "min1", "max1"),
        *("radius", "spacing0", "spacing1", "num0", "num1"),
    ),
)
MESH_REMEDY: Final = "give heightmap.csv as G29 saved it"
#: letters of axes; other ones have no place on the bed
MESH_AXES: Final = "XY"
NODES_NOT_PROBED: Final = "they were not probed"


class RrfImporter:
    """Reads config.g, bed.g and a log, in any order."""

    name = "rrf"
    about = (
        "RepRapFirmware: config.g, with bed.g and log of G32 or heightmap.csv of a delta or"
        " rotary delta, with a CSV of a five-bar"
    )
    unused = ("--machine", "--map")

    def read(self, request: ImportRequest) -> ImportedSession:
        """Geometry and probed points. Raises InputError."""
        maps = [path for path in request.files if is_height_map(path)]
        others = [path for path in request.files if path not in maps]
        texts = gcode.read(others)
        commands = [_command_text(line) for line in texts]
        kinematics = _kinematics(commands)
        if kinematics == rrf_five_bar.KINEMATICS:
            return rrf_five_bar.five_bar_session(request, maps)
        is_rotary = kinematics == rrf_rotary.KINEMATICS
        words = rrf_rotary.ROTARY_WORDS if is_rotary else WORDS
        order = execution_order(commands, words)
        lines = order.lines
        given = facts.numbers(lines)
        read = _rotary if is_rotary else _linear
        printer = read(order, given)
        account = gcode.account_of(lines, words)
        points: list[ProbedPoint] = []
        notes: list[str] = []
        if has_heights(order) or not maps or request.mesh != "readings":
            points, notes = probed_points(order, given)
        return delta_session(
            name=request.name,
            controller=printer.controller,
            files=", ".join(path.name for path in request.files),
            geometry=printer.geometry,
            points=points,
            accounts=account.sentences(),
            notes=[*notes, *order.notes, *gcode.order_text(texts)],
            free=facts.factors(lines, printer.factors),
            repeated=repeated_in_log(lines),
            meshes=[height_map(path, mesh_offset(order, given)) for path in maps],
            mesh=request.mesh,
            trigger=printer.trigger,
        )


importer = RrfImporter()


class _Printer(NamedTuple):
    """A printer as its files have it.

    factors  parameters by number of factors, as the firmware fits them
    trigger  height of the nozzle at contact, mm; 0 where it drops out
    """

    geometry: PrinterGeometry
    controller: ControllerTable
    factors: Mapping[int, tuple[str, ...]]
    trigger: float


def _kinematics(lines: Sequence[TextLine]) -> str:
    """The number of the machine. Raises InputError for one that is not read."""
    number = LINEAR
    for command in gcode.commands([capitals(line) for line in lines], "M669"):
        number = command.words.get("K", number)
        if number not in KINEMATICS:
            listed = ", ".join(f"{title} (K{k})" for k, title in KINEMATICS.items())
            problem = f"this is none of {listed}"
            raise command.line.error(problem, OTHER_MACHINES, "M669 K")
    return number


def _linear(order: ExecutionOrder, given: dict[str, tuple[float, ...]]) -> _Printer:
    """A linear delta by M665 and M666. Raises InputError."""
    delta = gcode.merged(order.lines, "M665", "give the config.g that has M665")
    stops = gcode.optional(order.lines, "M666")
    reach = [f"{k}{delta.words[k]}" for k in "BS" if k in delta.words]
    controller = _controller(order, {"M665": " ".join(reach)}, given)
    return _Printer(linear_geometry(delta, stops, given), controller, FACTORS, 0.0)


def _rotary(order: ExecutionOrder, given: dict[str, tuple[float, ...]]) -> _Printer:
    """A rotary delta by M669 and M666. Raises InputError."""
    geometry = rrf_rotary.rotary_geometry(order.lines)
    controller = _controller(order, rrf_rotary.kinematics_words(order.lines), given)
    trigger = rrf_rotary.trigger_height(order.lines)
    return _Printer(geometry, controller, rotary_delta.FACTORS, trigger)


def linear_geometry(
    delta: Command, stops: Command, given: Mapping[str, tuple[float, ...]]
) -> DeltaGeometry:
    """Carriage i homes to H + sqrt(L_i^2 - R^2) + its adjustment of M666."""
    arms = delta.values("L", 1, 3)
    trims = facts.trims(given, "rod_trim_mm")
    rods = arms * 3 if len(arms) == 1 else arms
    height = delta.number("H")
    return DeltaGeometry(
        radius=delta.number("R"),
        arms=np.array(rods) + trims,
        angles=TOWER_ANGLES + delta.numbers("XYZ"),
        endstops=height + stops.numbers("XYZ"),
        radius_trim=np.array(facts.trims(given, "radius_trim_mm")),
        bed_slope=PERCENT * stops.numbers("AB"),
    )


def _controller(
    order: ExecutionOrder, keep: dict[str, str], given: dict[str, tuple[float, ...]]
) -> ControllerTable:
    """The firmware, with the words that calibration leaves as they are."""
    lines = order.lines
    printed = [m[1] for line in lines if (m := VERSION.search(line.raw))]
    return ControllerTable(
        firmware="rrf",
        version=facts.version(lines) or (printed[-1] if printed else None),
        file=order.stored,
        keep={name: words for name, words in keep.items() if words},
        radius_trim_mm=facts.trims(given, "radius_trim_mm"),
    )


# -- replies as commands ---------------------------------------------------------------


def _command_text(line: TextLine) -> TextLine:
    for name, pattern in REPLIES.items():
        match = pattern.search(line.text)
        if match is not None:
            numbers = match.groupdict().items()
            words = [f"{letter}{text}" for letter, text in numbers if text is not None]
            return dataclasses.replace(line, text=" ".join([name, *words]))
    return line


# -- heightmap.csv ---------------------------------------------------------------------


def is_height_map(path: Path) -> bool:
    """Whether a file is a height map: by its first line, or its name.

    The firmware has no other CSV. A file that cannot be read is none.
    """
    if path.suffix.lower() == ".csv":
        return True
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return MESH_HEADING.match(file.readline()) is not None
    except OSError:
        return False


def height_map(path: Path, offset: tuple[float, float]) -> BedMesh:
    """The probed nodes of a file. Raises InputError.

    offset  of the probe from the nozzle, mm
    """
    lines = files.read_text(
        path, limit=MESH_FILE_LIMIT, what="height map", is_foreign=True
    ).splitlines()
    grid = _mesh_grid(lines, path)
    x = grid["xmin"] + grid["xspacing"] * np.arange(round(grid["xnum"]))
    y = grid["ymin"] + grid["yspacing"] * np.arange(round(grid["ynum"]))
    rows = [(k, line) for k, line in enumerate(lines[3:], start=4) if line.strip()]
    if len(rows) != len(y):
        problem = f"{len(rows)} rows of heights, where the grid has {len(y)}"
        raise _mesh_error(path, len(lines), problem)
    points = []
    for (number, line), along in zip(rows, y, strict=True):
        cells = [cell.strip() for cell in line.split(",")]
        if len(cells) != len(x):
            problem = f"{len(cells)} heights, where the grid has {len(x)}"
            raise _mesh_error(path, number, problem)
        for across, cell in zip(x, cells, strict=True):
            if cell == "0":
                continue
            height = _mesh_number(cell, path, number)
            points.append(
                ProbedPoint(
                    float(across) - offset[0], float(along) - offset[1], height, offset
                )
            )
    for places, axis in ((x, "x"), (y, "y")):
        if places[-1] > grid[f"{axis}max"] + MESH_ROUNDING:
            raise _mesh_error(path, 3, f"its nodes go beyond its {axis}max")
    left_out = len(x) * len(y) - len(points)
    return BedMesh(path.stem, tuple(points), left_out, NODES_NOT_PROBED)


def _mesh_grid(lines: Sequence[str], path: Path) -> dict[str, float]:
    """Ends, spacing and numbers of nodes along x and y. Raises InputError."""
    if len(lines) < 3:
        raise _mesh_error(path, len(lines), "the lines of the grid are missing")
    names = tuple(name.strip() for name in lines[1].split(","))
    cells = [cell.strip() for cell in lines[2].split(",")]
    if names not in MESH_GRIDS or len(cells) != len(names):
        raise _mesh_error(path, 2, "this version's grid is not known")
    words = dict(zip(names, cells, strict=True))
    axes = words.pop("axis0", "X") + words.pop("axis1", "Y")
    if axes != MESH_AXES:
        raise _mesh_error(path, 3, f"its axes are {axes}, not {MESH_AXES}")
    grid = {name: _mesh_number(cell, path, 3) for name, cell in words.items()}
    for k, axis in enumerate("xy"):
        for stem in ("min", "max", "spacing", "num"):
            grid.setdefault(f"{axis}{stem}", grid.get(f"{stem}{k}", np.nan))
        if "spacing" in grid:
            grid[f"{axis}spacing"] = grid["spacing"]
        step, number = (grid[f"{axis}{stem}"] for stem in ("spacing", "num"))
        if step <= 0.0 or number < 1 or number % 1:
            raise _mesh_error(
                path, 3, f"{number:g} nodes {step:g} mm apart are no grid"
            )
    return grid


def _mesh_number(cell: str, path: Path, line: int) -> float:
    number = plain_number(cell)
    if number is None or abs(number) > LARGEST_MESH_NUMBER:
        raise _mesh_error(path, line, f"{cell} is no number of a height map")
    return number


def _mesh_error(path: Path, line: int, problem: str) -> InputError:
    return InputError(problem, MESH_REMEDY, file=str(path), field=line_field(line))
