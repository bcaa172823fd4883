"""Probed points of a Marlin log, and the settings that were in force when they were.

Settings are followed line by line: M665, M666, M206 and M851 as typed or printed, and
what G33 prints of its own changes (".Height: ... Radius: ...", ".Tower angle : ...").
Points that were probed with another geometry than the last one are left out.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from pkm_studies.errors import InputError
from pkm_studies.importers import gcode
from pkm_studies.importers.delta_probe import ProbedPoint
from pkm_studies.importers.gcode import NUMBER, Command, TextLine
from pkm_studies.importers.marlin_version import RADIUS, MeaningOfB

BED = re.compile(rf"Bed\s+X:\s*({NUMBER})\s+Y:\s*({NUMBER})\s+Z:\s*({NUMBER})")
ITERATION = re.compile(rf"\b(c|x|y|z|yz|zx|xy):\s*({NUMBER})")
PRINTED_RADIUS = re.compile(rf"\bat radius:\s*({NUMBER})")
#: a line of G33's report, after the prefix of a host or a time
REPORT = re.compile(r"(?:[^.]*?(?:Recv|RX)\S*\s+|<+\s*|\d[\d:.]*\s*:\s+)?\.\s")
CHANGED = re.compile(rf"\b(Height|Ex|Ey|Ez|Radius|Tx|Ty|Tz):\s*({NUMBER})")
IS_CHANGE = re.compile(r"\.(?:Height:|Tower angle\s*:)")
#: the word that each number of G33's report of a change stands for
WORD_OF = {
    "Height": ("M665", "H"),
    "Radius": ("M665", "R"),
    "Tx": ("M665", "X"),
    "Ty": ("M665", "Y"),
    "Tz": ("M665", "Z"),
    "Ex": ("M666", "X"),
    "Ey": ("M666", "Y"),
    "Ez": ("M666", "Z"),
}
FOLLOWED = ("M665", "M666", "M206", "M851")
#: what says whether two points were probed with one geometry
GEOMETRY = ("M665", "M666")
#: angles of G33's points, deg
ANGLES = {"x": 210.0, "xy": 270.0, "y": 330.0, "yz": 30.0, "z": 90.0, "zx": 150.0}
NO_POINTS = "probe with G30 X<x> Y<y> at seven points or more, and log the answers: Bed X: Y: Z:"


@dataclasses.dataclass(frozen=True)
class Settings:
    """Words of the commands that are followed, as they were at a line.

    lines  where each command was last
    last   the line, and its number among all in `at`
    """

    words: Mapping[str, Mapping[str, str]]
    lines: Mapping[str, TextLine]
    last: TextLine
    at: int

    def command(self, name: str) -> Command:
        """A command with its words; without any where it was not given."""
        line = self.lines.get(name, self.last)
        return Command(name, dict(self.words.get(name, {})), line)

    @property
    def is_complete(self) -> bool:
        """Whether the geometry is known."""
        return all(name in self.words for name in GEOMETRY)

    def geometry(self, b: MeaningOfB | None) -> dict[str, float]:
        """What two points must have in common; `b` says what M665 B is."""
        others = "SB" if b == RADIUS else "S"
        return {
            f"{name} {letter}": self.command(name).number(letter)
            for name in GEOMETRY
            for letter in self.words.get(name, {})
            if letter not in others
        }


@dataclasses.dataclass(frozen=True)
class Probing:
    """Points with the settings in force, and sentences on what was taken."""

    points: list[ProbedPoint]
    settings: Settings
    notes: list[str]


class _Contact(NamedTuple):
    """A printed point: its place, its height, whether the place is the probe's; mm."""

    x: float
    y: float
    z: float
    is_probe: bool
    settings: Settings


class _Report(NamedTuple):
    """Heights of one G33 report by point, with its last line and the words of G33."""

    heights: dict[str, float]
    line: TextLine
    words: Mapping[str, str]
    settings: Settings


def probing(
    lines: Sequence[TextLine],
    given: Mapping[str, tuple[float, ...]],
    b: MeaningOfB | None,
) -> Probing:
    """Points that were probed with the last geometry. Raises InputError.

    given  numbers of lines that a user added
    b      what M665 B is
    """
    scan = _Scan()
    for at, line in enumerate(lines):
        scan.take(line, at)
    contacts, reports, notes = scan.contacts, scan.reports, []
    if len(reports) > 1:
        notes.append(f"Not read: {len(reports) - 1} earlier reports of G33.")
    if reports:
        radius = _radius(lines, reports[-1], given, b, notes)
        contacts += _of_report(reports[-1], radius)
    if not contacts:
        files_read = gcode.files_of(lines)
        raise InputError("no probed points in it", NO_POINTS, file=files_read)
    contacts.sort(key=lambda contact: contact.settings.at)
    settings = contacts[-1].settings
    if settings.is_complete:
        wanted = settings.geometry(b)
        used = [c for c in contacts if c.settings.geometry(b) == wanted]
        if len(used) < len(contacts):
            notes.append(
                f"Not read: {len(contacts) - len(used)} points that were probed with"
                " another geometry than the last one."
            )
    else:
        used, settings = contacts, scan.settings(lines[-1], len(lines))
    offset = _offset(settings, given, used, notes)
    return Probing([_nozzle(c, offset) for c in used], settings, notes)


