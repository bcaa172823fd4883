"""RepRapFirmware: M665 and M666 of a delta, the points of bed.g, the heights of G32.

`config.g` (or `config-override.g`) has M665 and M666, `bed.g` one `G30 P<n> X Y` a point,
and the console's log the line "G32 bed probe heights: ..." that `G30 P<n> S-1` gives.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from pkm_studies.errors import InputError
from pkm_studies.importers import gcode
from pkm_studies.importers.base import ImportedSession, ImportRequest
from pkm_studies.importers.delta_probe import ProbedPoint, delta_session
from pkm_studies.importers.delta_study import DeltaGeometry
from pkm_studies.importers.gcode import TextLine

HEIGHTS = re.compile(r"bed probe heights:\s*([^,]*)", re.IGNORECASE)
ANGLES = {"X": 210.0, "Y": 330.0, "Z": 90.0}
NO_POINT = "give bed.g as well: it has one G30 P<n> X<x> Y<y> a point"
NO_HEIGHTS = (
    "give the console's log too, with the answer of a last G30 P<n> S-1: G32 bed probe"
    " heights: ..."
)


class RrfImporter:
    """Reads config.g, bed.g and a log, in any order."""

    name = "rrf"
    about = "RepRapFirmware delta: config.g (M665, M666), bed.g, log of G32"

    def read(self, request: ImportRequest) -> ImportedSession:
        """Geometry and probed points. Raises InputError."""
        lines = gcode.read(request.files)
        return delta_session(
            name=request.name,
            firmware="RepRapFirmware",
            files=", ".join(path.name for path in request.files),
            geometry=_geometry(lines),
            points=_points(lines),
        )


importer = RrfImporter()


def _geometry(lines: Sequence[TextLine]) -> DeltaGeometry:
    delta = gcode.merged(lines, "M665", "give config.g as well, with M665")
    arms = [
        gcode.finite(arm, delta.line)
        for arm in delta.words.get("L", "").split(":")
        if arm
    ]
    if len(arms) not in (1, 3):
        raise delta.line.error("M665 has no L, or not one or three", "give the rods")
    height = delta.number("H")
    return DeltaGeometry(
        radius=delta.number("R"),
        arms=tuple(arms * 3 if len(arms) == 1 else arms),
        angles=tuple(angle + delta.number(t, 0.0) for t, angle in ANGLES.items()),
        endstops=tuple(height + adjustment for adjustment in _adjustments(lines)),
    )


def _adjustments(lines: Sequence[TextLine]) -> list[float]:
    """Endstop adjustments of M666 by tower, mm; 0 without the command."""
    if not any(gcode.commands(lines, "M666")):
        return [0.0] * len(ANGLES)
    stops = gcode.merged(lines, "M666", "")
    return [stops.number(tower, 0.0) for tower in ANGLES]


def _points(lines: Sequence[TextLine]) -> list[ProbedPoint]:
    places: dict[int, tuple[float, float]] = {}
    for command in gcode.commands(lines, "G30"):
        if {"P", "X", "Y"} <= set(command.words):
            place = command.number("X"), command.number("Y")
            places[int(command.number("P"))] = place
    answers = [(line, HEIGHTS.search(line.text)) for line in lines]
    reports = [(line, match[1].split()) for line, match in answers if match]
    files_read = ", ".join(dict.fromkeys(line.file for line in lines))
    if not reports:
        raise InputError("no bed probe heights in it", NO_HEIGHTS, file=files_read)
    if not places:
        raise InputError("no probe points in it", NO_POINT, file=files_read)
    line, cells = reports[-1]
    if len(cells) != len(places):
        problem = f"{len(cells)} heights for {len(places)} probe points"
        raise line.error(problem, "give the bed.g that was probed")
    heights = [gcode.finite(cell, line) for cell in cells]
    ordered = [places[number] for number in sorted(places)]
    return [ProbedPoint(x, y, z) for (x, y), z in zip(ordered, heights, strict=True)]
