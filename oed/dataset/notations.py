"""What a column of poses may mean instead of what its header says."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from oed import units
from oed.base import Array
from oed.model import Coordinate

#: values (n,) of a column as they should be, SI, from those of the file
Notation = Callable[[Array], Array]

#: a right angle, rad, and what a circle has of other units
RIGHT_ANGLE, GRADS, DEGREES = np.pi / 2.0, 400.0, 360.0
#: what a value is, over what it should be
FACTORS = {"half of": 0.5, "twice": 2.0, "a tenth of": 0.1, "ten times": 10.0}
#: minutes of a degree, seconds of a minute; rounding of decimals, in minutes
SIXTY, ROUNDED = 60.0, 1e-6


def notations(coordinate: Coordinate, values: Array) -> dict[str, Notation]:
    """Other meanings of a column of a coordinate, in words with `{}` for its name.

    values  (n,) all that the column has, SI
    """
    changes = dict(_of_angle(values) if coordinate.unit == "rad" else OF_LENGTH)
    ends = {
        "values": float(values.min() + values.max()),
        "range": coordinate.lower + coordinate.upper,
    }
    known = {0.0}
    for name, end in ends.items():
        if np.isfinite(end) and round(end, 9) not in known:
            known.add(round(end, 9))
            words = f"{{}} is counted from the other end of its {name}"
            changes[words] = partial(np.subtract, end)
    has_sign = coordinate.lower < 0.0 < coordinate.upper
    if has_sign or coordinate.unit == "rad":
        changes["the sign of {} is reversed"] = np.negative
    for words, factor in FACTORS.items():
        meant = partial(np.multiply, 1.0 / factor)
        changes[f"{{}} is {words} what it should be"] = meant
    return changes


OF_LENGTH: dict[str, Notation] = {
    "{} is in inch, not in mm": partial(np.multiply, units.INCH / units.MM),
    "{} is in mm of a sheet in inch": partial(np.multiply, units.MM / units.INCH),
    "{} is in um, not in mm": partial(np.multiply, units.UM / units.MM),
    "{} is in m, not in mm": partial(np.multiply, 1.0 / units.MM),
}


def _of_angle(values: Array) -> dict[str, Notation]:
    changes: dict[str, Notation] = {
        "{} is counted from the other axis, as 90 deg less it": partial(
            np.subtract, RIGHT_ANGLE
        ),
        "{} is in rad, not in deg": partial(np.multiply, 1.0 / units.DEG),
        "{} is in deg of a sheet in rad": partial(np.multiply, units.DEG),
        "{} is in grad, not in deg": partial(np.multiply, DEGREES / GRADS),
        "{} is in deg of a sheet in grad": partial(np.multiply, GRADS / DEGREES),
    }
    for words, meant in SEXAGESIMAL.items():
        if np.isfinite(meant(values)).all():
            changes[f"{{}} has {words} after its decimal point"] = meant
    return changes


def _sexagesimal(values: Array, *, with_seconds: bool) -> Array:
    """Angles, rad, of degrees with minutes in place of decimals; NaN where they are none."""
    size = np.abs(values) / units.DEG
    whole = np.floor(size + ROUNDED)
    minutes = 100.0 * np.maximum(size - whole, 0.0)
    if with_seconds:
        full = np.floor(minutes + ROUNDED)
        seconds = 100.0 * np.maximum(minutes - full, 0.0)
        minutes = np.where(seconds < SIXTY, full + seconds / SIXTY, np.nan)
    degrees = np.where(minutes < SIXTY, whole + minutes / SIXTY, np.nan)
    return np.asarray(np.sign(values) * degrees * units.DEG)


#: angles whose decimals are something else, in words
SEXAGESIMAL: dict[str, Notation] = {
    "minutes": partial(_sexagesimal, with_seconds=False),
    "minutes and seconds": partial(_sexagesimal, with_seconds=True),
}
