"""Probed points of a Marlin log, and the settings that were in force when they were.

Settings are followed line by line: M665, M666, M206, M851 and M92 as typed or printed, and
what G33 prints of its own changes (".Height: ... Radius: ...", ". Tx: ... Ty: ..."). Points
that were probed with another geometry than the last one are left out.
"""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import optimize

from oed.base import Array
from pkm_printers import gcode
from pkm_printers.bed_mesh import ProbedPoint, offset_sentence
from pkm_printers.delta_geometry import DeltaGeometry
from pkm_printers.gcode import ENDS, NUMBER, Command, TextLine
from pkm_printers.marlin_version import INNER, NOT_READ, RADIUS, PossibleRules
from pkm_studies.base import InputError

# Heights of Marlin's G33 that are means over several places, as heights of one place.
#
# With P3 and more G33 prints seven means: of readings about the middle, and of readings on
# a ring, each of which counts to its two neighbours among six directions by the square of
# a cosine (src/gcode/calibrate/G33.cpp). A mean less what a fitted delta has as its mean,
# plus what that has at the place itself, is the height there. The fit is that of the
# radius, two angles and three endstops to all means.

#: the six directions of G33's ring, in its order: degrees from x
DIRECTIONS = {"x": 210.0, "xy": 270.0, "y": 330.0, "yz": 30.0, "z": 90.0, "zx": 150.0}
INNER_RING = 0.1  #: radius of the inner ring over that of the outer one
#: places of the outer ring for a step of one direction, by P
FINENESS = {3: 1, 4: 2, 5: 3, 6: 5, 7: 7, 8: 3, 9: 4, 10: 5}
CIRCLES_FROM = 8  #: P from which on a ring has three circles
WITHOUT_MIDDLE = (3, 6, 9)  #: P without a reading in the middle
MISCOUNTED = 8  #: P whose sum of ten readings is divided by eight
MISCOUNT = 10.0 / 8.0  #: its mean over the true one
USUAL_POINTS = 4  #: P of Marlin's example configurations
LAST_DIGIT_MM = 0.01  #: mm; the last digit that G33 prints
#: standard deviations of the delta's numbers about the firmware's, mm and deg, for a fit
#: to fewer means than unknowns
TOLERANCE = np.array([5.0, 2.0, 2.0, 5.0, 5.0, 5.0])


@dataclasses.dataclass(frozen=True)
class Contact:
    """A printed height, mm, and where it was probed.

    x, y      the place that it stands for, mm
    z         the height
    places    (n, 2) that were probed, mm
    weights   (n,) of them in the height
    is_probe  whether places are the probe's, and not the nozzle's
    unsure    line of a report whose P the log does not show; None where it is known
    """

    x: float
    y: float
    z: float
    places: Array
    weights: Array
    is_probe: bool
    unsure: TextLine | None = None

    @classmethod
    def single(cls, x: float, y: float, z: float, *, is_probe: bool) -> Contact:
        """A reading at one place."""
        return cls(x, y, z, np.array([[x, y]]), np.ones(1), is_probe)

    @property
    def is_mean(self) -> bool:
        """Whether the height is a mean over other places than its own."""
        return bool(np.abs(self.places - [self.x, self.y]).max() > 0.0)

    def moved_to_nozzle(self, offset: tuple[float, float]) -> Contact:
        """The same with places of the nozzle, the probe at an offset from it."""
        if not self.is_probe:
            return self
        x, y = offset
        places = self.places - np.array(offset)
        return dataclasses.replace(
            self, x=self.x - x, y=self.y - y, places=places, is_probe=False
        )


def mean_contact(
    name: str,
    height: float,
    radius: float,
    points: int,
    circles: tuple[float, ...],
    *,
    is_probe: bool,
) -> Contact:
    """A height of G33's report.

    name     c, x, y, z, yz, zx or xy
    radius   of the ring, mm
    points   P of G33
    circles  radii of the three circles of P8 and more, over the ring's
    """
    if name == "c":
        places = _middle(points, radius)
        weights = np.full(len(places), 1.0 / len(places))
        height = height / MISCOUNT if points == MISCOUNTED else height
        return Contact(0.0, 0.0, height, places, weights, is_probe)
    direction = DIRECTIONS[name]
    x, y = _ring_points(direction, radius)
    if points not in FINENESS or points == min(FINENESS):
        return Contact.single(x, y, height, is_probe=is_probe)
    places, weights = _ring(direction, radius, points, circles)
    return Contact(x, y, height, places, weights, is_probe)


