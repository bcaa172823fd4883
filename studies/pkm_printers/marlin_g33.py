"""Reports of Marlin's G33: heights c, x, y, z, yz, zx, xy about the middle.

"G33 Auto Calibrate" is what the firmware prints when it begins; a line with the words of
G33 above it is how it was asked for. Without one, P is that of the configuration.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence

from pkm_printers import gcode
from pkm_printers.gcode import ENDS, NUMBER, Command, TextLine
from pkm_printers.marlin_means import (
    CIRCLES_FROM,
    FINENESS,
    USUAL_POINTS,
    Contact,
    mean_contact,
)
from pkm_printers.marlin_version import INNER, RADIUS, PossibleRules

HEIGHT = re.compile(rf"\b(c|x|y|z|yz|zx|xy):\s*({NUMBER}){ENDS}")
PRINTED_RADIUS = re.compile(r"\bat radius:\s*" + f"({NUMBER})")
BEGINS = re.compile(r"\bG33 Auto Calibrate")
#: heights of a report of P3 and more, and P of one with fewer: its places are single
ALL_HEIGHTS, SINGLE_PLACES = 7, 2
GIVE_RADIUS = "add a line probe_radius_mm = 80 to the log, or probe with G30"


@dataclasses.dataclass(frozen=True)
class Report:
    """Heights of one report by point, with its last line and the words of its G33.

    words  None where the log does not show how G33 was asked for
    """

    heights: dict[str, float]
    line: TextLine
    words: Mapping[str, str] | None


class ReportScan:
    """Follows a log for reports of G33."""

    def __init__(self) -> None:
        self.reports: list[Report] = []
        self._words: Mapping[str, str] | None = None
        self._is_new = False

    def take_request(self, line: TextLine) -> None:
        """Take a line that may ask for G33, or say that it begins."""
        if BEGINS.search(line.text):
            if not self._is_new:
                self._words = None
            self._is_new = False
            return
        for command in gcode.commands([line], "G33"):
            self._words, self._is_new = command.words, True

    def take(self, line: TextLine) -> bool:
        """Take a line of a report; whether it begins a new one."""
        begun = False
        for name, value in HEIGHT.findall(line.text):
            if name == "c" or not self.reports:
                self.reports.append(Report({}, line, self._words))
                begun = True
            report = self.reports[-1]
            report.heights[name] = gcode.finite(value, line)
            self.reports[-1] = dataclasses.replace(report, line=line)
        return begun


def report_contacts(
    lines: Sequence[TextLine],
    report: Report,
    delta: Command,
    probe: Command,
    given: Mapping[str, tuple[float, ...]],
    rules: PossibleRules,
    notes: list[str],
) -> list[Contact]:
    """The heights of a report where they were probed; adds sentences.

    delta, probe  M665 and M851 as they were
    given         numbers of lines that a user added

    G33 puts the nozzle on its places, or with O the probe. Raises InputError.
    """
    radius = _radius(lines, report, delta, probe, given, rules, notes)
    words = report.words or {}
    points, unsure = _points(report)
    circles = rules.agreed("circles")
    if circles is None:
        _check_known(report, points, rules)
    contacts = [
        mean_contact(
            name, height, radius, points, circles or INNER, is_probe="O" in words
        )
        for name, height in report.heights.items()
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
    delta: Command,
    probe: Command,
    given: Mapping[str, tuple[float, ...]],
    rules: PossibleRules,
    notes: list[str],
) -> float:
    """The radius, mm, that G33 probed at. Raises InputError."""
    if "probe_radius_mm" in given:
        return given["probe_radius_mm"][0]
    matches = ((line, PRINTED_RADIUS.search(line.text)) for line in lines)
    printed = [gcode.finite(match[1], line) for line, match in matches if match]
    if printed:
        return printed[-1]
    offset = [probe.number(letter, 0.0) for letter in "XY"]
    if rules.agreed("b") == RADIUS and "B" in delta.words and not any(offset):
        notes.append("G33 probed at the radius of calibration, M665 B.")
        return delta.number("B")
    raise report.line.error(
        "G33 does not print the radius at which it probed", GIVE_RADIUS
    )
