"""Marlin: M665 and M666 of a delta, and the points of G30, G29 or G33.

`M503` prints M665 and M666. G30 and G29 print "Bed X: .. Y: .. Z: .." a point. G33 V0
prints the heights c, x, y, z, yz, zx, xy at the middle and every 60 degrees from 210.
Newer versions print their radius as well, "at radius:80.00"; a line `probe_radius_mm =
80`, added to the log of others, says it. Lines may have the prefixes of a host's log.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from pkm_studies.errors import InputError
from pkm_studies.importers import gcode
from pkm_studies.importers.base import ImportedSession, ImportRequest
from pkm_studies.importers.delta_probe import ProbedPoint, delta_session
from pkm_studies.importers.delta_study import DeltaGeometry
from pkm_studies.importers.gcode import NUMBER, TextLine

BED = re.compile(rf"Bed\s+X:\s*({NUMBER})\s+Y:\s*({NUMBER})\s+Z:\s*({NUMBER})")
ITERATION = re.compile(rf"\b(c|x|y|z|yz|zx|xy):\s*({NUMBER})")
RADIUS = re.compile(rf"probe_radius_mm\s*=\s*({NUMBER})")
PRINTED_RADIUS = re.compile(rf"\bat radius:\s*({NUMBER})")
#: a line of G33's report, after the prefix of a host or a time
REPORT = re.compile(r"(?:[^.]*?(?:Recv|RX)\S*\s+|<+\s*|\d[\d:.]*\s*:\s+)?\.\s")
ANGLES = {"X": 210.0, "Y": 330.0, "Z": 90.0}
#: angles of G33's points, deg
POINTS = {"x": 210.0, "xy": 270.0, "y": 330.0, "yz": 30.0, "z": 90.0, "zx": 150.0}
NO_POINTS = "probe with G30 X<x> Y<y> at seven points or more, and log the answers: Bed X: Y: Z:"


class MarlinImporter:
    """Reads logs with the answers of M503 and of probing."""

    name = "marlin"
    about = "Marlin delta: log with M665, M666 (M503) and G30, G29 or G33"

    def read(self, request: ImportRequest) -> ImportedSession:
        """Geometry and probed points. Raises InputError."""
        lines = gcode.read(request.files)
        return delta_session(
            name=request.name,
            firmware="Marlin",
            files=", ".join(path.name for path in request.files),
            geometry=_geometry(_before_probing(lines)),
            points=_points(lines),
        )


importer = MarlinImporter()


def _before_probing(lines: Sequence[TextLine]) -> Sequence[TextLine]:
    """The lines above the last probed point, where they have the geometry; all if not.

    G33 changes the geometry, and M503 below it prints the new one.
    """
    probed = [
        k
        for k, line in enumerate(lines)
        if BED.search(line.text)
        or (REPORT.match(line.text) and ITERATION.search(line.text))
    ]
    above = lines[: probed[-1]] if probed else []
    complete = all(any(gcode.commands(above, name)) for name in ("M665", "M666"))
    return above if complete else lines


def _geometry(lines: Sequence[TextLine]) -> DeltaGeometry:
    remedy = "log the answer of M503 as well: it prints M665 and M666"
    delta = gcode.merged(lines, "M665", remedy)
    stops = gcode.merged(lines, "M666", remedy)
    rod, height = delta.number("L"), delta.number("H")
    return DeltaGeometry(
        radius=delta.number("R"),
        arms=tuple(rod + delta.number(letter, 0.0) for letter in "ABC"),
        angles=tuple(angle + delta.number(t, 0.0) for t, angle in ANGLES.items()),
        # an adjustment of -0.5 lowers the tower from its switch: that is higher by 0.5
        endstops=tuple(height - stops.number(tower, 0.0) for tower in ANGLES),
    )


def _points(lines: Sequence[TextLine]) -> list[ProbedPoint]:
    points = []
    for line in lines:
        match = BED.search(line.text)
        if match:
            x, y, z = (gcode.finite(match[k], line) for k in (1, 2, 3))
            points.append(ProbedPoint(x, y, z))
    points = points or _calibration_points(lines)
    if not points:
        files_read = ", ".join(dict.fromkeys(line.file for line in lines))
        raise InputError("no probed points in it", NO_POINTS, file=files_read)
    return points


def _calibration_points(lines: Sequence[TextLine]) -> list[ProbedPoint]:
    """The points of the last G33 report; none without one. Raises InputError."""
    heights: dict[str, float] = {}
    last: TextLine | None = None
    for line in lines:
        if not REPORT.match(line.text):
            continue
        for name, value in ITERATION.findall(line.text):
            if name == "c":
                heights = {}
            heights[name], last = float(value), line
    if last is None:
        return []
    radii = _numbers(RADIUS, lines) or _numbers(PRINTED_RADIUS, lines)
    if not radii:
        raise last.error(
            "G33 does not print the radius at which it probed",
            "add a line probe_radius_mm = 80 to the log, or probe with G30",
        )
    radius = radii[-1]
    points = [ProbedPoint(0.0, 0.0, heights["c"])] if "c" in heights else []
    for name, angle in POINTS.items():
        if name in heights:
            x = radius * math.cos(math.radians(angle))
            y = radius * math.sin(math.radians(angle))
            points.append(ProbedPoint(x, y, heights[name]))
    return points


def _numbers(pattern: re.Pattern[str], lines: Sequence[TextLine]) -> list[float]:
    matches = ((line, pattern.search(line.text)) for line in lines)
    return [gcode.finite(match[1], line) for line, match in matches if match]
