"""Points of RepRapFirmware's G30 with the heights of G32, where the nozzle was."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from pkm_studies.errors import InputError
from pkm_studies.importers import gcode
from pkm_studies.importers.delta_probe import ProbedPoint
from pkm_studies.importers.gcode import Command, TextLine

HEIGHTS = re.compile(r"bed probe heights:\s*([^,]*)", re.IGNORECASE)
CALIBRATED = re.compile(r"Calibrated \d+ factors", re.IGNORECASE)
NO_POINT = "give bed.g as well: it has one G30 P<n> X<x> Y<y> a point"
NO_HEIGHTS = (
    "give the console's log too, with the answer of a last G30 P<n> S-1: G32 bed probe"
    " heights: ..."
)
#: heights from which on Z of G30 is the height itself, and nothing is probed
TYPED = -9999.0
#: words of G31 that name a probe, and what they are without
PROBE_WORDS = {"K": "0", "T": ""}


def probed_points(
    lines: Sequence[TextLine], given: Mapping[str, tuple[float, ...]]
) -> tuple[list[ProbedPoint], list[str]]:
    """Points with their heights, and sentences on what was taken. Raises InputError.

    given  numbers of lines that a user added
    """
    places = _places(lines)
    answers = [(line, HEIGHTS.search(line.text)) for line in lines]
    reports = [(line, match[1].split()) for line, match in answers if match]
    if not reports:
        raise _missing(lines, "no bed probe heights in it", NO_HEIGHTS)
    if not places:
        raise _missing(lines, "no probe points in it", NO_POINT)
    line, cells = reports[-1]
    if {"set", "failed"} & set(cells):
        raise line.error("a point was not probed", "probe all points again")
    if len(cells) != len(places):
        problem = f"{len(cells)} heights for {len(places)} probe points"
        raise line.error(problem, "give the bed.g that was probed")
    _check_not_calibrated(lines, line)
    offset, notes = _offset(lines, given, {place.words["K"] for place in places})
    if len(reports) > 1:
        notes.append(f"Not read: {len(reports) - 1} earlier lines of heights.")
    heights = [gcode.finite(cell, line) for cell in cells]
    pairs = zip(places, heights, strict=True)
    return [_point(place, height, offset) for place, height in pairs], notes


def _places(lines: Sequence[TextLine]) -> list[Command]:
    """The last G30 of each point, in the order of the points. Raises InputError."""
    places: dict[int, Command] = {}
    for command in gcode.commands(lines, "G30"):
        if "P" not in command.words:
            continue
        number = int(command.number("P"))
        for letter in "XY":
            if letter not in command.words:
                raise command.line.error(
                    f"point {number} has no {letter}: it was probed where the head stood",
                    "write the place that was probed",
                    f"G30 {letter}",
                )
            command.number(letter)
        command.words.setdefault("K", "0")
        places[number] = command
    return [places[number] for number in sorted(places)]


def _offset(
    lines: Sequence[TextLine], given: Mapping[str, tuple[float, ...]], used: set[str]
) -> tuple[tuple[float, float], list[str]]:
    """Where the probe is from the nozzle, mm, and a sentence. Raises InputError."""
    stated = given.get("probe_offset_mm")
    if stated is not None:
        x, y = stated
        return (x, y), [_offset_sentence(x, y, "probe_offset_mm")]
    probes: dict[tuple[str, ...], Command] = {}
    for command in gcode.commands(lines, "G31"):
        if command.words.get("K", "0") not in used:
            continue
        name = tuple(command.words.get(k, usual) for k, usual in PROBE_WORDS.items())
        words = probes[name].words if name in probes else {}
        probes[name] = Command("G31", words | command.words, command.line)
    offsets = {(c.number("X", 0.0), c.number("Y", 0.0)) for c in probes.values()}
    if not offsets:
        sentence = "Places: those of the nozzle; there is no G31 with X and Y."
        return (0.0, 0.0), [sentence]
    if len(offsets) > 1:
        last = list(probes.values())[-1]
        raise last.line.error(
            "several probes stand at different places from the nozzle",
            "leave the G31 of the one that probed, or add a line probe_offset_mm = x, y",
            "G31",
        )
    x, y = offsets.pop()
    return (x, y), [_offset_sentence(x, y, "G31")]


def _offset_sentence(x: float, y: float, source: str) -> str:
    if not (x or y):
        return f"Places: those of the nozzle, where the probe is ({source})."
    return (
        f"Places: the probe is at x {x:+g}, y {y:+g} mm of the nozzle ({source}), so the"
        f" nozzle was at x {0.0 - x:+g}, y {0.0 - y:+g} mm of the places of G30."
    )


def _point(place: Command, height: float, offset: tuple[float, float]) -> ProbedPoint:
    """Where the nozzle was; a height that was typed is that of the nozzle itself."""
    is_typed = place.number("Z", TYPED) > TYPED
    x, y = (0.0, 0.0) if is_typed else offset
    return ProbedPoint(place.number("X") - x, place.number("Y") - y, height)


def _check_not_calibrated(lines: Sequence[TextLine], heights: TextLine) -> None:
    """Refuse heights that were probed after the firmware had calibrated itself.

    Then the geometry is neither that of config.g nor known, unless it was read after it.
    """
    above = [line for line in lines if line.file == heights.file]
    above = [line for line in above if line.number < heights.number]
    changed = [k for k, line in enumerate(above) if CALIBRATED.search(line.text)]
    if not changed:
        return
    stored = any("config-override" in line.file for line in lines)
    known = any(gcode.commands(above[changed[-1] :], "M665"))
    if not (stored or known):
        raise above[changed[-1]].error(
            "the firmware calibrated itself before it probed these heights, so config.g"
            " is not the geometry that they belong to",
            "log the answers of M665 and M666 after it, or give the config-override.g"
            " that M500 stored then",
        )


def _missing(lines: Sequence[TextLine], problem: str, remedy: str) -> InputError:
    return InputError(problem, remedy, file=gcode.files_of(lines))
