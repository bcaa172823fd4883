"""Unit factors and conversions; no other file holds a unit factor.

Inside, every number is SI (metre, radian, second, newton, kelvin). Files and tables
carry the unit in the name of a field or column (`sigma_um`, `theta_deg`).
"""

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from oed.base import Array

MM: Final = 1e-3  #: factors to SI: `3.0 * MM` is three millimetres in metres
UM: Final = 1e-6
NM: Final = 1e-9
INCH: Final = 25.4e-3
MRAD: Final = 1e-3
URAD: Final = 1e-6
DEG: Final = math.pi / 180.0
ARCSEC: Final = math.pi / 648000.0
MINUTE: Final = 60.0
HOUR: Final = 3600.0
MM_PER_MIN: Final = MM / MINUTE
PPM: Final = 1e-6
MS: Final = 1e-3
MEGABYTE: Final = 1e6

#: ppm in a percent: from there on a ratio is stated in percent
PPM_A_PERCENT: Final = 1e4

#: unit suffix -> (SI unit, factor to SI)
UNITS: Final[dict[str, tuple[str, float]]] = {
    "m": ("m", 1.0),
    "mm": ("m", MM),
    "um": ("m", UM),
    "nm": ("m", NM),
    "in": ("m", INCH),
    "rad": ("rad", 1.0),
    "mrad": ("rad", MRAD),
    "urad": ("rad", URAD),
    "deg": ("rad", DEG),
    "arcsec": ("rad", ARCSEC),
    "s": ("s", 1.0),
    "min": ("s", MINUTE),
    "h": ("s", HOUR),
    "N": ("N", 1.0),
    "C": ("K", 1.0),  # a temperature difference to the reference state
    "ppm": ("1", PPM),
    "1": ("1", 1.0),
}

#: unit in which a person reads a quantity, by its SI unit
DISPLAY: Final[dict[str, str]] = {
    "m": "mm",
    "rad": "mrad",
    "s": "min",
    "N": "N",
    "K": "C",
    "1": "1",
}

#: unit of an effect's coefficient and its factor to SI, by its SI unit
EFFECT: Final[dict[str, tuple[str, float]]] = {
    "m": ("um", UM),
    "rad": ("urad", URAD),
    "s": ("ms", MS),
    "s2": ("ms2", MS**2),
    "K": ("C", 1.0),
    "1": ("ppm", PPM),
    "1/K": ("ppm/K", PPM),
    "1/N": ("ppm/N", PPM),
}

#: finer unit for residuals and predicted errors, by SI unit
FINE: Final[dict[str, str]] = {
    "m": "um",
    "rad": "arcsec",
    "s": "s",
    "N": "N",
    "K": "C",
    "1": "ppm",
}


class UnitError(ValueError):
    """A unit that is unknown, or that measures another kind of quantity."""


def factor(unit: str) -> float:
    """Factor that turns a value in `unit` into SI. Raises UnitError."""
    return _entry(unit)[1]


def si_unit(unit: str) -> str:
    """SI unit (m, rad, s, N, K or 1) of the quantity `unit` measures. Raises UnitError."""
    return _entry(unit)[0]


def to_si(value: ArrayLike, unit: str) -> Array:
    """Convert values in `unit` to SI. Raises UnitError."""
    return np.asarray(value, dtype=float) * factor(unit)


def from_si(value: ArrayLike, unit: str) -> Array:
    """Convert SI values to `unit`. Raises UnitError."""
    return np.asarray(value, dtype=float) / factor(unit)


def number(value: float, unit: str) -> float:
    """Convert one SI value to a plain float in `unit`. Raises UnitError."""
    return float(from_si(value, unit))


def coefficient_unit(si: str) -> tuple[str, float]:
    """Unit in which a person reads an effect's coefficient, and its factor to SI."""
    return EFFECT.get(si, (si, 1.0))


def split(name: str) -> tuple[str, str]:
    """Split a name from its unit: `sigma_um` gives ("sigma", "um"). Raises UnitError."""
    stem, _, unit = name.rpartition("_")
    if not stem or unit not in UNITS:
        raise UnitError(
            f"the name {name!r} carries no known unit; end it in one of {', '.join(sorted(UNITS))}"
        )
    return stem, unit


def display(si: str) -> str:
    """Unit in which a person reads a quantity with SI unit `si`."""
    return DISPLAY[si]


def quantity(value: float, si: str) -> str:
    """An SI value in its fine unit, three digits: `12.3 um`."""
    unit = FINE[si]
    return f"{number(value, unit):.3g} {unit}"


def _entry(unit: str) -> tuple[str, float]:
    if unit not in UNITS:
        raise UnitError(f"unknown unit {unit!r}; known are {', '.join(sorted(UNITS))}")
    return UNITS[unit]
