"""What the words of a delta do by version of Marlin, and the version that a log shows.

After the tags 1.1.0-RC5 to 2.1 of Marlin: M665, M666 and M851, homing of an axis, the
height at home. A, B, C of M665 are trims of the rods in 2.0.6 and later (pull request
18423) and before 1.1.0. In 1.1.0 to 1.1.9 M665 B is the radius that G33 probes at, in
2.0.0 to 2.0.5 nothing.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from typing import Any, Final, Literal

RodTrim = Literal["rod trim"]  #: what M665 B is
CalibrationRadius = Literal["calibration radius"]
NotRead = Literal["not read"]
MeaningOfB = RodTrim | CalibrationRadius | NotRead
ROD_TRIM: Final[RodTrim] = "rod trim"
RADIUS: Final[CalibrationRadius] = "calibration radius"
NOT_READ: Final[NotRead] = "not read"
#: versions in the words of people, by what M665 B is in them
VERSIONS: Final[dict[MeaningOfB, str]] = {
    ROD_TRIM: "2.0.6 or later",
    RADIUS: "1.1.0 to 1.1.9",
    NOT_READ: "2.0.0 to 2.0.5",
}
#: what a heading of M503 shows of M665 B
HEADINGS: Final[dict[MeaningOfB, re.Pattern[str]]] = {
    RADIUS: re.compile(r"Delta settings:.*B<calibration radius>"),
    ROD_TRIM: re.compile(
        r"Delta settings:.*ABC[=<]|Delta \(L<diagonal-rod>.*ABC<rod-trim>"
    ),
    NOT_READ: re.compile(
        r"Delta settings:(?!.*(?:B<|ABC)).*XYZ<tower angle corrections>"
    ),
}
#: how far a carriage goes down from its switch at home, M666 aside: not at all, 0.1 mm or
#: seven steps further, or nowhere for a value of up to six steps
Retreat = Literal["exact", "tenth", "steps", "dead band"]
#: what becomes of a value of M666 above 0
Positive = Literal["no move", "normalised", "ignored"]
PRINTED = re.compile(r"\bMarlin[ _-]?(?:bugfix[-_ ])?(\d+\.\d+(?:\.\w+)*(?:-RC\d+)?)")
MIN_STEPS = 6  #: steps that a planned move has at least
STEPS_PER_MM = 80.0  #: steps per mm of a usual printer
TENTH_MM = 0.1


@dataclasses.dataclass(frozen=True, kw_only=True, slots=True)
class MarlinRules:
    """What one range of versions does."""

    since: tuple[int, ...]  #: its first version, as a key
    b: MeaningOfB  #: what M665 B is
    retreat: Retreat  #: how far carriages go down from their switches at home
    positive: Positive  #: what becomes of M666 above 0
    #: whether M665 has H (home height) and X, Y, Z (tower angles)
    has_height: bool = True
    #: whether M665 Z is taken off X and Y, and no angle of its own
    turns_by_z: bool = False
    probe_moves_height: bool = False  #: whether a change of M851 Z changes M665 H
    #: whether the nozzle is at M665 H less M851 Z at home
    counts_to_probe: bool = False
    reads_to_bed: bool = True  #: whether printed heights have M851 Z added
    #: places of G33 about a ring: radii over its radius; None where its points are not
    #: known
    circles: tuple[float, ...] | None = None


WIDE, INNER = (0.9, 1.0, 1.1), (0.8, 0.9, 1.0)
#: what each range of versions does otherwise than the one before; release candidates
#: first: the last number of a key says whether it is a release
CHANGES: Final[tuple[tuple[tuple[int, ...], dict[str, Any]], ...]] = (
    (
        (1, 1, 0, 0, 1),
        {
            "b": RADIUS,
            "positive": "normalised",
            "has_height": True,
            "turns_by_z": True,
            "probe_moves_height": True,
            "reads_to_bed": True,
        },
    ),
    ((1, 1, 2, 0, 1), {"retreat": "tenth"}),
    ((1, 1, 6, 0, 1), {"positive": "ignored", "turns_by_z": False}),
    ((1, 1, 7, 0, 1), {"probe_moves_height": False, "circles": WIDE}),
    ((1, 1, 9, 0, 1), {"retreat": "steps", "circles": INNER}),
    ((1, 1, 9, 1, 1), {"counts_to_probe": True}),
    ((2, 0, 0, 0, 1), {"b": NOT_READ}),
    ((2, 0, 6, 0, 1), {"b": ROD_TRIM, "retreat": "dead band"}),
)


def _all_rules() -> tuple[MarlinRules, ...]:
    """The rules of every range of versions, the oldest first."""
    rules = [
        MarlinRules(
            since=(0, 0, 0, 0, 1),
            b=ROD_TRIM,
            retreat="exact",
            positive="no move",
            has_height=False,
            reads_to_bed=False,
        )
    ]
    for since, changes in CHANGES:
        rules.append(dataclasses.replace(rules[-1], since=since, **changes))
    return tuple(rules)


ALL_RULES: Final = _all_rules()


@dataclasses.dataclass(frozen=True)
class PossibleRules:
    """The ranges of versions that a printer may have."""

    rules: tuple[MarlinRules, ...]

    def agreed(self, name: str) -> Any:
        """What all of them do; None where they differ."""
        values = {getattr(rule, name) for rule in self.rules}
        return values.pop() if len(values) == 1 else None

    def where(self, **values: object) -> PossibleRules:
        """Those with these values; all where none has them."""
        chosen = [
            rule
            for rule in self.rules
            if all(getattr(rule, name) == value for name, value in values.items())
        ]
        return PossibleRules(tuple(chosen)) if chosen else self


EVERY: Final = PossibleRules(ALL_RULES)


def numbers(version: str) -> tuple[int, ...]:
    """Numbers of a version: (2, 0, 5, 3) of `2.0.5.3` or `Marlin 2.0.5.3`; () of none."""
    match = re.search(r"\d+(?:\.\d+)*", version)
    return () if match is None else tuple(map(int, match[0].split(".")))[:4]


def possible_rules(version: str | None) -> PossibleRules:
    """The rules of a version: several of `2.0`, all of one that is not known."""
    parts = () if version is None else numbers(version)
    if version is None or len(parts) < 2:
        return EVERY
    is_release = 0 if "RC" in version.upper() else 1
    if len(parts) == 2:
        return PossibleRules(tuple(_versions_between((*parts, 0), (*parts, 99))))
    first = (*parts, *[0] * (4 - len(parts)), is_release)
    return PossibleRules(tuple(_versions_between(first, first)))


def _versions_between(
    first: tuple[int, ...], last: tuple[int, ...]
) -> Iterator[MarlinRules]:
    ends = [rule.since for rule in ALL_RULES[1:]]
    for rule, end in zip(ALL_RULES, [*ends, (99,)], strict=True):
        if rule.since <= last and end > first:
            yield rule


def printed_version(text: str) -> str | None:
    """The version in a line that the firmware printed; None without."""
    match = PRINTED.search(text)
    return None if match is None else match[1]


def dead_band(steps_per_mm: float) -> float:
    """Size of M666, mm, up to which a firmware with a dead band makes no move."""
    return MIN_STEPS / steps_per_mm


def home_offset(
    rules: PossibleRules, probe_z: float | None, steps_per_mm: float | None
) -> float | None:
    """Height of the nozzle at home over M665 H, M666 aside, mm.

    probe_z       M851 Z, mm; None where it is not known
    steps_per_mm  of the towers; None where it is not known, which matters little

    None where the version or M851 Z is not known.
    """
    retreat, to_probe = rules.agreed("retreat"), rules.agreed("counts_to_probe")
    if retreat is None or to_probe is None or (to_probe and probe_z is None):
        return None
    further = {
        "tenth": TENTH_MM,
        "steps": (MIN_STEPS + 1) / (steps_per_mm or STEPS_PER_MM),
    }
    height = further.get(retreat, 0.0)
    return height - probe_z if to_probe and probe_z is not None else height
