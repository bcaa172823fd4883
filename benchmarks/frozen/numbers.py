"""The numbers of a JSON document by path, and how far two such sets are apart."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

#: relative difference of numbers that nothing draws, and difference of drawn ones in
#: standard deviations, or relative where the document states none
COMPUTED, DRAWN = 1e-9, 1e-3
#: below this share of the largest number of its list, a number is rounding
NOTHING = 1e-12
#: sections whose numbers rest on random draws
DRAWN_SECTIONS = re.compile(
    r"^(posterior|prediction|held_out|gap|corrected|estimate|goodness\.noise"
    r"|plan|design\.robust|where|closure|answers|set95|marginal|noise)\b"
)
#: run times, versions, and the study's text
IGNORED = re.compile(r"(^|\.)(seconds|version|versions|study_text|traceback)(\.|\[|$)")


@dataclasses.dataclass(frozen=True, slots=True)
class Difference:
    """A number that is not what it was.

    path     of the number in its document
    before   frozen value; None where the number is new
    after    value now; None where the number is gone
    size     over its tolerance
    """

    path: str
    before: float | None
    after: float | None
    size: float


def numbers(document: Any) -> dict[str, float]:
    """Numbers of a JSON document by path, such as `estimate.parameters.R.sd`.

    Names of answers count as well: each is a number 1 under its own path.
    """
    return {p: v for p, v in _walk(document, "") if not IGNORED.search(p)}


def differences(
    before: Mapping[str, float], after: Mapping[str, float]
) -> list[Difference]:
    """Numbers that differ by more than their tolerance, the largest first."""
    found = []
    for path in sorted(before.keys() | after.keys()):
        old, new = before.get(path), after.get(path)
        if old is None or new is None:
            found.append(Difference(path, old, new, math.inf))
            continue
        size = _size(path, old, new, before)
        if size > 1.0:
            found.append(Difference(path, old, new, size))
    return sorted(found, key=lambda d: -d.size)


def _size(path: str, old: float, new: float, before: Mapping[str, float]) -> float:
    """Difference over its tolerance."""
    if old == new or (math.isnan(old) and math.isnan(new)):
        return 0.0
    if not (math.isfinite(old) and math.isfinite(new)):
        return math.inf
    magnitude = max(abs(old), abs(new))
    tolerance = COMPUTED * magnitude
    if DRAWN_SECTIONS.match(path):
        sd = before.get(f"{path.rpartition('.')[0]}.sd", 0.0)
        tolerance = max(DRAWN * magnitude, DRAWN * sd)
    return abs(new - old) / max(tolerance, NOTHING)


def _walk(value: Any, path: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _walk(inner, f"{path}.{name}" if path else str(name))
    elif isinstance(value, list):
        yield f"{path}.length", float(len(value))
        for k, inner in enumerate(value):
            yield from _walk(inner, f"{path}[{k}]")
    elif isinstance(value, bool | int | float):
        yield path, float(value)
    elif isinstance(value, str) and re.search(r"(verdict|effects\[\d+\])$", path):
        yield f"{path}={value}", 1.0
