"""Marlin: M665 and M666 of a delta, and the points of G30, G29 or G33.

`M503` prints M665, M666 and M851. G30 and G29 print "Bed X: .. Y: .. Z: .." a point. G33
V3 prints the heights c, x, y, z, yz, zx, xy at the middle and every 60 degrees from 210.
Newer versions print their radius as well, "at radius:80.00"; a line `probe_radius_mm =
80`, added to the log of others, says it. Lines may have the prefixes of a host's log.

The bilinear grid of G29 and M420 V has a number for each column (x) and row (y), and no
places: G29 L R F B, or lines mesh_x_mm and mesh_y_mm that a user adds, say where it is.
Nodes that a delta cannot probe are extrapolated from others; they lie outside the circle
through the middles of the sides, unless a line mesh_radius_mm says another radius.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np

from oed.base import Array
from pkm_printers import facts, gcode
from pkm_printers.bed_mesh import PLACE_TOLERANCE_MM, BedMesh, ProbedPoint
from pkm_printers.delta_geometry import TOWER_ANGLES, DeltaGeometry
from pkm_printers.delta_numbers import NOT_KNOWN
from pkm_printers.delta_probe import delta_session
from pkm_printers.delta_study import Offset
from pkm_printers.gcode import Command, TextLine
from pkm_printers.marlin_log import Settings, points_of_contacts, probing
from pkm_printers.marlin_version import (
    HEADINGS,
    NOT_READ,
    RADIUS,
    ROD_TRIM,
    STEPS_PER_MM,
    VERSIONS,
    MeaningOfB,
    PossibleRules,
    dead_band,
    home_offset,
    possible_rules,
    printed_version,
)
from pkm_printers.repeated import repeated_in_log
from pkm_printers.words import HARMLESS, READ, Word, WordTable, costs, refused, same
from pkm_studies.importers import ImportedSession, ImportRequest
from pkm_studies.tables import ControllerTable

RADII: Final = refused(
    "versions and forks mean trims of the towers' radii, or of their angles, by it",
    "remove it and add a line radius_trim_mm = x, y, z with the radius trims of the"
    " towers; where they are angles, write them as M665 X, Y, Z",
)
FORK: Final = refused(
    "only forks of Marlin have this word, each with a meaning of its own",
    "write the geometry as M665 L R H X Y Z and M666 X Y Z; radius trims of the towers"
    " as a line radius_trim_mm = x, y, z",
)
IGNORED: Final = costs("Marlin 2.0.0 to 2.0.5 does not read it: it changes nothing")
FURTHER_AXES: Final = refused("a delta has no such axis", "give the log of the delta")
M665: Final[dict[str, Word]] = {
    **same(READ, "LRHXYZB"),
    "S": HARMLESS,
    **same(RADII, "DEFIJK"),
    **same(FORK, "OPQTUVW"),
}
M666: Final[dict[str, Word]] = {
    **same(READ, "XYZ"),
    **same(FORK, "ABCDEFHIJKLOPQRSTUVW"),
}
G33: Final[dict[str, Word]] = {
    **same(READ, "PO"),
    "R": costs("the radius is read from the report, or from a line probe_radius_mm"),
    **same(HARMLESS, "ACEFTVSXYZ"),
}
BED_LEVELING: Final = costs(
    "with bed leveling on, heights may be those over the mesh: probe with M420 S0"
)
MAX_TRIM = 10.0  #: M665 B, mm, above which it cannot be the trim of a rod
EARLY = "1.1.0-RC8 or earlier"  #: versions whose M665 has no H
NO_M503 = "log the answer of M503 as well: it prints M665 and M666"
#: what a study says of M665 B
ABOUT_B: Mapping[MeaningOfB, str] = {
    RADIUS: (
        "M665 B{value} is the radius of calibration, as in Marlin {versions}, and no trim"
        " of a rod."
    ),
    NOT_READ: "M665 B{value} changes nothing: Marlin {versions} does not read it.",
    ROD_TRIM: "M665 A, B, C are trims of the rods, as in Marlin {versions}.",
}

Given = Mapping[str, tuple[float, ...]]  #: numbers that a user added, by name
GRID_HEADING: Final = re.compile(r"Bilinear Leveling Grid:")
#: a row of the grid, after what a host writes before it
GRID_ROW: Final = re.compile(r"(?:^|[\s:<>])(\d+)((?:\s+(?:[-+]\d*\.\d+|=+|nan))+)\s*$")
#: the beginning of a row, whatever follows
GRID_ROW_NUMBER: Final = re.compile(r"(?:^|[\s:<>])(\d+)\s+[-+=n.\d]")
NOT_PROBED: Final = "=nN"
#: words of G29 for the ends of the grid along x and y
GRID_ENDS: Final = {"mesh_x_mm": ("L", "R"), "mesh_y_mm": ("F", "B")}
BROKEN_ROW: Final = "this row of the grid does not follow those above"
GRID_WITHOUT_PLACE: Final = (
    "The grid of G29 (line {line}) is not read: add lines mesh_x_mm = from, to and mesh_y_mm"
    " = from, to with the places of its first and last nodes, and mesh_radius_mm where it"
    " was not probed on the whole circle between them."
)
GRID_READ_TWICE: Final = "The grid of G29 (line {line}) is not read: its heights are among the readings already."
OUTSIDE_GRID: Final = "outside the circle that was probed, where the firmware extrapolates, or without a height"


class MarlinImporter:
    """Reads logs with the answers of M503 and of probing."""

    name = "marlin"
    about = "Marlin delta: log with M665, M666 (M503) and G30, G29 or G33"
    unused = ("--machine", "--map")

    def read(self, request: ImportRequest) -> ImportedSession:
        """Geometry and probed points. Raises InputError."""
        lines = gcode.read(request.files)
        numbers = facts.numbers(lines)
        delta = gcode.merged(lines, "M665", NO_M503)
        version, rules = _rules(lines, delta)
        b: MeaningOfB | None = rules.agreed("b")
        table = word_table(b, has_height="H" in delta.words)
        account = gcode.account_of(lines, table)
        probed = probing(lines, numbers, rules)
        settings = probed.settings
        home = printer_home(settings, numbers, rules)
        geometry = _geometry(settings, numbers, b, home)
        points, about_means = points_of_contacts(probed.contacts, geometry)
        points = [
            point._replace(probe=_probe_place(settings, numbers)) for point in points
        ]
        meshes, about_grid = mesh_grids(lines, numbers, probed.offset, points)
        return delta_session(
            request,
            controller=ControllerTable(
                firmware="marlin",
                version=version,
                m665_b=b,
                home_offset_mm=home.offset,
                probe_z_mm=home.probe_z,
                steps_per_mm=home.steps_per_mm,
                radius_trim_mm=facts.trims(numbers, "radius_trim_mm"),
                rod_trim_mm=facts.trims(numbers, "rod_trim_mm"),
            ),
            geometry=geometry,
            points=_points_over_bed(points, settings, rules),
            accounts=account,
            notes=[
                *_text_about_b(b, delta),
                *probed.notes,
                *about_means,
                *about_grid,
                *home.notes,
                *gcode.order_text(lines),
            ],
            free=facts.factors(lines),
            repeated=repeated_in_log(lines),
            meshes=meshes,
        )


importer = MarlinImporter()


def _rules(
    lines: Sequence[TextLine], delta: Command
) -> tuple[str | None, PossibleRules]:
    """The version as stated or printed, and what it does.

    What M665 B is shows by the heading of M503, then by the version, then by the letters.
    Raises InputError where nothing tells.
    """
    printed = [v for line in lines if (v := printed_version(line.raw)) is not None]
    version = facts.version(lines) or (printed[-1] if printed else None)
    if version is None and "H" not in delta.words:
        version = EARLY
    rules = possible_rules(version)
    has_height = {"has_height": True} if "H" in delta.words else {}
    rules = rules.where(**has_height)
    for meaning, heading in HEADINGS.items():
        if any(heading.search(line.raw) for line in lines):
            stated = rules.where(b=meaning)
            if stated.agreed("b") != meaning:
                # a build between two releases
                stated = possible_rules(None).where(b=meaning, **has_height)
            return version, stated
    return version, _rules_by_letters(rules, delta)


def _rules_by_letters(rules: PossibleRules, delta: Command) -> PossibleRules:
    """The rules that go with the letters of M665. Raises InputError for B of any."""
    if rules.agreed("b") is not None:
        return rules
    if {"A", "C"} & set(delta.words):
        return rules.where(b=ROD_TRIM)
    if "B" not in delta.words:
        return rules
    if abs(delta.number("B")) > MAX_TRIM:
        return rules.where(b=RADIUS)
    raise delta.line.error(
        f"B is the trim of a rod in Marlin {VERSIONS[ROD_TRIM]}, the radius of calibration"
        f" in {VERSIONS[RADIUS]}, and not read in {VERSIONS[NOT_READ]}",
        "add a line firmware_version = 2.1.2, with the version of your printer",
        "M665 B",
    )


def _text_about_b(b: MeaningOfB | None, delta: Command) -> list[str]:
    if "B" not in delta.words or b is None:
        return []
    return [ABOUT_B[b].format(value=delta.words["B"], versions=VERSIONS[b])]


def _geometry(
    settings: Settings, numbers: Given, b: MeaningOfB | None, home: Home
) -> DeltaGeometry:
    delta = settings.command("M665")
    trims = facts.trims(numbers, "rod_trim_mm")
    if b == ROD_TRIM:
        trims = tuple(delta.numbers("ABC"))
    rod = delta.number("L")
    return DeltaGeometry(
        radius=delta.number("R"),
        arms=rod + np.array(trims),
        angles=TOWER_ANGLES + delta.numbers("XYZ"),
        endstops=np.array(home.endstops),
        radius_trim=np.array(facts.trims(numbers, "radius_trim_mm")),
    )


def _probe_place(settings: Settings, numbers: Given) -> Offset:
    """Place (2,) of the probe from the nozzle, mm, whichever of the two G33 puts there."""
    stated = settings.command("M851").numbers("XY").tolist()
    x, y = numbers.get("probe_offset_mm", stated)
    return x, y


def _points_over_bed(
    points: Sequence[ProbedPoint], settings: Settings, rules: PossibleRules
) -> list[ProbedPoint]:
    """Heights over the bed: versions that print those of the nozzle lack M851 Z."""
    if rules.agreed("reads_to_bed") is not False:
        return list(points)
    lower = settings.command("M851").number("Z", 0.0)
    return [point._replace(z=point.z + lower) for point in points]


#
# After Marlin's G-code pages and its M665, M666 and G33 by version.
def word_table(b: MeaningOfB | None, *, has_height: bool) -> WordTable:
    """The words by what M665 B is, and by whether M665 has H.

    M206 moves the home position of versions without H, and is in H of others.
    """
    trims = same(READ, "ABC") if b == ROD_TRIM else same(RADII, "AC")
    if b == NOT_READ:
        trims = same(IGNORED, "ABC")
    height = READ if not has_height else costs("M665 H has it already")
    return {
        "M665": {**M665, **trims},
        "M666": M666,
        "M851": {**same(READ, "XY"), "Z": READ},
        "M206": {
            **same(READ, "XY"),
            "Z": height,
            **same(FURTHER_AXES, "ABCEPTSUVWIJK"),
        },
        "M428": {"": costs("it changes M206: log the answer of M503 after it")},
        "M92": same(
            costs(
                "steps per mm are taken as right: an error scales the towers' travel"
            ),
            "XYZEABCIJKUVWT",
        ),
        "G29": same(
            costs(
                "its grid is read where it says, or lines mesh_x_mm and mesh_y_mm say,"
                " where its nodes are; so are lines Bed X: Y: Z: of each place (G29 V4)"
            ),
            "ABCDEFHIJKLNOPQRSTUVWXYZ",
        ),
        "G30": same(READ, "XY") | same(HARMLESS, "CESHVZ"),
        "G33": G33,
        "M420": same(BED_LEVELING, "SZ") | same(HARMLESS, "VLTC"),
        "G20": {"": refused("the numbers are in inches", "give them in mm")},
        **{name: {} for name in ("G28", "M500", "M501", "M503", "M115")},
    }


def mesh_grids(
    lines: Sequence[TextLine],
    settings: Mapping[str, tuple[float, ...]],
    offset: tuple[float, float],
    contacts: Sequence[ProbedPoint],
) -> tuple[list[BedMesh], list[str]]:
    """The last grid of a log, if any; and sentences. Raises InputError.

    settings  numbers of lines that a user added
    offset    of the probe from the nozzle, mm
    contacts  that the log has as well
    """
    starts = [k for k, line in enumerate(lines) if GRID_HEADING.search(line.text)]
    if not starts:
        return [], []
    start_line = starts[-1]
    heights = _grid_heights(lines[start_line + 1 :], lines[start_line])
    ends = [_grid_ends(name, lines[:start_line], settings) for name in GRID_ENDS]
    if None in ends:
        return [], [GRID_WITHOUT_PLACE.format(line=lines[start_line].number)]
    count_y, count_x = heights.shape
    x_ends, y_ends = (end for end in ends if end is not None)
    x, y = np.linspace(*x_ends, count_x), np.linspace(*y_ends, count_y)
    reach = settings.get("mesh_radius_mm", (min(np.ptp(x), np.ptp(y)) / 2.0,))[0]
    away = np.hypot(x - x.mean(), (y - y.mean())[:, None])
    heights[away > reach + PLACE_TOLERANCE_MM] = np.nan
    mesh = BedMesh.of_grid("G29", x, y, heights, offset, OUTSIDE_GRID)
    if _share_among(mesh.points, contacts) > 0.5:
        return [], [GRID_READ_TWICE.format(line=lines[start_line].number)]
    notes = []
    if len(starts) > 1:
        notes.append(f"Not read: {len(starts) - 1} earlier grids of G29.")
    return [mesh], notes


def _grid_heights(lines: Sequence[TextLine], heading: TextLine) -> Array:
    """Heights (ny, nx), mm; NaN of nodes without one. Raises InputError."""
    rows: list[list[float]] = []
    for line in lines:
        match = GRID_ROW.search(line.text)
        if match is None:
            begun = GRID_ROW_NUMBER.search(line.text)
            if begun and rows and int(begun[1]) == len(rows):
                raise line.error(BROKEN_ROW, "give the grid as printed")
            if rows:
                break
            continue
        cells = match[2].split()
        if int(match[1]) != len(rows) or (rows and len(cells) != len(rows[0])):
            raise line.error(BROKEN_ROW, "give the grid as printed")
        rows.append(
            [math.nan if c[0] in NOT_PROBED else gcode.finite(c, line) for c in cells]
        )
    if len(rows) < 2 or len(rows[0]) < 2:
        raise heading.error("there is no grid below it", "log the whole answer")
    return np.array(rows)


def _grid_ends(
    name: str, lines: Sequence[TextLine], settings: Mapping[str, tuple[float, ...]]
) -> tuple[float, float] | None:
    """Places of the first and last nodes along an axis, mm; None where nothing says."""
    if name in settings:
        return settings[name][0], settings[name][1]
    low, high = GRID_ENDS[name]
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


# Heights of a delta's endstops over the bed, of what a Marlin log has of home.

TOWERS = "XYZ"
#: fewest steps per mm that printers have, as of a motor with 8 microsteps
MIN_STEPS = 40.0
NO_HEIGHT = (
    "this version has none: add a line home_height_mm = 250 with the home height of its"
    " configuration (MANUAL_Z_HOME_POS); M206 Z is added to it"
)


@dataclasses.dataclass(frozen=True)
class Home:
    """Where a printer is at home."""

    #: heights (3,) of the nozzle over the bed at each endstop, mm
    endstops: tuple[float, ...]
    #: height of the nozzle at home over M665 H, M666 aside, mm; NOT_KNOWN where the log
    #: does not show it, and the height is taken as H
    offset: float | Literal["not known"]
    probe_z: float | None  #: M851 Z, mm; None where the log has none
    steps_per_mm: float | None  #: of the towers; None where the log has no M92
    notes: list[str]  #: sentences


def printer_home(
    settings: Settings, numbers: Mapping[str, tuple[float, ...]], rules: PossibleRules
) -> Home:
    """Home by the settings in force. Raises InputError."""
    probe, notes = settings.command("M851"), list[str]()
    probe_z = probe.number("Z") if "Z" in probe.words else None
    steps_per_mm = _steps(settings.command("M92"))
    offset = home_offset(rules, probe_z, steps_per_mm)
    height = _height(settings, numbers) + (offset or 0.0)
    if offset:
        notes.append(
            f"Home: the nozzle is {offset:+.4g} mm from M665 H there, as this version"
            " homes; the study has the height of the nozzle."
        )
    elif offset is None:
        notes.append(
            "Home: its height is taken as M665 H. Versions count M851 Z to it, or go"
            " further from the switches, and the log does not show which: on other"
            " firmware set the height anew."
        )
    moves = [_move(settings.command("M666"), k, steps_per_mm, rules) for k in TOWERS]
    notes += _band_text(settings.command("M666"), moves)
    endstops = tuple(height + move for move in moves)
    stated: float | Literal["not known"] = NOT_KNOWN if offset is None else offset
    return Home(endstops, stated, probe_z, steps_per_mm, notes)


def _steps(steps: Command) -> float | None:
    """Steps per mm of the towers; None without M92. Raises InputError."""
    if "X" not in steps.words:
        return None
    if steps.number("X") <= 0.0:
        problem = "steps per mm must be above 0"
        raise steps.line.error(problem, "correct the line", "M92 X")
    return steps.number("X")


def _height(settings: Settings, numbers: Mapping[str, tuple[float, ...]]) -> float:
    """Height at home: M665 H; without, the configuration's and M206 Z. InputError."""
    delta, shift = settings.command("M665"), settings.command("M206")
    for letter in "XY":
        if shift.number(letter, 0.0) != 0.0:
            raise shift.line.error(
                "home is off the middle, which moves all carriages",
                "set it to 0 (M206 X0 Y0), home, probe again",
                f"M206 {letter}",
            )
    if "H" in delta.words:
        return delta.number("H")
    stated = numbers.get("home_height_mm")
    if stated is None:
        for letter in "LR":  # a command that sets one number alone lacks these as well
            delta.number(letter)
        raise delta.line.error("M665 has no H", NO_HEIGHT)
    return stated[0] + shift.number("Z", 0.0)


