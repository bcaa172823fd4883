"""Noise of one reading from readings that a log repeats at one place.

About the mean of each place, n readings have n - 1 degrees of freedom. The sums of squares of
all places over the sum of these is the variance of one reading: the pooled spread. It holds
neither the flatness of a bed nor what a run shares, so the noise may still be estimated from it
upward.
"""

import dataclasses
import math
import re
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from pkm_printers import gcode
from pkm_printers.bed_mesh import ProbedPoint
from pkm_printers.delta_study import Offset
from pkm_printers.gcode import NUMBER, TextLine

MIN_FREEDOM: Final = 4  #: degrees of freedom from which on a spread is known to a third
#: readings of one place, line after line: what names the place, and the reading
READINGS: Final = (
    # Klipper, each sample of a probe, and PROBE_ACCURACY
    re.compile(rf"probe at (?P<place>\S+,\S+) is z=(?P<value>{NUMBER})", re.IGNORECASE),
    # Marlin, M48 V4
    re.compile(rf"(?P<place>)\d+ of \d+:?\s+z:\s*(?P<value>{NUMBER})", re.IGNORECASE),
    # RepRapFirmware, G30 S-1
    re.compile(rf"(?P<place>)Stopped at height\s+(?P<value>{NUMBER})", re.IGNORECASE),
    # Maslow, the four readings of a belt
    re.compile(
        rf"MSG:\s*INFO:\s*(?P<place>(?:Top|Bottom) (?:Left|Right))\s+(?P<value>{NUMBER})"
    ),
)
#: the end of M48 without its single readings: the root of their mean square deviation
SUMMARY: Final = re.compile(rf"Standard Deviation:\s*({NUMBER})", re.IGNORECASE)
HEADING: Final = re.compile(r"M48 Z-Probe", re.IGNORECASE)
USUAL_SAMPLES: Final = 10.0
MOVES: Final = ("G0", "G1", "G28", "M48")  #: moves that end the readings of a place


@dataclasses.dataclass(frozen=True)
class PooledSpread:
    """A pooled spread."""

    sigma: float  #: standard deviation of one reading, mm
    freedom: int  #: degrees of freedom
    places: int  #: number of places with repeated readings

    @property
    def is_known(self) -> bool:
        """Whether it stands for the noise of one reading."""
        return self.freedom >= MIN_FREEDOM and self.sigma > 0.0

    def sentence(self) -> str:
        """What the readings say of the noise."""
        where = f"{self.places} place{'s' if self.places > 1 else ''}"
        beginning = (
            f"Noise: repeated readings at {where} spread by {1e3 * self.sigma:.3g} um, with"
            f" {self.freedom} degrees of freedom"
        )
        if self.is_known:
            error = 100.0 / math.sqrt(2.0 * self.freedom)
            return f"{beginning}: the noise of one reading, known to {error:.0f} %."
        return f"{beginning}, too few to stand for the noise, which is assumed."


def pooled(groups: Iterable[Sequence[float]]) -> PooledSpread | None:
    """The spread of readings (n,) by place, mm; None where none is repeated."""
    repeated = [np.asarray(group, float) for group in groups if len(group) > 1]
    freedom = sum(len(group) - 1 for group in repeated)
    if not freedom:
        return None
    squares = sum(float(((group - group.mean()) ** 2).sum()) for group in repeated)
    return PooledSpread(math.sqrt(squares / freedom), freedom, len(repeated))


def repeated_in_log(lines: Sequence[TextLine]) -> list[list[float]]:
    """Readings of a log that were taken at one place, mm, a list for each."""
    groups: list[list[float]] = []
    last = ""
    samples = USUAL_SAMPLES
    singles = False
    for line in lines:
        if any(gcode.commands([line], *MOVES)):
            last = ""
        for command in gcode.commands([line], "M48"):
            if not HEADING.search(line.text):
                samples = command.number("P", USUAL_SAMPLES)
                singles = False
        for kind, pattern in enumerate(READINGS):
            match = pattern.search(line.text)
            if match is None:
                continue
            place = f"{kind} {match['place']}"
            if place != last:
                groups.append([])
            groups[-1].append(gcode.finite(match["value"], line))
            last = place
            singles = True
        summary = SUMMARY.search(line.text)
        if summary and not singles:
            groups.append(_add_deviation(gcode.finite(summary[1], line), samples))
    return groups


def _add_deviation(deviation: float, samples: float) -> list[float]:
    """As many readings as were taken, with their root mean square deviation."""
    count = max(2, round(samples))
    signs = [(-1.0) ** k for k in range(2 * (count // 2))]
    values = [deviation * math.sqrt(count / len(signs)) * sign for sign in signs]
    return values + [0.0] * (count % 2)


def heights_by_place(points: Iterable[ProbedPoint]) -> list[list[float]]:
    """Heights of points, mm, in lists by place and probe."""
    groups: dict[tuple[float, float, Offset], list[float]] = {}
    for point in points:
        groups.setdefault((point.x, point.y, point.probe), []).append(point.z)
    return list(groups.values())