def _middle(points: int, radius: float) -> Array:
    """Places (n, 2) whose readings are averaged as that of the middle."""
    middle = [] if points in WITHOUT_MIDDLE else [(0.0, 0.0)]
    if points < min(FINENESS):
        return np.array(middle)
    count = 3 if points < 5 else 6 if points < CIRCLES_FROM else 9
    angles = [DIRECTIONS["x"] + 360.0 * k / count for k in range(count)]
    ring = [_ring_points(angle, INNER_RING * radius) for angle in angles]
    return np.array(middle + ring)


def _ring(
    direction: float, radius: float, points: int, circles: tuple[float, ...]
) -> tuple[Array, Array]:
    """Places (n, 2) whose readings count to a direction, and their weights (n,)."""
    fineness = FINENESS[points]
    factors = circles if points >= CIRCLES_FROM else (1.0,)
    shares = np.arange(1 - fineness, fineness) / fineness
    pairs = list(itertools.product(shares, factors))
    places = [
        _ring_points(direction + 60.0 * share, factor * radius)
        for share, factor in pairs
    ]
    weights = np.array([np.cos(0.5 * np.pi * share) ** 2 for share, _ in pairs])
    return np.array(places), weights / weights.sum()


def _ring_points(direction: float, radius: float) -> tuple[float, float]:
    angle = np.radians(direction)
    return float(radius * np.cos(angle)), float(radius * np.sin(angle))


def points_of_contacts(
    contacts: Sequence[Contact], geometry: DeltaGeometry
) -> tuple[list[ProbedPoint], list[str]]:
    """Heights at single places of the nozzle, and a sentence on what that took.

    geometry  that the firmware had

    Raises InputError where the places decide the heights, and are not known.
    """
    heights = np.array([contact.z for contact in contacts])
    means = [contact for contact in contacts if contact.is_mean]
    if means:
        heights = heights + _corrections(contacts, heights, geometry)
    points = [
        ProbedPoint(contact.x, contact.y, float(height))
        for contact, height in zip(contacts, heights, strict=True)
    ]
    if not means:
        return points, []
    moved = max(abs(p.z - c.z) for p, c in zip(points, contacts, strict=True))
    unsure = next((c.unsure for c in contacts if c.unsure is not None), None)
    if unsure is not None and moved > LAST_DIGIT_MM:
        raise unsure.error(
            "G33 averages its heights over places that P decides, and the log does not"
            " show P",
            "add a line G33 P4 above the report, with the P that was sent, or that of"
            " DELTA_CALIBRATION_DEFAULT_POINTS where none was",
        )
    most = max(len(contact.weights) for contact in means)
    sentence = (
        f"Heights: G33 averages {len(means)} of them over up to {most} places. Each is"
        " turned into the height at its own place, by"
        f" {1000.0 * moved:.0f} um at most, with the delta that fits the means."
    )
    if unsure is not None:
        sentence += f" P is not in the log; that of P{USUAL_POINTS} is as small."
    return points, [sentence]


def _corrections(
    contacts: Sequence[Contact], heights: Array, geometry: DeltaGeometry
) -> Array:
    """Height at each place less the mean (n,), mm, of the delta that fits the means."""
    places = np.concatenate([contact.places for contact in contacts])
    counts = [len(contact.places) for contact in contacts]
    means = np.zeros((len(contacts), len(places)))
    starts = np.cumsum([0, *counts[:-1]])
    for row, (start, contact) in enumerate(zip(starts, contacts, strict=True)):
        means[row, start : start + len(contact.weights)] = contact.weights
    travels = _bed_points(places, geometry)

    def believed(change: Array, travels: Array) -> Array:
        changed = geometry.changed(change)
        return -changed.tool_heights(travels)

    def misses(change: Array) -> Array:
        misfit = (means @ believed(change, travels) - heights) / LAST_DIGIT_MM
        return np.concatenate([misfit, change / TOLERANCE])

    change = optimize.least_squares(misses, np.zeros(len(TOLERANCE))).x
    single = np.array([[contact.x, contact.y] for contact in contacts])
    at_place = believed(change, _bed_points(single, geometry))
    return at_place - means @ believed(change, travels)


def _bed_points(places: Array, geometry: DeltaGeometry) -> Array:
    """Travels (n, 3) to z = 0 at places (n, 2), mm."""
    return geometry.travels(np.pad(places, ((0, 0), (0, 1))))


# Reports of Marlin's G33: heights c, x, y, z, yz, zx, xy about the middle.
#
# "G33 Auto Calibrate" is what the firmware prints when it begins; a line with the words of
# G33 above it is how it was asked for. Without one, P is that of the configuration.

HEIGHT = re.compile(rf"\b(c|x|y|z|yz|zx|xy):\s*({NUMBER}){ENDS}")
PRINTED_RADIUS = re.compile(r"\bat radius:\s*" + f"({NUMBER})")
BEGINS = re.compile(r"\bG33 Auto Calibrate")
ALL_HEIGHTS = 7  #: heights of a report of P3 and more
SINGLE_PLACES = 2  #: P of a report with fewer: its places are single
GIVE_RADIUS = "add a line probe_radius_mm = 80 to the log, or probe with G30"