class _Scan:
    """Follows a log line by line: settings, points, and reports of G33."""

    def __init__(self) -> None:
        self.words: dict[str, dict[str, str]] = {}
        self.places: dict[str, TextLine] = {}
        self.asked: Mapping[str, str] = {}
        self.contacts: list[_Contact] = []
        self.reports: list[_Report] = []

    def settings(self, line: TextLine, at: int) -> Settings:
        """The settings as they are now."""
        words = {name: dict(letters) for name, letters in self.words.items()}
        return Settings(words, dict(self.places), line, at)

    def take(self, line: TextLine, at: int) -> None:
        """Take one line."""
        for command in gcode.commands([line], *FOLLOWED, "G33"):
            if command.name == "G33":
                self.asked = command.words
                continue
            self.words.setdefault(command.name, {}).update(command.words)
            self.places[command.name] = line
        if IS_CHANGE.search(line.text):
            self._take_change(line)
        match = BED.search(line.text)
        if match:
            x, y, z = (gcode.finite(match[k], line) for k in (1, 2, 3))
            self.contacts.append(_Contact(x, y, z, True, self.settings(line, at)))
        if REPORT.match(line.text):
            self._take_report(line, at)

    def _take_change(self, line: TextLine) -> None:
        """What G33 prints of the geometry that it has set."""
        for name, value in CHANGED.findall(line.text):
            command, letter = WORD_OF[name]
            self.words.setdefault(command, {})[letter] = value

    def _take_report(self, line: TextLine, at: int) -> None:
        """Heights of a line of G33's report, if it is one."""
        for name, value in ITERATION.findall(line.text):
            if name == "c" or not self.reports:
                now = self.settings(line, at)
                self.reports.append(_Report({}, line, self.asked, now))
            report = self.reports[-1]
            report.heights[name] = gcode.finite(value, line)
            self.reports[-1] = report._replace(line=line)


def _of_report(report: _Report, radius: float) -> Iterator[_Contact]:
    """The points of a report; G33 puts the nozzle there, or with O the probe."""
    is_probe = "O" in report.words
    for name, height in report.heights.items():
        if name == "c":
            yield _Contact(0.0, 0.0, height, is_probe, report.settings)
            continue
        angle = math.radians(ANGLES[name])
        x, y = radius * math.cos(angle), radius * math.sin(angle)
        yield _Contact(x, y, height, is_probe, report.settings)


def _radius(
    lines: Sequence[TextLine],
    report: _Report,
    given: Mapping[str, tuple[float, ...]],
    b: MeaningOfB | None,
    notes: list[str],
) -> float:
    """The radius, mm, that G33 probed at. Raises InputError."""
    if "probe_radius_mm" in given:
        return given["probe_radius_mm"][0]
    matches = ((line, PRINTED_RADIUS.search(line.text)) for line in lines)
    printed = [gcode.finite(match[1], line) for line, match in matches if match]
    if printed:
        return printed[-1]
    delta, probe = report.settings.command("M665"), report.settings.command("M851")
    offset = [probe.number(letter, 0.0) for letter in "XY"]
    if b == RADIUS and "B" in delta.words and not any(offset):
        notes.append("G33 probed at the radius of calibration, M665 B.")
        return delta.number("B")
    raise report.line.error(
        "G33 does not print the radius at which it probed",
        "add a line probe_radius_mm = 80 to the log, or probe with G30",
    )


def _offset(
    settings: Settings,
    given: Mapping[str, tuple[float, ...]],
    contacts: Sequence[_Contact],
    notes: list[str],
) -> tuple[float, float]:
    """Where the probe is from the nozzle, mm; adds a sentence."""
    if not any(contact.is_probe for contact in contacts):
        notes.append("Places: those of the nozzle, which G33 puts there.")
        return 0.0, 0.0
    probe, source = settings.command("M851"), "M851"
    if "probe_offset_mm" in given:
        x, y = given["probe_offset_mm"]
        source = "probe_offset_mm"
    elif {"X", "Y"} & set(probe.words):
        x, y = probe.number("X", 0.0), probe.number("Y", 0.0)
    else:
        notes.append(
            "Places: those of the nozzle. The log has no M851 with X and Y; where the probe"
            " is beside the nozzle (X_PROBE_OFFSET_FROM_EXTRUDER), add a line"
            " probe_offset_mm = x, y, or the fit bends."
        )
        return 0.0, 0.0
    if x or y:
        notes.append(
            f"Places: the probe is at x {x:+g}, y {y:+g} mm of the nozzle ({source}), so"
            f" the nozzle was at x {0.0 - x:+g}, y {0.0 - y:+g} mm of the places Bed X: Y:."
        )
    else:
        notes.append(f"Places: those of the nozzle, where the probe is ({source}).")
    return x, y


def _nozzle(contact: _Contact, offset: tuple[float, float]) -> ProbedPoint:
    x, y = offset if contact.is_probe else (0.0, 0.0)
    return ProbedPoint(contact.x - x, contact.y - y, contact.z)