def _move(
    stops: Command, tower: str, steps_per_mm: float | None, rules: PossibleRules
) -> float:
    """How far a carriage goes down from its switch by M666, mm. Raises InputError.

    An adjustment of -0.5 lowers the tower from its switch: that is higher by 0.5.
    """
    down = -stops.number(tower, 0.0)
    if down < 0.0 and rules.agreed("positive") == "no move":
        return 0.0
    if not 0.0 < down <= dead_band(steps_per_mm or MIN_STEPS):
        return down
    retreat = rules.agreed("retreat")
    if retreat is None and any(rule.retreat == "dead band" for rule in rules.rules):
        raise stops.line.error(
            "Marlin 2.0.6 and later makes no move for so small a value",
            "add a line firmware_version = 2.1.2, with the version of your printer",
            f"M666 {tower}",
        )
    if retreat != "dead band":
        return down
    if steps_per_mm is None:
        raise stops.line.error(
            "this version makes no move for a value of up to six steps of the motor,"
            f" {dead_band(STEPS_PER_MM):g} mm at {STEPS_PER_MM:g} steps per mm",
            "log the answer of M503 whole, or add the line M92 X80 Y80 Z80 with the steps"
            " per mm of your printer",
            f"M666 {tower}",
        )
    return 0.0


def _band_text(stops: Command, moves: list[float]) -> list[str]:
    """A sentence on values of M666 for which the firmware made no move."""
    values = [stops.number(tower, 0.0) for tower in TOWERS]
    idle = [
        f"{tower}{stops.words[tower]}"
        for tower, value, move in zip(TOWERS, values, moves, strict=True)
        if value and not move
    ]
    if not idle:
        return []
    return [
        f"M666 {' '.join(idle)} counts as 0: this version makes no move for a value of up"
        " to six steps of the motor, or above 0."
    ]
