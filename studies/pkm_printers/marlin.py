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

import math
import re
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from oed.base import Array
from pkm_printers import facts, gcode, marlin_home
from pkm_printers.bed_mesh import ROUNDING, BedMesh
from pkm_printers.delta_geometry import TOWER_ANGLES, DeltaGeometry
from pkm_printers.delta_probe import delta_session
from pkm_printers.delta_study import Offset
from pkm_printers.gcode import Command, TextLine
from pkm_printers.marlin_home import Home
from pkm_printers.marlin_log import Settings, probing
from pkm_printers.marlin_means import points_of_contacts
from pkm_printers.marlin_version import (
    HEADINGS,
    NOT_READ,
    RADIUS,
    ROD_TRIM,
    VERSIONS,
    MeaningOfB,
    PossibleRules,
    possible_rules,
    printed_version,
)
from pkm_printers.probed_point import ProbedPoint
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
#: M665 B, mm, above which it cannot be the trim of a rod
LONGEST_TRIM = 10.0
#: versions whose M665 has no H
EARLY = "1.1.0-RC8 or earlier"
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

#: numbers that a user added, by name
Given = Mapping[str, tuple[float, ...]]
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
        given = facts.numbers(lines)
        delta = gcode.merged(lines, "M665", NO_M503)
        version, rules = _rules(lines, delta)
        b: MeaningOfB | None = rules.agreed("b")
        table = word_table(b, has_height="H" in delta.words)
        account = gcode.account_of(lines, table)
        probed = probing(lines, given, rules)
        settings = probed.settings
        home = marlin_home.home(settings, given, rules)
        geometry = _geometry(settings, given, b, home)
        points, about_means = points_of_contacts(probed.contacts, geometry)
        points = [
            point._replace(probe=_probe_place(settings, given)) for point in points
        ]
        meshes, about_grid = mesh_grids(lines, given, probed.offset, points)
        return delta_session(
            name=request.name,
            controller=ControllerTable(
                firmware="marlin",
                version=version,
                m665_b=b,
                home_offset_mm=home.offset,
                probe_z_mm=home.probe_z,
                steps_per_mm=home.steps_per_mm,
                radius_trim_mm=facts.trims(given, "radius_trim_mm"),
                rod_trim_mm=facts.trims(given, "rod_trim_mm"),
            ),
            files=", ".join(path.name for path in request.files),
            geometry=geometry,
            points=_points_over_bed(points, settings, rules),
            accounts=account.sentences(),
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
            mesh=request.mesh,
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
    if abs(delta.number("B")) > LONGEST_TRIM:
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
    settings: Settings, given: Given, b: MeaningOfB | None, home: Home
) -> DeltaGeometry:
    delta = settings.command("M665")
    trims = facts.trims(given, "rod_trim_mm")
    if b == ROD_TRIM:
        trims = tuple(delta.numbers("ABC"))
    rod = delta.number("L")
    return DeltaGeometry(
        radius=delta.number("R"),
        arms=rod + np.array(trims),
        angles=TOWER_ANGLES + delta.numbers("XYZ"),
        endstops=np.array(home.endstops),
        radius_trim=np.array(facts.trims(given, "radius_trim_mm")),
    )


def _probe_place(settings: Settings, given: Given) -> Offset:
    """Place (2,) of the probe from the nozzle, mm, whichever of the two G33 puts there."""
    stated = settings.command("M851").numbers("XY").tolist()
    x, y = given.get("probe_offset_mm", stated)
    return x, y


def _points_over_bed(
    points: Sequence[ProbedPoint], settings: Settings, rules: PossibleRules
) -> list[ProbedPoint]:
    """Heights over the bed: versions that print those of the nozzle lack M851 Z."""
    if rules.agreed("reads_to_bed") is not False:
        return list(points)
    lower = settings.command("M851").number("Z", 0.0)
    return [point._replace(z=point.z + lower) for point in points]


# -- words -----------------------------------------------------------------------------
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
        "M851": {
            **same(READ, "XY"),
            "Z": READ,
        },
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


# -- meshes ----------------------------------------------------------------------------


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
    (x_ends, y_ends) = (end for end in ends if end is not None)
    x, y = np.linspace(*x_ends, count_x), np.linspace(*y_ends, count_y)
    middle = np.array([x.mean(), y.mean()])
    reach = settings.get("mesh_radius_mm", (min(np.ptp(x), np.ptp(y)) / 2.0,))[0]
    points = [
        ProbedPoint(float(px) - offset[0], float(py) - offset[1], float(z), offset)
        for py, row in zip(y, heights, strict=True)
        for px, z in zip(x, row, strict=True)
        if math.isfinite(z)
        and math.hypot(px - middle[0], py - middle[1]) <= reach + ROUNDING
    ]
    if _share_among(points, contacts) > 0.5:
        return [], [GRID_READ_TWICE.format(line=lines[start_line].number)]
    mesh = BedMesh("G29", tuple(points), heights.size - len(points), OUTSIDE_GRID)
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
