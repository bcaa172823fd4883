"""Smoothieware: M665, M666 and M206 of M503, and the heights of G29, G31 or G32.

M665 A, B, C are trims of the towers' radii, D, E, H of their angles, I, J, K of the rods, Z is
the height at home. A carriage at its switch is above that by M206 Z less M666: after
`LinearDeltaSolution` and `Endstops` of the firmware. Places are those of the nozzle, in G31
of the probe. Heights are printed against the start of the probing, so that the one in the middle
stays as the firmware has it. Letters of G32 are what it fits: G32 XYZRDE.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Final

from pkm_printers import facts, gcode
from pkm_printers.bed_mesh import ProbedPoint
from pkm_printers.delta_geometry import TOWER_ANGLES, DeltaGeometry
from pkm_printers.delta_probe import delta_session
from pkm_printers.delta_study import Offset
from pkm_printers.gcode import ENDS, NUMBER, Command, TextLine
from pkm_printers.repeated import repeated_in_log
from pkm_printers.words import HARMLESS, READ, WordTable, costs, refused, same
from pkm_studies.base import InputError
from pkm_studies.importers import ImportedSession, ImportRequest
from pkm_studies.tables import ControllerTable

#: what a host writes before an answer: a time, Recv:
HOST: Final = r"^(?i:[^a-z]|recv|read|[ap]m)*"
#: lines of a probed point, the sign of the height in them, and whether its place is that of
#: the probe: of a spiral and of G32, of the seven points as distances down, and as heights, and
#: of the grid of G31
POINTS: Final = (
    (rf"PROBE:\s*X({NUMBER}),\s*Y({NUMBER}),\s*Z({NUMBER}){ENDS}", 1.0, False),
    (rf"{HOST}X:({NUMBER})\s+Y:({NUMBER})\s+Z:({NUMBER})\s*(?:\sA:|$)", -1.0, False),
    (rf"{HOST}X({NUMBER}) Y({NUMBER}) Z({NUMBER})\s*$", 1.0, False),
    (rf"DEBUG:\s*X({NUMBER}),\s*Y({NUMBER}),\s*Z({NUMBER}){ENDS}", 1.0, True),
)
#: parameters by letter of G32
LETTERS: Final[Mapping[str, tuple[str, ...]]] = {
    **{axis: (f"endstop{k}",) for k, axis in enumerate("XYZ", start=1)},
    **{letter: (f"trim{k}",) for k, letter in enumerate("ABC", start=1)},
    "R": ("radius",),
    "D": ("angle1",),
    "E": ("angle2",),
    "L": ("arm1", "arm2", "arm3"),
    "U": ("bed_slope_x",),
    "V": ("bed_slope_y",),
}
NO_POINTS: Final = (
    "log the answer of G29.1 I30 or G31 (delta-grid), or of G29 (delta-calibration)"
)
WORDS: Final[WordTable] = {
    "M665": {**same(READ, "LRZABCDEHIJK"), "S": HARMLESS},
    "M666": same(READ, "XYZ"),
    "M206": {
        "Z": READ,
        **same(costs("it moves the middle at home, which is taken as 0, 0"), "XY"),
    },
    "M565": {**same(READ, "XY"), "Z": costs("heights count from the middle")},
    "M375": {"": costs("a grid that is on bends z: clear it with M370, then probe")},
    "G32": {**same(READ, LETTERS), **same(HARMLESS, "IJKPOQ")},
    **{name: same(HARMLESS, "IJPR") for name in ("G29", "G31")},
    "M92": same(
        costs("steps per mm are taken as right: an error scales the towers' travel"),
        "XYZEABCS",
    ),
    "G20": {"": refused("the numbers are in inches", "give them in mm")},
}


class SmoothieImporter:
    """Reads logs with the answers of M503 and of probing."""

    name = "smoothie"
    about = "Smoothieware delta: log with M665, M666 (M503) and G29, G29.1, G31 or G32"
    unused = ("--machine", "--map", "--mesh")

    def read(self, request: ImportRequest) -> ImportedSession:
        """Geometry and probed points. Raises InputError."""
        lines = gcode.read(request.files)
        delta = gcode.merged(lines, "M665", "log the answer of M503 as well")
        numbers = facts.numbers(lines)
        probe = gcode.optional(lines, "M565").numbers("XY").tolist()
        x, y = numbers.get("probe_offset_mm", probe)
        home = gcode.optional(lines, "M206").number("Z", 0.0)
        return delta_session(
            request,
            controller=ControllerTable(firmware="smoothie", home_offset_mm=home),
            geometry=_geometry(delta, gcode.optional(lines, "M666"), home),
            points=_points(lines, (x, y)),
            accounts=gcode.account_of(lines, WORDS),
            notes=["Heights: the one nearest the middle stays as the firmware has it."],
            free=facts.factors(lines) or _fitted(lines),
            repeated=repeated_in_log(lines),
        )


importer = SmoothieImporter()


def _geometry(delta: Command, trims: Command, home: float) -> DeltaGeometry:
    return DeltaGeometry(
        radius=delta.number("R"),
        arms=delta.number("L") + delta.numbers("IJK"),
        angles=TOWER_ANGLES + delta.numbers("DEH"),
        endstops=delta.number("Z") + home - trims.numbers("XYZ"),
        radius_trim=delta.numbers("ABC"),
    )


def _fitted(lines: Sequence[TextLine]) -> tuple[str, ...] | None:
    """Parameters of the letters of the last G32 that has any; None without."""
    fitted = None
    for command in gcode.commands(lines, "G32"):
        letters = [letter for letter in command.words if letter in LETTERS]
        names = (name for letter in letters for name in LETTERS[letter])
        fitted = tuple(names) or fitted
    return fitted


def _points(lines: Sequence[TextLine], offset: Offset) -> list[ProbedPoint]:
    """The probed points, heights against that of the one nearest the middle, mm."""
    points = []
    for line in lines:
        for pattern, sign, is_of_probe in POINTS:
            match = re.search(pattern, line.text)
            if match is not None:
                x, y, z = (gcode.finite(cell, line) for cell in match.groups())
                if is_of_probe:
                    x, y = x - offset[0], y - offset[1]
                points.append(ProbedPoint(x, y, sign * z, offset))
    if not points:
        raise InputError(
            "no probed points in it", NO_POINTS, file=gcode.files_of(lines)
        )
    middle = min(points, key=lambda point: point.x**2 + point.y**2)
    return [point._replace(z=point.z - middle.z) for point in points]
