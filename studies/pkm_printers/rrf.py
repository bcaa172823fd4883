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

import dataclasses
import itertools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from pkm_printers import facts, gcode, rotary_delta, rrf_five_bar, rrf_rotary
from pkm_printers.bed_mesh import BedMesh, ProbedPoint, offset_sentence
from pkm_printers.delta_geometry import FACTORS, TOWER_ANGLES, DeltaGeometry
from pkm_printers.delta_probe import delta_session
from pkm_printers.delta_study import OTHER_MACHINES, PrinterGeometry
from pkm_printers.gcode import NUMBER, Command, TextLine
from pkm_printers.repeated import repeated_in_log
from pkm_printers.rrf_sequence import WORDS, ExecutionOrder, capitals, execution_order
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
LINEAR: Final = "3"  #: machines by M669 K
KINEMATICS: Final = {
    LINEAR: "linear delta",
    rrf_five_bar.KINEMATICS: "five-bar",
    rrf_rotary.KINEMATICS: "rotary delta",
}
TILT_PERCENT = 1e-2  #: M666 A and B are in percent
VERSION = re.compile(r"RepRapFirmware.*?\b(\d+\.\d+(?:\.\d+)*)")
MESH_HEADING: Final = re.compile(r"RepRapFirmware height map file v(\d+)")
MAX_MESH_BYTES: Final = 4_000_000
MAX_MESH_NUMBER: Final = 1e4  #: mm; no place and no height is beyond it
MESH_ROUNDING: Final = 0.02  #: mm; numbers of the grid are rounded by as much
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
MESH_AXES: Final = "XY"  #: letters of axes; other ones have no place on the bed
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
        numbers = facts.numbers(lines)
        read = _rotary if is_rotary else _linear
        printer = read(order, numbers)
        account = gcode.account_of(lines, words)
        points: list[ProbedPoint] = []
        notes: list[str] = []
        if (
            any(HEIGHTS.search(line.text) for line in order.lines)
            or not maps
            or request.mesh != "readings"
        ):
            points, notes = probed_points(order, numbers)
        return delta_session(
            request,
            controller=printer.controller,
            geometry=printer.geometry,
            points=points,
            accounts=account,
            notes=[*notes, *order.notes, *gcode.order_text(texts)],
            free=facts.factors(lines, printer.factors),
            repeated=repeated_in_log(lines),
            meshes=[height_map(path, mesh_offset(order, numbers)) for path in maps],
            trigger=printer.trigger,
        )


importer = RrfImporter()


class _Printer(NamedTuple):
    """A printer as its files have it."""

    geometry: PrinterGeometry
    controller: ControllerTable
    #: parameters by number of factors, as the firmware fits them
    factors: Mapping[int, tuple[str, ...]]
    trigger: float  #: height of the nozzle at contact, mm; 0 where it drops out


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


def _linear(order: ExecutionOrder, numbers: dict[str, tuple[float, ...]]) -> _Printer:
    """A linear delta by M665 and M666. Raises InputError."""
    delta = gcode.merged(order.lines, "M665", "give the config.g that has M665")
    stops = gcode.optional(order.lines, "M666")
    controller = _controller(order, {"M665": delta.text_of("BS")}, numbers)
    return _Printer(linear_geometry(delta, stops, numbers), controller, FACTORS, 0.0)


def _rotary(order: ExecutionOrder, numbers: dict[str, tuple[float, ...]]) -> _Printer:
    """A rotary delta by M669 and M666. Raises InputError."""
    geometry = rrf_rotary.rotary_geometry(order.lines)
    controller = _controller(order, rrf_rotary.kinematics_words(order.lines), numbers)
    trigger = rrf_rotary.trigger_height(order.lines)
    return _Printer(geometry, controller, rotary_delta.FACTORS, trigger)


