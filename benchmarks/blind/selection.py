"""Selection of the cases that count for a measure."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.blind.entries import Entry

#: sqrt(lambda) from which on a case counts as visible
VISIBLE = 6.0
#: severities in the labels are sizes wanted; those reached differ by less than this
#: share
TOLERANCE = 1e-3


def reaches(severity: float, wanted: float) -> bool:
    """Whether a severity is reached, but for what the generator's search leaves."""
    return severity >= wanted * (1.0 - TOLERANCE)


def visible(e: Entry) -> bool:
    """Whether every effect of a case has sqrt(lambda) >= 6."""
    return reaches(e.severity, VISIBLE)


def separated(e: Entry) -> bool:
    """Whether every known effect has sqrt(lambda_k|j) >= 6 from every rival."""
    return reaches(e.separation, VISIBLE)


def singles(entries: Sequence[Entry]) -> list[Entry]:
    """Cases of one known effect."""
    return [e for e in entries if e.kind == "single"]


def visible_singles(entries: Sequence[Entry]) -> list[Entry]:
    """Cases of one known effect that the readings can test, at sqrt(lambda) >= 6."""
    return [e for e in singles(entries) if e.testable and visible(e)]


def separated_singles(entries: Sequence[Entry]) -> list[Entry]:
    """Cases of one known effect that the readings test and separate from every rival."""
    return [e for e in singles(entries) if e.testable and separated(e)]


def pairs(entries: Sequence[Entry], *, apart: bool = True) -> list[Entry]:
    """Cases of two known effects, both visible, separated from every rival if `apart`."""
    every = [e for e in entries if e.kind == "pair" and e.testable and visible(e)]
    return [e for e in every if not apart or separated(e)]


def outside_library(entries: Sequence[Entry]) -> list[Entry]:
    """Cases with an unknown effect outside the library's span."""
    return [e for e in entries if e.unknown and reaches(e.beyond, VISIBLE)]


def clear(entries: Sequence[Entry]) -> list[Entry]:
    """Cases whose truth is visible: for the 95 % set."""
    selected = []
    for e in entries:
        known = e.testable and (not e.known or visible(e))
        unknown = not e.unknown or reaches(e.beyond, VISIBLE)
        if e.kind == "null" or (known and unknown):
            selected.append(e)
    return selected
