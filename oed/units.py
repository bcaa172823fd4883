"""Units at the edge: the only file that holds a unit factor.

Inside, every number is SI (metre, radian, second, newton, kelvin). A unit lives in the
name of a field or a column (`sigma_um`, `theta_deg`) and is split off here.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from oed.arrays import Array

#: unit suffix -> (SI unit, factor to SI)
UNITS: Final[dict[str, tuple[str, float]]] = {
    "m": ("m", 1.0),
    "mm": ("m", 1e-3),
    "um": ("m", 1e-6),
    "nm": ("m", 1e-9),
    "rad": ("rad", 1.0),
    "mrad": ("rad", 1e-3),
    "urad": ("rad", 1e-6),
    "deg": ("rad", math.pi / 180.0),
    "arcsec": ("rad", math.pi / 648000.0),
    "s": ("s", 1.0),
    "min": ("s", 60.0),
    "h": ("s", 3600.0),
    "N": ("N", 1.0),
    "C": ("K", 1.0),  # a temperature difference to the reference state
    "ppm": ("1", 1e-6),
    "1": ("1", 1.0),
}

#: what a person wants to read a quantity in, by its SI unit
DISPLAY: Final[dict[str, str]] = {
    "m": "mm",
    "rad": "mrad",
    "s": "min",
    "N": "N",
    "K": "C",
    "1": "1",
}

#: the finer unit in which residual errors are told
FINE: Final[dict[str, str]] = {
    "m": "um",
    "rad": "arcsec",
    "s": "s",
    "N": "N",
    "K": "C",
    "1": "ppm",
}


class UnitError(ValueError):
    """A unit that is not known, or not of the wanted kind."""


def factor(unit: str) -> float:
    """Factor that turns a value in `unit` into SI; raises UnitError for an unknown
    unit.
    """
    return _entry(unit)[1]


def si_unit(unit: str) -> str:
    """SI unit ("m", "rad", "s", "N", "K" or "1") that `unit` measures."""
    return _entry(unit)[0]


def to_si(value: ArrayLike, unit: str) -> Array:
    """Values given in `unit` as SI floats."""
    return np.asarray(value, dtype=float) * factor(unit)


def from_si(value: ArrayLike, unit: str) -> Array:
    """SI values as floats in `unit`."""
    return np.asarray(value, dtype=float) / factor(unit)


def number(value: float, unit: str) -> float:
    """One SI value as a plain float in `unit`."""
    return float(from_si(value, unit))


def split(name: str) -> tuple[str, str]:
    """`sigma_um` -> ("sigma", "um"). Raises UnitError where the name ends in no known
    unit.
    """
    stem, _, unit = name.rpartition("_")
    if not stem or unit not in UNITS:
        raise UnitError(
            f"the name {name!r} carries no known unit; end it in one of"
            f" {', '.join(sorted(UNITS))}"
        )
    return stem, unit


def display(unit: str) -> str:
    """Unit in which a person reads a quantity whose SI unit is `unit`."""
    return DISPLAY[unit]


def _entry(unit: str) -> tuple[str, float]:
    try:
        return UNITS[unit]
    except KeyError:
        raise UnitError(
            f"unknown unit {unit!r}; known are {', '.join(sorted(UNITS))}"
        ) from None