def linear_geometry(
    delta: Command, stops: Command, numbers: Mapping[str, tuple[float, ...]]
) -> DeltaGeometry:
    """Carriage i homes to H + sqrt(L_i^2 - R^2) + its adjustment of M666."""
    arms = delta.values("L", 1, 3)
    trims = facts.trims(numbers, "rod_trim_mm")
    rods = arms * 3 if len(arms) == 1 else arms
    height = delta.number("H")
    return DeltaGeometry(
        radius=delta.number("R"),
        arms=np.array(rods) + trims,
        angles=TOWER_ANGLES + delta.numbers("XYZ"),
        endstops=height + stops.numbers("XYZ"),
        radius_trim=np.array(facts.trims(numbers, "radius_trim_mm")),
        bed_slope=TILT_PERCENT * stops.numbers("AB"),
    )


def _controller(
    order: ExecutionOrder, keep: dict[str, str], numbers: dict[str, tuple[float, ...]]
) -> ControllerTable:
    """The firmware, with the words that calibration leaves as they are."""
    lines = order.lines
    printed = [m[1] for line in lines if (m := VERSION.search(line.raw))]
    return ControllerTable(
        firmware="rrf",
        version=facts.version(lines) or (printed[-1] if printed else None),
        file=order.stored,
        keep={name: words for name, words in keep.items() if words},
        radius_trim_mm=facts.trims(numbers, "radius_trim_mm"),
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


def is_height_map(path: Path) -> bool:
    """Whether a readable file is a height map: by its first line, or its name."""
    if path.suffix.lower() == ".csv":
        return True
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return MESH_HEADING.match(file.readline()) is not None
    except OSError:
        return False


def height_map(path: Path, offset: tuple[float, float]) -> BedMesh:
    """The probed nodes of a file at an offset of the probe. Raises InputError."""
    lines = files.read_text(
        path, limit=MAX_MESH_BYTES, what="height map", is_foreign=True
    ).splitlines()
    grid = _mesh_grid(lines, path)
    x, y = (
        np.array(grid[f"{a}min"] + grid[f"{a}spacing"] * np.arange(grid[f"{a}num"]))
        for a in "xy"
    )
    rows = [(k, line) for k, line in enumerate(lines[3:], start=4) if line.strip()]
    if len(rows) != len(y):
        problem = f"{len(rows)} rows of heights, where the grid has {len(y)}"
        raise _mesh_error(path, len(lines), problem)
    heights = np.full((len(y), len(x)), np.nan)
    for k, (number, line) in enumerate(rows):
        cells = [cell.strip() for cell in line.split(",")]
        if len(cells) != len(x):
            problem = f"{len(cells)} heights, where the grid has {len(x)}"
            raise _mesh_error(path, number, problem)
        probed = [j for j, cell in enumerate(cells) if cell != "0"]
        heights[k, probed] = [_mesh_number(cells[j], path, number) for j in probed]
    for places, axis in ((x, "x"), (y, "y")):
        if places[-1] > grid[f"{axis}max"] + MESH_ROUNDING:
            raise _mesh_error(path, 3, f"its nodes go beyond its {axis}max")
    return BedMesh.of_grid(path.stem, x, y, heights, offset, NODES_NOT_PROBED)


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
    if number is None or abs(number) > MAX_MESH_NUMBER:
        raise _mesh_error(path, line, f"{cell} is no number of a height map")
    return number


def _mesh_error(path: Path, line: int, problem: str) -> InputError:
    return InputError(problem, MESH_REMEDY, file=str(path), field=line_field(line))


# Points of RepRapFirmware's G30 with the heights of G32, where the nozzle was.

HEIGHTS = re.compile(r"bed probe heights:\s*([^,]*)", re.IGNORECASE)
CALIBRATED = re.compile(r"Calibrated \d+ factors", re.IGNORECASE)
NO_POINT = "give the bed.g that has one G30 P<n> X<x> Y<y> a point"
NO_HEIGHTS = (
    "give the console's log that has the answer of a last G30 P<n> S-1: G32 bed probe"
    " heights: ...; or fit the heights of heightmap.csv: --mesh readings"
)
#: heights from which on Z of G30 is the height itself, and nothing is probed
MIN_TYPED_HEIGHT_MM = -9999.0

#: cells of a line of heights of which one was not probed
NOT_PROBED = {"set", "failed"}
#: commands whose words change the geometry, or the place of the probe
CHANGING = ("M665", "M666", "M558", "G31", "M851", "M92")
Report = tuple[TextLine, list[str]]  #: a line of heights, and its cells
#: place of the probe from the nozzle (2,), mm; None where no G31 has it
Offset = tuple[float, float] | None


@dataclasses.dataclass(frozen=True)
class ProbePoint:
    """A point of G30 as the firmware probes it."""

    place: Command  #: the command
    offset: Offset  #: of the probe from the nozzle at that moment

    @property
    def is_typed(self) -> bool:
        """Whether the height was typed: it is that of the nozzle itself."""
        return self.place.number("Z", MIN_TYPED_HEIGHT_MM) > MIN_TYPED_HEIGHT_MM

    def contact(self, height: float) -> ProbedPoint:
        """Where the nozzle was at a height, mm."""
        x, y = (0.0, 0.0) if self.is_typed or self.offset is None else self.offset
        return ProbedPoint(
            self.place.number("X") - x, self.place.number("Y") - y, height, (x, y)
        )


def probed_points(
    order: ExecutionOrder, numbers: Mapping[str, tuple[float, ...]]
) -> tuple[list[ProbedPoint], list[str]]:
    """Points with heights and added numbers, and notes. Raises InputError."""
    lines = order.lines
    answers = [(line, HEIGHTS.search(line.text)) for line in lines]
    reports = [(line, match[1].split()) for line, match in answers if match]
    if not reports:
        raise _missing(lines, "no bed probe heights in it", NO_HEIGHTS)
    points, reset = _points(order, numbers)
    if not points:
        raise _missing(lines, "no probe points in it", NO_POINT)
    line, cells = reports[-1]
    if NOT_PROBED & set(cells):
        raise line.error("a point was not probed", "probe all points again")
    if len(cells) != len(points):
        problem = f"{len(cells)} heights for {len(points)} probe points"
        raise line.error(problem, "give the bed.g that was probed")
    _check_not_calibrated(lines, line)
    notes = [*reset, _places_text(points, "probe_offset_mm" in numbers)]
    alike = _one_geometry(lines, reports)
    if len(alike) > 1:
        notes.append(f"Heights: {len(alike)} passes over all points with one geometry.")
    if len(reports) > len(alike):
        notes.append(f"Not read: {len(reports) - len(alike)} earlier lines of heights.")
    return [
        point.contact(gcode.finite(cell, report))
        for report, of_report in alike
        for point, cell in zip(points.values(), of_report, strict=True)
    ], notes


def _one_geometry(
    lines: Sequence[TextLine], reports: Sequence[Report]
) -> Sequence[Report]:
    """The last reports between which nothing changed the printer, with as many heights."""
    since = len(reports) - 1
    for (earlier, cells), (later, last) in reversed(list(itertools.pairwise(reports))):
        rows = lines[lines.index(earlier) : lines.index(later)]
        if (
            len(cells) != len(last)
            or NOT_PROBED & set(cells)
            or any(map(_changes, rows))
        ):
            break
        since -= 1
    return reports[since:]


def _changes(line: TextLine) -> bool:
    is_set = any(command.words for command in gcode.commands([line], *CHANGING))
    return is_set or CALIBRATED.search(line.text) is not None


def mesh_offset(
    order: ExecutionOrder, numbers: Mapping[str, tuple[float, ...]]
) -> tuple[float, float]:
    """Place of the probe from the nozzle (2,), mm, at the nodes of a mesh."""
    probes = _Probes(order)
    stated = numbers.get("probe_offset_mm")
    if stated is not None:
        return stated[0], stated[1]
    return probes.offset(Command("G29", {}, order.lines[0])) or (0.0, 0.0)


def _points(
    order: ExecutionOrder, numbers: Mapping[str, tuple[float, ...]]
) -> tuple[dict[int, ProbePoint], list[str]]:
    """The last G30 of each point, by its number, and sentences. Raises InputError."""
    probes = _Probes(order)
    stated = numbers.get("probe_offset_mm")
    points: dict[int, ProbePoint] = {}
    for command in gcode.commands(order.probing, "M558", "G31", "G30"):
        if command.name != "G30":
            probes.take(command)
        elif "P" in command.words:
            _check_place(command)
            offset = stated or probes.offset(command)
            number = int(command.number("P"))
            points[number] = ProbePoint(command, offset and (offset[0], offset[1]))
    return dict(sorted(points.items())), [] if stated else probes.notes


def _check_place(command: Command) -> None:
    """Refuse a point without a place. Raises InputError."""
    for letter in "XY":
        if letter not in command.words:
            number = int(command.number("P"))
            raise command.line.error(
                f"point {number} has no {letter}: it was probed where the head stood",
                "write the place that was probed",
                f"G30 {letter}",
            )
        command.number(letter)


class _Probes:
    """Where the probes are from the nozzle, by number (K) and kind (T of G31)."""

    def __init__(self, order: ExecutionOrder) -> None:
        self.words: dict[tuple[str, str], Command] = {}
        self.notes: list[str] = []
        for command in gcode.commands(order.settings, "M558", "G31"):
            self.take(command)

    def take(self, command: Command) -> None:
        """Take M558 or G31."""
        number, kind = command.words.get("K", "0"), command.words.get("T", "")
        if command.name == "M558":
            # M558 P makes a probe anew, with the usual G31: the nozzle's own place
            old = self.words.get((number, ""))
            if "P" in command.words and old is not None:
                self.words[number, ""] = Command("G31", {}, command.line)
                self.notes.append(
                    f"G31 of line {old.line.number} counts no more: M558 P of line"
                    f" {command.line.number} makes the probe anew, at the nozzle."
                )
            return
        old = self.words.get((number, kind))
        words = command.words if old is None else old.words | command.words
        self.words[number, kind] = Command("G31", words, command.line)

    def offset(self, point: Command) -> Offset:
        """Where the probe of a point is now. Raises InputError where several may be."""
        number = point.words.get("K", "0")
        probes = [c for (k, _), c in self.words.items() if k == number]
        offsets = {(c.number("X", 0.0), c.number("Y", 0.0)) for c in probes}
        if len(offsets) > 1:
            raise probes[-1].line.error(
                "several probes stand at different places from the nozzle",
                "leave the G31 of the one that probed, or add a line"
                " probe_offset_mm = x, y",
                "G31",
            )
        return offsets.pop() if offsets else None


def _places_text(points: Mapping[int, ProbePoint], is_given: bool) -> str:
    source = "probe_offset_mm" if is_given else "G31"
    probed = [point.offset for point in points.values() if not point.is_typed]
    typed = [str(k) for k, point in points.items() if point.is_typed]
    alike = set(probed)
    if len(alike) > 1:
        sentence = (
            "Places: those of G30 less the probe's place from the nozzle, which G31"
            " changes between the points"
        )
    elif alike in (set(), {None}):
        sentence = "Places: those of the nozzle; there is no G31 with X and Y"
    else:
        offset = alike.pop() or (0.0, 0.0)
        sentence = offset_sentence(offset, source, "the places of G30")
    if typed:
        sentence += (
            f"; the height of point {', '.join(typed)} was typed (Z of G30), and is that of"
            " the nozzle at the place itself"
        )
    return sentence + "."


def _check_not_calibrated(lines: Sequence[TextLine], heights: TextLine) -> None:
    """Refuse heights that were probed after the firmware had calibrated itself.

    Then the geometry is neither that of config.g nor known, unless it was read after it.
    """
    above = [line for line in lines if line.file == heights.file]
    above = above[: above.index(heights)]
    changed = [k for k, line in enumerate(above) if CALIBRATED.search(line.text)]
    if not changed:
        return
    stored = any("config-override" in line.file for line in lines)
    is_calibrated = any(gcode.commands(above[changed[-1] :], "M665"))
    if not (stored or is_calibrated):
        raise above[changed[-1]].error(
            "the firmware calibrated itself before it probed these heights, so config.g"
            " is not the geometry that they belong to",
            "log the answers of M665 and M666 after it, or give the config-override.g"
            " that M500 stored then",
        )


def _missing(lines: Sequence[TextLine], problem: str, remedy: str) -> InputError:
    return InputError(problem, remedy, file=gcode.files_of(lines))
