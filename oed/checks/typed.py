"""What a person may have typed in place of a number: digits exchanged, a sign, a point."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np

from oed.checks.far_reading import FarReading
from oed.checks.fit import CANNOT_BE, Fit
from oed.checks.session import SessionReadings
from oed.dataset.columns import column_name, parse_column
from oed.measurement.measurement import Series

#: standard deviations of what all others predict within which another number fits, and
#: from which on the one of the file is so far off that a fitting one says something
FITS, FAR = 4.0, 40.0
#: digits of a command beyond which a program wrote it, and no hand
TYPED = 5


def other_number(session: SessionReadings, solution: Fit, one: FarReading) -> str:
    """Which slip of the hand explains a far reading, as a sentence; empty for none.

    solution  fit of the other readings
    """
    if abs(one.pull) < FAR:
        return ""
    return _other_reading(session, one) or _other_command(session, solution, one)


def _other_reading(session: SessionReadings, one: FarReading) -> str:
    factor = session.column(str(session.values["channel"].iloc[one.value])).factor
    value = float(session.y[one.value]) / factor
    predicted = value - one.error / factor
    sd = abs(one.error / one.pull) / factor
    fitting = [
        (abs(number - predicted), words, number)
        for words, number in _slips(value)
        if abs(number - predicted) < FITS * sd
    ]
    if not fitting:
        return ""
    _, words, number = min(fitting)
    return f" With {words} it is {number:.9g}, which fits."


def _other_command(session: SessionReadings, solution: Fit, one: FarReading) -> str:
    """The same of one command of the row, in all that was read there."""
    measurement = session.measurement
    part = session.take(np.array([one.reading]))
    sigma = measurement.sigma(part.series)
    tried = []
    for words, series in _with_other_commands(part):
        error = np.abs(part.y - measurement.try_readings([series], solution.theta))
        if np.isfinite(error).all():
            tried.append((float((error / sigma).max()), words, series, error))
    if not tried:
        return ""
    _, words, series, error = min(tried, key=lambda one: one[0])
    jacobian = measurement.jacobian([series], solution.theta)
    spread = jacobian @ session.prior_root() @ solution.half_covariance()
    fits = (error < FITS * np.hypot(sigma, np.linalg.norm(spread, axis=1))).all()
    return f" With {words}, it fits." if fits else ""


def _with_other_commands(part: SessionReadings) -> Iterator[tuple[str, Series]]:
    """A reading with each slip in a command of its row undone, in words."""
    (series,), measurement = part.series, part.measurement
    place = series.index[0, 0]
    tool = np.array(measurement.setups[series.setup].tool)
    for k, coordinate in enumerate(measurement.machine.command):
        column = column_name(coordinate.name, coordinate.unit)
        factor = parse_column(column).factor
        written = float(series.command[place, k]) / factor
        if len(f"{abs(written):.9g}".replace(".", "")) > TYPED:
            continue
        for words, number in _slips(written):
            command = series.command.copy()
            command[place, k] = number * factor
            try:
                x, q = measurement.kinematics.sent(command, tool)
            except CANNOT_BE:
                continue
            there = dataclasses.replace(series, q=q, start=x, command=command)
            yield f"{words} of the command, {column} = {number:.9g}", there


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
