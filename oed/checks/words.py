"""Numbers and words of findings."""

from __future__ import annotations

import math

#: digits of a number that a person reads
DIGITS = 4


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
