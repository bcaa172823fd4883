"""Points of RepRapFirmware's G30 with the heights of G32, where the nozzle was."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Mapping, Sequence

from pkm_printers import gcode
from pkm_printers.gcode import Command, TextLine
from pkm_printers.probed_point import ProbedPoint
from pkm_printers.rrf_sequence import ExecutionOrder
from pkm_studies.base import InputError

HEIGHTS = re.compile(r"bed probe heights:\s*([^,]*)", re.IGNORECASE)
CALIBRATED = re.compile(r"Calibrated \d+ factors", re.IGNORECASE)
NO_POINT = "give the bed.g that has one G30 P<n> X<x> Y<y> a point"
NO_HEIGHTS = (
    "give the console's log that has the answer of a last G30 P<n> S-1: G32 bed probe"
    " heights: ...; or fit the heights of heightmap.csv: --mesh readings"
)
#: heights from which on Z of G30 is the height itself, and nothing is probed
TYPED = -9999.0

#: cells of a line of heights of which one was not probed
NOT_PROBED = {"set", "failed"}
#: commands whose words change the geometry, or the place of the probe
CHANGING = ("M665", "M666", "M558", "G31", "M851", "M92")
#: a line of heights, and its cells
Report = tuple[TextLine, list[str]]
#: place of the probe from the nozzle (2,), mm; None where no G31 has it
Offset = tuple[float, float] | None


@dataclasses.dataclass(frozen=True)
class ProbePoint:
    """A point of G30 as the firmware probes it.

    place   the command
    offset  of the probe from the nozzle at that moment
    """

    place: Command
    offset: Offset

    @property
    def is_typed(self) -> bool:
        """Whether the height was typed: it is that of the nozzle itself."""
        return self.place.number("Z", TYPED) > TYPED

    def contact(self, height: float) -> ProbedPoint:
        """Where the nozzle was at a height, mm."""
        x, y = (0.0, 0.0) if self.is_typed or self.offset is None else self.offset
        return ProbedPoint(
            self.place.number("X") - x, self.place.number("Y") - y, height, (x, y)
        )


def has_heights(order: ExecutionOrder) -> bool:
    """Whether a log has the answer of G32."""
    return any(HEIGHTS.search(line.text) for line in order.lines)


def probed_points(
    order: ExecutionOrder, given: Mapping[str, tuple[float, ...]]
) -> tuple[list[ProbedPoint], list[str]]:
    """Points with their heights, and sentences on what was taken. Raises InputError.

    given  numbers of lines that a user added
    """
    lines = order.lines
    answers = [(line, HEIGHTS.search(line.text)) for line in lines]
    reports = [(line, match[1].split()) for line, match in answers if match]
    if not reports:
        raise _missing(lines, "no bed probe heights in it", NO_HEIGHTS)
    points, reset = _points(order, given)
    if not points:
        raise _missing(lines, "no probe points in it", NO_POINT)
    line, cells = reports[-1]
    if NOT_PROBED & set(cells):
        raise line.error("a point was not probed", "probe all points again")
    if len(cells) != len(points):
        problem = f"{len(cells)} heights for {len(points)} probe points"
        raise line.error(problem, "give the bed.g that was probed")
    _check_not_calibrated(lines, line)
    notes = [*reset, _places_text(points, "probe_offset_mm" in given)]
    alike = _with_one_geometry(lines, reports)
    if len(alike) > 1:
        notes.append(f"Heights: {len(alike)} passes over all points with one geometry.")
    if len(reports) > len(alike):
        notes.append(f"Not read: {len(reports) - len(alike)} earlier lines of heights.")
    return [
        point.contact(gcode.finite(cell, report))
        for report, of_report in alike
        for point, cell in zip(points.values(), of_report, strict=True)
    ], notes


def _with_one_geometry(
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
    """Whether a line of a log changes the geometry or the probe."""
    is_set = any(command.words for command in gcode.commands([line], *CHANGING))
    return is_set or CALIBRATED.search(line.text) is not None


def mesh_offset(
    order: ExecutionOrder, given: Mapping[str, tuple[float, ...]]
) -> tuple[float, float]:
    """Place of the probe from the nozzle (2,), mm, at the nodes of a mesh."""
    probes = _Probes(order)
    stated = given.get("probe_offset_mm")
    if stated is not None:
        return stated[0], stated[1]
    return probes.offset(Command("G29", {}, order.lines[0])) or (0.0, 0.0)


def _points(
    order: ExecutionOrder, given: Mapping[str, tuple[float, ...]]
) -> tuple[dict[int, ProbePoint], list[str]]:
    """The last G30 of each point, by its number, and sentences. Raises InputError."""
    probes = _Probes(order)
    stated = given.get("probe_offset_mm")
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
    """A sentence on the places of the nozzle."""
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
        sentence = _offset_text(alike.pop() or (0.0, 0.0), source)
    if typed:
        sentence += (
            f"; the height of point {', '.join(typed)} was typed (Z of G30), and is that of"
            " the nozzle at the place itself"
        )
    return sentence + "."


def _offset_text(offset: tuple[float, float], source: str) -> str:
    x, y = offset
    if not (x or y):
        return f"Places: those of the nozzle, where the probe is ({source})"
    return (
        f"Places: the probe is at x {x:+g}, y {y:+g} mm of the nozzle ({source}), so the"
        f" nozzle was at x {0.0 - x:+g}, y {0.0 - y:+g} mm of the places of G30"
    )


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