@dataclasses.dataclass(frozen=True)
class Report:
    """Heights of one report by point, with its last line and the words of its G33."""

    heights: dict[str, float]
    line: TextLine
    #: None where the log does not show how G33 was asked for
    words: Mapping[str, str] | None
    settings: Settings  #: in force when it began

    def contacts(
        self,
        lines: Sequence[TextLine],
        numbers: Mapping[str, tuple[float, ...]],
        rules: PossibleRules,
        notes: list[str],
    ) -> list[Contact]:
        """The heights where they were probed; adds sentences to `notes`.

        numbers  numbers of lines that a user added

        G33 puts the nozzle on its places, or with O the probe. Raises InputError.
        """
        radius = _radius(lines, self, numbers, rules, notes)
        points, unsure = _points(self)
        circles = rules.agreed("circles")
        if circles is None:
            _check_known(self, points, rules)
        is_probe = "O" in (self.words or {})
        contacts = [
            mean_contact(
                name, height, radius, points, circles or INNER, is_probe=is_probe
            )
            for name, height in self.heights.items()
        ]
        return [dataclasses.replace(contact, unsure=unsure) for contact in contacts]


def _points(report: Report) -> tuple[int, TextLine | None]:
    """P of a report, and the report's line where the log does not show it. InputError."""
    words = report.words or {}
    if not words.get("P"):
        if len(report.heights) < ALL_HEIGHTS:
            return SINGLE_PLACES, None
        return USUAL_POINTS, report.line
    text = words["P"]
    points = int(gcode.finite(text, report.line))
    if not 0 <= points <= max(FINENESS):
        raise report.line.error("G33 has P0 to P10", "correct P", f"G33 P{text}")
    return points, None


def _check_known(report: Report, points: int, rules: PossibleRules) -> None:
    """Refuse means over places that are not known. Raises InputError."""
    ancient = all(rule.circles is None for rule in rules.rules)
    if ancient and points > min(FINENESS):
        raise report.line.error(
            f"the heights of G33 P{points} are means over places that this importer"
            " does not know for Marlin before 1.1.7",
            "probe with G33 P3, or with G30 X<x> Y<y>",
        )
    if not ancient and points >= CIRCLES_FROM:
        raise report.line.error(
            f"the places of G33 P{points} depend on the version",
            "add a line firmware_version = 2.1.2, with the version of your printer",
        )


def _radius(
    lines: Sequence[TextLine],
    report: Report,
    numbers: Mapping[str, tuple[float, ...]],
    rules: PossibleRules,
    notes: list[str],
) -> float:
    """The radius, mm, that G33 probed at. Raises InputError."""
    if "probe_radius_mm" in numbers:
        return numbers["probe_radius_mm"][0]
    matches = ((line, PRINTED_RADIUS.search(line.text)) for line in lines)
    printed = [gcode.finite(match[1], line) for line, match in matches if match]
    if printed:
        return printed[-1]
    delta = report.settings.command("M665")
    offset = report.settings.command("M851").numbers("XY")
    if rules.agreed("b") == RADIUS and "B" in delta.words and not offset.any():
        notes.append("G33 probed at the radius of calibration, M665 B.")
        return delta.number("B")
    raise report.line.error(
        "G33 does not print the radius at which it probed", GIVE_RADIUS
    )


# Probed points of a log, and the settings that were in force when they were.

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
    """Words of the commands that are followed, as they were at a line."""

    words: Mapping[str, Mapping[str, str]]
    lines: Mapping[str, TextLine]  #: where each command was last
    last: TextLine  #: the line, and its number among all in `at`
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
    """Contacts with the settings in force, and sentences on what was taken."""

    contacts: list[Contact]
    settings: Settings
    notes: list[str]
    offset: tuple[float, float]  #: of the probe from the nozzle (2,), mm


def probing(
    lines: Sequence[TextLine],
    numbers: Mapping[str, tuple[float, ...]],
    rules: PossibleRules,
) -> Probing:
    """Contacts probed with the last geometry and added numbers. Raises InputError."""
    scan = _Scan(rules)
    for number, line in enumerate(lines):
        scan.take(line, number)
    taken, notes = list(scan.taken), list(scan.notes)
    if len(scan.reports) > 1:
        notes.append(f"Not read: {len(scan.reports) - 1} earlier reports of G33.")
    for report in scan.reports[-1:]:
        contacts = report.contacts(lines, numbers, rules, notes)
        taken += [(contact, report.settings) for contact in contacts]
    if not taken:
        files_read = gcode.files_of(lines)
        raise InputError("no probed points in it", NO_POINTS, file=files_read)
    taken.sort(key=lambda one: one[1].at)
    settings = taken[-1][1]
    contacts = [contact for contact, _ in taken]
    if settings.is_complete:
        wanted = settings.geometry(rules)
        contacts = [c for c, stated in taken if stated.geometry(rules) == wanted]
        if len(contacts) < len(taken):
            notes.append(
                f"Not read: {len(taken) - len(contacts)} points that were probed with"
                " another geometry than the last one."
            )
    else:
        settings = scan.settings(lines[-1], len(lines))
    offset = _offset(settings, numbers, contacts, notes)
    of_nozzle = [contact.moved_to_nozzle(offset) for contact in contacts]
    return Probing(of_nozzle, settings, notes, offset)


