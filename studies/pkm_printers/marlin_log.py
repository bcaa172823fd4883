"""Probed points of a Marlin log, and the settings that were in force when they were.

Settings are followed line by line: M665, M666, M206, M851 and M92 as typed or printed, and
what G33 prints of its own changes (".Height: ... Radius: ...", ". Tx: ... Ty: ..."). Points
that were probed with another geometry than the last one are left out.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence

from pkm_printers import gcode
from pkm_printers.gcode import ENDS, NUMBER, Command, TextLine
from pkm_printers.marlin_g33 import ReportScan, report_contacts
from pkm_printers.marlin_means import Contact
from pkm_printers.marlin_version import NOT_READ, RADIUS, PossibleRules
from pkm_studies.base import InputError

#: a probed point: `Bed X: 0 Y: 0 Z: 0.1`, in old versions `Bed x:` or `Bed Position X:`
BED = re.compile(
    rf"Bed\s+(?:Position\s+)?X:\s*({NUMBER})\s+Y:\s*({NUMBER})\s+Z:\s*({NUMBER}){ENDS}",
    re.IGNORECASE,
)
#: how such a line begins
BED_LINE = re.compile(r"Bed\s+(?:Position\s+)?X:", re.IGNORECASE)
CHANGED = re.compile(rf"\b(Height|Ex|Ey|Ez|Radius|Tx|Ty|Tz):\s*({NUMBER})")
#: a line of G33's report, after what a host writes before it
REPORT = re.compile(r"(?:^|[\s:<>])\.(?=\s|Height:|Tower)")
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
FOLLOWED = ("M665", "M666", "M206", "M851", "M92")
#: what is known once the geometry is, and what two points must have in common
NEEDED, GEOMETRY = ("M665", "M666"), ("M665", "M666", "M206", "M851")
NO_POINTS = (
    "probe with G30 X<x> Y<y> at seven points or more, and log the answers: Bed X: Y: Z:"
    " (G33 prints heights with V3, and with P3 those of single places)"
)


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
        return all(name in self.words for name in NEEDED)

    def geometry(self, rules: PossibleRules) -> dict[str, float]:
        """What two points must have in common."""
        others = "SB" if rules.agreed("b") in (RADIUS, NOT_READ) else "S"
        return {
            f"{name} {letter}": self.command(name).number(letter)
            for name in GEOMETRY
            for letter in self.words.get(name, {})
            if letter not in others
        }


@dataclasses.dataclass(frozen=True)
class Probing:
    """Contacts with the settings in force, and sentences on what was taken.

    offset  of the probe from the nozzle (2,), mm
    """

    contacts: list[Contact]
    settings: Settings
    notes: list[str]
    offset: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class _Taken:
    """A contact with the settings that it was probed with."""

    contact: Contact
    settings: Settings


def probing(
    lines: Sequence[TextLine],
    given: Mapping[str, tuple[float, ...]],
    rules: PossibleRules,
) -> Probing:
    """Contacts that were probed with the last geometry. Raises InputError.

    given  numbers of lines that a user added
    """
    scan = _Scan(rules)
    for at, line in enumerate(lines):
        scan.take(line, at)
    taken, notes = list(scan.taken), list(scan.notes)
    reports = scan.reports.reports
    if len(reports) > 1:
        notes.append(f"Not read: {len(reports) - 1} earlier reports of G33.")
    if reports:
        settings = scan.settings_of[len(reports) - 1]
        delta, probe = settings.command("M665"), settings.command("M851")
        contacts = report_contacts(
            lines, reports[-1], delta, probe, given, rules, notes
        )
        taken += [_Taken(contact, settings) for contact in contacts]
    if not taken:
        files_read = gcode.files_of(lines)
        raise InputError("no probed points in it", NO_POINTS, file=files_read)
    taken.sort(key=lambda one: one.settings.at)
    settings = taken[-1].settings
    if settings.is_complete:
        wanted = settings.geometry(rules)
        used = [one for one in taken if one.settings.geometry(rules) == wanted]
        if len(used) < len(taken):
            notes.append(
                f"Not read: {len(taken) - len(used)} points that were probed with"
                " another geometry than the last one."
            )
    else:
        used, settings = taken, scan.settings(lines[-1], len(lines))
    contacts = [one.contact for one in used]
    offset = _offset(settings, given, contacts, notes)
    of_nozzle = [contact.of_nozzle(offset) for contact in contacts]
    return Probing(of_nozzle, settings, notes, offset)


class _Scan:
    """Follows a log line by line: settings, points, and reports of G33."""

    def __init__(self, rules: PossibleRules) -> None:
        self.rules = rules
        self.words: dict[str, dict[str, str]] = {}
        self.places: dict[str, TextLine] = {}
        self.taken: list[_Taken] = []
        self.reports = ReportScan()
        self.settings_of: list[Settings] = []
        self.notes: list[str] = []

    def settings(self, line: TextLine, at: int) -> Settings:
        """The settings as they are now."""
        words = {name: dict(letters) for name, letters in self.words.items()}
        return Settings(words, dict(self.places), line, at)

    def take(self, line: TextLine, at: int) -> None:
        """Take one line."""
        for command in gcode.commands([line], *FOLLOWED):
            self._take_command(command)
        self.reports.take_request(line)
        match = BED.search(line.text)
        if match is None and BED_LINE.search(line.text):
            problem = "this is no point: Bed X: Y: Z: with a number each"
            raise line.error(problem, "correct the line, or remove it from a copy")
        if match:
            x, y, z = (gcode.finite(match[k], line) for k in (1, 2, 3))
            contact = Contact.at(x, y, z, is_probe=True)
            self.taken.append(_Taken(contact, self.settings(line, at)))
        if REPORT.search(line.text):
            self._take_change(line)
            if self.reports.take(line):
                self.settings_of.append(self.settings(line, at))

    def _take_command(self, command: Command) -> None:
        """Take the words of a command as the firmware does."""
        words = dict(command.words)
        known = self.words.setdefault(command.name, {})
        if command.name == "M666":
            words = self._accepted(command)
        elif command.name == "M851":
            self._check_height(command)
        elif command.name == "M665":
            words = self._turned(command)
        known.update(words)
        self.places[command.name] = command.line

    def _accepted(self, command: Command) -> dict[str, str]:
        """Words of M666 without those that the firmware ignores. Raises InputError."""
        above = [k for k in "XYZ" if command.number(k, 0.0) > 0.0]
        if not above:
            return command.words
        letters = ", ".join(above)
        treatment = self.rules.agreed("positive")
        if treatment is None:
            raise command.line.error(
                "versions of Marlin ignore a value above 0, or make no move, or change"
                " H by it",
                "add a line firmware_version = 2.1.2, with the version of your printer",
                f"M666 {letters}",
            )
        if treatment != "ignored":
            return command.words
        self.notes.append(
            f"Not read: M666 {letters} (line {command.line.number}): the firmware ignores"
            " values above 0."
        )
        return {k: v for k, v in command.words.items() if k not in above}

    def _turned(self, command: Command) -> dict[str, str]:
        """Words of M665; Z taken off X and Y where the version does so."""
        by = command.number("Z", 0.0)
        if not (by and self.rules.agreed("turns_by_z")):
            return command.words
        known = Command("M665", self.words["M665"] | command.words, command.line)
        angles = {k: f"{known.number(k, 0.0) - by!r}" for k in "XY"}
        return command.words | angles | {"Z": "0"}

    def _check_height(self, command: Command) -> None:
        """Refuse a change of M851 Z where it changes M665 H. Raises InputError."""
        known = self.words["M851"].get("Z")
        if known is None or "Z" not in command.words:
            return
        if not self.rules.agreed("probe_moves_height"):
            return
        if float(known) != command.number("Z"):
            raise command.line.error(
                "this version changes M665 H with M851 Z",
                "give a log with one M851 Z: M503, then the probing",
                "M851 Z",
            )

    def _take_change(self, line: TextLine) -> None:
        """What G33 prints of the geometry that it has set."""
        for name, value in CHANGED.findall(line.text):
            command, letter = WORD_OF[name]
            self.words.setdefault(command, {})[letter] = value


def _offset(
    settings: Settings,
    given: Mapping[str, tuple[float, ...]],
    contacts: Sequence[Contact],
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
            f" the nozzle was at x {0.0 - x:+g}, y {0.0 - y:+g} mm of the printed places."
        )
    else:
        notes.append(f"Places: those of the nozzle, where the probe is ({source}).")
    return x, y
