"""What a person may have typed in place of a number: digits exchanged, a sign, a point."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from oed.checks.far_reading import FarReading
from oed.checks.session import SessionReadings

#: standard deviations of what all others predict within which another number fits, and
#: from which on the one of the file is so far off that a fitting one says something
FITS, FAR = 4.0, 40.0


def other_number(session: SessionReadings, one: FarReading) -> str:
    """Which slip of the hand explains a far reading, as a sentence; empty for none."""
    factor = session.column(str(session.values["channel"].iloc[one.value])).factor
    value = float(session.y[one.value]) / factor
    predicted = value - one.error / factor
    sd = abs(one.error / one.pull) / factor
    if abs(one.pull) < FAR:
        return ""
    fitting = [
        (abs(number - predicted), words, number)
        for words, number in _slips(value)
        if abs(number - predicted) < FITS * sd
    ]
    if not fitting:
        return ""
    _, words, number = min(fitting)
    return f" With {words} it is {number:.9g}, which fits."


def _slips(value: float) -> Iterator[tuple[str, float]]:
    """Numbers that may have been meant, in words."""
    yield "the other sign", -value
    for power in (-3, -2, -1, 1, 2, 3):
        yield "its decimal point elsewhere", value * 10.0**power
    digits = list(f"{abs(value):.9g}")
    places = [k for k, digit in enumerate(digits) if digit.isdigit()]
    for j, k in itertools.pairwise(places):
        if digits[j] != digits[k]:
            other = digits.copy()
            other[j], other[k] = digits[k], digits[j]
            sign = -1.0 if value < 0.0 else 1.0
            yield "two neighbouring digits exchanged", sign * float("".join(other))