class _Scan:
    """Follows a log line by line: settings, points, and reports of G33."""

    def __init__(self, rules: PossibleRules) -> None:
        self.rules = rules
        self.words: dict[str, dict[str, str]] = {}
        self.places: dict[str, TextLine] = {}
        #: single contacts, each with the settings that it was probed with
        self.taken: list[tuple[Contact, Settings]] = []
        self.reports: list[Report] = []
        self.notes: list[str] = []
        #: of the last G33, and whether it did not begin yet
        self._asked: Mapping[str, str] | None = None
        self._is_new = False

    def settings(self, line: TextLine, number: int) -> Settings:
        """The settings as they are now."""
        words = {name: dict(letters) for name, letters in self.words.items()}
        return Settings(words, dict(self.places), line, number)

    def take(self, line: TextLine, number: int) -> None:
        """Take one line."""
        for command in gcode.commands([line], *FOLLOWED):
            self._take_command(command)
        self._take_request(line)
        match = BED.search(line.text)
        if match is None and BED_LINE.search(line.text):
            problem = "this is no point: Bed X: Y: Z: with a number each"
            raise line.error(problem, "correct the line, or remove it from a copy")
        if match:
            x, y, z = (gcode.finite(match[k], line) for k in (1, 2, 3))
            contact = Contact.single(x, y, z, is_probe=True)
            self.taken.append((contact, self.settings(line, number)))
        if REPORT.search(line.text):
            for stated, value in CHANGED.findall(line.text):
                name, letter = WORD_OF[stated]
                self.words.setdefault(name, {})[letter] = value
            self._take_heights(line, number)

    def _take_request(self, line: TextLine) -> None:
        """Take a line that may ask for G33, or say that it begins."""
        if BEGINS.search(line.text):
            if not self._is_new:
                self._asked = None
            self._is_new = False
            return
        for command in gcode.commands([line], "G33"):
            self._asked = command.words
            self._is_new = True

    def _take_heights(self, line: TextLine, number: int) -> None:
        """Take heights of a report; the middle begins a new one."""
        for name, value in HEIGHT.findall(line.text):
            if name == "c" or not self.reports:
                settings = self.settings(line, number)
                self.reports.append(Report({}, line, self._asked, settings))
            report = self.reports[-1]
            report.heights[name] = gcode.finite(value, line)
            self.reports[-1] = dataclasses.replace(report, line=line)

    def _take_command(self, command: Command) -> None:
        words = dict(command.words)
        stored = self.words.setdefault(command.name, {})
        if command.name == "M666":
            words = self._accepted(command)
        elif command.name == "M851":
            self._check_height(command)
        elif command.name == "M665":
            words = self._turned(command)
        stored.update(words)
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
        geometry = Command("M665", self.words["M665"] | command.words, command.line)
        angles = {k: f"{geometry.number(k, 0.0) - by!r}" for k in "XY"}
        return command.words | angles | {"Z": "0"}

    def _check_height(self, command: Command) -> None:
        """Refuse a change of M851 Z where it changes M665 H. Raises InputError."""
        offset = self.words["M851"].get("Z")
        if offset is None or "Z" not in command.words:
            return
        if not self.rules.agreed("probe_moves_height"):
            return
        if float(offset) != command.number("Z"):
            raise command.line.error(
                "this version changes M665 H with M851 Z",
                "give a log with one M851 Z: M503, then the probing",
                "M851 Z",
            )


def _offset(
    settings: Settings,
    numbers: Mapping[str, tuple[float, ...]],
    contacts: Sequence[Contact],
    notes: list[str],
) -> tuple[float, float]:
    """Where the probe is from the nozzle, mm; adds a sentence."""
    if not any(contact.is_probe for contact in contacts):
        notes.append("Places: those of the nozzle, which G33 puts there.")
        return 0.0, 0.0
    probe = settings.command("M851")
    source = "M851"
    if "probe_offset_mm" in numbers:
        x, y = numbers["probe_offset_mm"]
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
    notes.append(f"{offset_sentence((x, y), source, 'the printed places')}.")
    return x, y
