"""Numbers and words of findings."""

from __future__ import annotations

import math
from collections.abc import Sequence

from oed.dataset.file_rows import Row

#: digits of a number that a person reads
DIGITS = 4
#: rows that a sentence names, at most
NAMED = 6


def rounded(value: float, sd: float) -> str:
    """A number to the first digit of its standard deviation, without trailing zeros.

    It has DIGITS digits at most.
    """
    if not math.isfinite(sd) or sd <= 0.0 or value == 0.0:
        return f"{value:.{DIGITS}g}"
    by_sd = -math.floor(math.log10(sd))
    by_size = DIGITS - 1 - math.floor(math.log10(abs(value)))
    places = max(0, min(by_sd, by_size))
    text = f"{value:.{places}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def capital(text: str) -> str:
    """A text with a capital at its beginning."""
    return text[:1].upper() + text[1:]


def listing(rows: Sequence[Row]) -> str:
    """`rows 3, 7, ...`."""
    shown = ", ".join(str(k) for k in rows[:NAMED])
    more = ", ..." if len(rows) > NAMED else ""
    return f"row{'s' if len(rows) > 1 else ''} {shown}{more}"
