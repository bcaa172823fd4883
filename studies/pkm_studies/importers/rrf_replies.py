"""Answers of RepRapFirmware to M665, M666 and G31, as the commands that they stand for."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

from pkm_studies.importers.gcode import NUMBER, TextLine

DELTA = re.compile(
    rf"Diagonals?\s+(?P<L>{NUMBER}(?::{NUMBER})*),\s*delta radius\s+(?P<R>{NUMBER}),"
    rf"\s*homed height\s+(?P<H>{NUMBER}),\s*bed radius\s+(?P<B>{NUMBER}),"
    rf"\s*X\s+(?P<X>{NUMBER})[^,]*,\s*Y\s+(?P<Y>{NUMBER})[^,]*,\s*Z\s+(?P<Z>{NUMBER})"
)
STOPS = re.compile(
    rf"Endstop adjustments\s+X(?P<X>{NUMBER})\s+Y(?P<Y>{NUMBER})\s+Z(?P<Z>{NUMBER}),"
    rf"\s*tilt\s+X(?P<A>{NUMBER})%\s+Y(?P<B>{NUMBER})%"
)
PROBE = re.compile(
    rf"Z probe(?: (?P<K>\d+))?: current reading.*offsets\s+X(?P<X>{NUMBER})"
    rf"\s+Y(?P<Y>{NUMBER})"
)
REPLIES = {"M665": DELTA, "M666": STOPS, "G31": PROBE}


def as_commands(lines: Sequence[TextLine]) -> list[TextLine]:
    """The lines with each answer written as its command."""
    return [_as_command(line) for line in lines]


def _as_command(line: TextLine) -> TextLine:
    for name, pattern in REPLIES.items():
        match = pattern.search(line.text)
        if match is not None:
            numbers = match.groupdict().items()
            words = [f"{letter}{text}" for letter, text in numbers if text is not None]
            return dataclasses.replace(line, text=" ".join([name, *words]))
    return line
