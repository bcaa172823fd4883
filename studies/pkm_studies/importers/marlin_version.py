"""What M665 B is by version of Marlin, and the version that a log shows.

A, B, C are trims of the rods in 2.0.6 and later (pull request 18423) and before 1.1.1.
In between M665 B is the radius that G33 probes at, and rod trims are compiled in.
"""

from __future__ import annotations

import re
from typing import Final, Literal

#: what M665 B is
RodTrim = Literal["rod trim"]
CalibrationRadius = Literal["calibration radius"]
MeaningOfB = RodTrim | CalibrationRadius
ROD_TRIM: Final[RodTrim] = "rod trim"
RADIUS: Final[CalibrationRadius] = "calibration radius"
#: first version with M665 H and XYZ, in which B is a radius; first with rod trims again
FIRST_RADIUS, FIRST_TRIM = (1, 1, 1), (2, 0, 6)
PRINTED = re.compile(r"\bMarlin[ _-]?(?:bugfix[-_ ])?(\d+\.\d+(?:\.\w+)*)")


def numbers(version: str) -> tuple[int, ...]:
    """Numbers of a version: (2, 0, 5) of `2.0.5.3` or of `Marlin 2.0.5`; () of none."""
    match = re.search(r"\d+(?:\.\d+)*", version)
    return () if match is None else tuple(map(int, match[0].split(".")))[:3]


def meaning_of_b(version: str) -> MeaningOfB | None:
    """What M665 B is in a version; None where the version does not tell."""
    known = numbers(version)
    if len(known) < 2:
        return None
    if known == (1, 1):
        return RADIUS
    if known == (2, 0):
        return None
    return RADIUS if FIRST_RADIUS <= known < FIRST_TRIM else ROD_TRIM


def has_height(version: str) -> bool:
    """Whether M665 has H and XYZ in a version."""
    known = numbers(version)
    return not known or known == (1, 1) or known >= FIRST_RADIUS


def printed_version(text: str) -> str | None:
    """The version in a line that the firmware printed; None without."""
    match = PRINTED.search(text)
    return None if match is None else match[1]
