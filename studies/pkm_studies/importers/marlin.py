"""Marlin: M665 and M666 of a delta, and the points of G30, G29 or G33.

`M503` prints M665, M666 and M851. G30 and G29 print "Bed X: .. Y: .. Z: .." a point. G33
V0 prints the heights c, x, y, z, yz, zx, xy at the middle and every 60 degrees from 210.
Newer versions print their radius as well, "at radius:80.00"; a line `probe_radius_mm =
80`, added to the log of others, says it. Lines may have the prefixes of a host's log.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pkm_studies.importers import facts, gcode, marlin_words
from pkm_studies.importers.base import ImportedSession, ImportRequest
from pkm_studies.importers.delta_probe import delta_session
from pkm_studies.importers.delta_study import DeltaGeometry, Firmware
from pkm_studies.importers.gcode import Command, TextLine
from pkm_studies.importers.marlin_log import Probing, Settings, probing
from pkm_studies.importers.marlin_version import (
    RADIUS,
    ROD_TRIM,
    MeaningOfB,
    meaning_of_b,
    printed_version,
)

ANGLES = {"X": 210.0, "Y": 330.0, "Z": 90.0}
NO_TRIMS = (0.0, 0.0, 0.0)
#: M665 B, mm, above which it cannot be the trim of a rod
LONGEST_TRIM = 10.0
#: versions whose M665 has no H
EARLY = "1.1.0 or earlier"
NO_HEIGHT = (
    "this version has none: add a line home_height_mm = 250 with the home height of its"
    " configuration (MANUAL_Z_HOME_POS); M206 Z is added to it"
)
NO_M503 = "log the answer of M503 as well: it prints M665 and M666"

#: numbers that a user added, by name
Given = Mapping[str, tuple[float, ...]]


class MarlinImporter:
    """Reads logs with the answers of M503 and of probing."""

    name = "marlin"
    about = "Marlin delta: log with M665, M666 (M503) and G30, G29 or G33"

    def read(self, request: ImportRequest) -> ImportedSession:
        """Geometry and probed points. Raises InputError."""
        lines = gcode.read(request.files)
        given = facts.numbers(lines)
        delta = gcode.merged(lines, "M665", NO_M503)
        version = _version(lines, delta)
        b = _meaning_of_b(lines, delta, version)
        table = marlin_words.table(b, has_height="H" in delta.words)
        account = gcode.account_of(lines, table)
        probed = probing(lines, given, b)
        return delta_session(
            name=request.name,
            firmware=Firmware(
                name="marlin",
                title="Marlin",
                version=version,
                m665_b=b,
                radius_trim_mm=given.get("radius_trim_mm", ()),
                rod_trim_mm=given.get("rod_trim_mm", ()),
            ),
            files=", ".join(path.name for path in request.files),
            geometry=_geometry(probed, given, b),
            points=probed.points,
            accounts=account.sentences(),
            notes=[*_about_b(b, probed.settings), *probed.notes],
        )


importer = MarlinImporter()


def _version(lines: Sequence[TextLine], delta: Command) -> str | None:
    """The version that a user states, or that the log shows, last or by its words."""
    printed = [v for line in lines if (v := printed_version(line.raw)) is not None]
    version = facts.version(lines) or (printed[-1] if printed else None)
    is_early = version is None and "H" not in delta.words
    return EARLY if is_early else version


def _meaning_of_b(
    lines: Sequence[TextLine], delta: Command, version: str | None
) -> MeaningOfB | None:
    """What M665 B is: by the heading of M503, then by the letters, then by the version.

    None where there is no B. Raises InputError where nothing tells.
    """
    headings = [line.raw for line in lines if "Delta settings" in line.raw]
    if any("B<calibration radius>" in heading for heading in headings):
        return RADIUS
    if {"A", "C"} & set(delta.words):
        return ROD_TRIM
    by_version = None if version is None else meaning_of_b(version)
    if "B" not in delta.words or by_version is not None:
        return by_version
    if abs(delta.number("B")) > LONGEST_TRIM:
        return RADIUS
    raise delta.line.error(
        "B is the trim of a rod in Marlin 2.0.6 and later, and the radius of calibration"
        " in 1.1.1 to 2.0.5",
        "add a line firmware_version = 2.0.5, with the version of your printer",
        "M665 B",
    )


def _about_b(b: MeaningOfB | None, settings: Settings) -> list[str]:
    delta = settings.command("M665")
    if "B" not in delta.words:
        return []
    if b == RADIUS:
        return [
            f"M665 B{delta.words['B']} is the radius of calibration, as in Marlin 1.1.1 to"
            " 2.0.5, and no trim of a rod."
        ]
    return ["M665 A, B, C are trims of the rods, as in Marlin 2.0.6 and later."]


def _geometry(probed: Probing, given: Given, b: MeaningOfB | None) -> DeltaGeometry:
    settings = probed.settings
    delta, stops = settings.command("M665"), settings.command("M666")
    trims = given.get("rod_trim_mm", NO_TRIMS)
    if b == ROD_TRIM:
        trims = tuple(delta.number(letter, 0.0) for letter in "ABC")
    rod = delta.number("L")
    height = _home_height(settings, given)
    return DeltaGeometry(
        radius=delta.number("R"),
        arms=tuple(rod + trim for trim in trims),
        angles=tuple(angle + delta.number(t, 0.0) for t, angle in ANGLES.items()),
        # an adjustment of -0.5 lowers the tower from its switch: that is higher by 0.5
        endstops=tuple(height - stops.number(tower, 0.0) for tower in ANGLES),
        radius_trim=given.get("radius_trim_mm", NO_TRIMS),
    )


def _home_height(settings: Settings, given: Given) -> float:
    """Height of the tool at home: M665 H; without, the configuration's and M206 Z."""
    delta, shift = settings.command("M665"), settings.command("M206")
    for letter in "XY":
        if shift.number(letter, 0.0) != 0.0:
            raise shift.line.error(
                "home is off the middle, which moves all carriages",
                "set it to 0 (M206 X0 Y0), home, probe again",
                f"M206 {letter}",
            )
    if "H" in delta.words:
        return delta.number("H")
    stated = given.get("home_height_mm")
    if stated is None:
        raise delta.line.error("M665 has no H", NO_HEIGHT)
    return stated[0] + shift.number("Z", 0.0)
