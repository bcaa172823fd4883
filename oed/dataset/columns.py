"""Columns of a readings file: labels, covariates, and names that carry their unit."""

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Final

import numpy as np

from oed import units
from oed.base import Array
from oed.instrument import Channel, Instrument
from oed.model import Coordinate, Machine

# What a column of poses may mean instead of what its header says.

#: values (n,) of a column as they should be, SI, from those of the file
Notation = Callable[[Array], Array]

RIGHT_ANGLE = np.pi / 2.0  #: a right angle, rad
TURN_GRAD = 400.0  #: grads of a full circle
TURN_DEG = 360.0  #: degrees of a full circle
#: what a value is, over what it should be
WRONG_FACTORS = {"half of": 0.5, "twice": 2.0, "a tenth of": 0.1, "ten times": 10.0}
MINUTES = 60.0  #: minutes of a degree, and seconds of a minute
MINUTE_TOLERANCE = 1e-6  #: rounding of decimals, in minutes


def column_meanings(coordinate: Coordinate, values: Array) -> dict[str, Notation]:
    """Other meanings of a column of a coordinate, in words with `{}` for its name.

    values  (n,) all that the column has, SI
    """
    changes = dict(_angle_meanings(values) if coordinate.unit == "rad" else OF_LENGTH)
    ends = {
        "values": float(values.min() + values.max()),
        "range": coordinate.lower + coordinate.upper,
    }
    ends_tried = {0.0}
    for name, end in ends.items():
        if np.isfinite(end) and round(end, 9) not in ends_tried:
            ends_tried.add(round(end, 9))
            phrase = f"{{}} is counted from the other end of its {name}"
            changes[phrase] = partial(np.subtract, end)
    has_sign = coordinate.lower < 0.0 < coordinate.upper
    if has_sign or coordinate.unit == "rad":
        changes["the sign of {} is reversed"] = np.negative
    for phrase, factor in WRONG_FACTORS.items():
        meant = partial(np.multiply, 1.0 / factor)
        changes[f"{{}} is {phrase} what it should be"] = meant
    return changes


OF_LENGTH: dict[str, Notation] = {
    "{} is in inch, not in mm": partial(np.multiply, units.INCH / units.MM),
    "{} is in mm of a sheet in inch": partial(np.multiply, units.MM / units.INCH),
    "{} is in um, not in mm": partial(np.multiply, units.UM / units.MM),
    "{} is in m, not in mm": partial(np.multiply, 1.0 / units.MM),
}


def _angle_meanings(values: Array) -> dict[str, Notation]:
    changes: dict[str, Notation] = {
        "{} is counted from the other axis, as 90 deg less it": partial(
            np.subtract, RIGHT_ANGLE
        ),
        "{} is 90 deg too high, counted from another axis": partial(
            np.add, -RIGHT_ANGLE
        ),
        "{} is 90 deg too low, counted from another axis": partial(np.add, RIGHT_ANGLE),
        "{} is 180 deg off, counted from the opposite axis": partial(np.add, np.pi),
        "{} is in rad, not in deg": partial(np.multiply, 1.0 / units.DEG),
        "{} is in deg of a sheet in rad": partial(np.multiply, units.DEG),
        "{} is in grad, not in deg": partial(np.multiply, TURN_DEG / TURN_GRAD),
        "{} is in deg of a sheet in grad": partial(np.multiply, TURN_GRAD / TURN_DEG),
    }
    for phrase, meant in SEXAGESIMAL.items():
        if np.isfinite(meant(values)).all():
            changes[f"{{}} has {phrase} after its decimal point"] = meant
    return changes


def _sexagesimal(values: Array, *, with_seconds: bool) -> Array:
    """Angles, rad, of degrees with minutes in place of decimals; NaN where they are none."""
    size = np.abs(values) / units.DEG
    whole = np.floor(size + MINUTE_TOLERANCE)
    minutes = 100.0 * np.maximum(size - whole, 0.0)
    if with_seconds:
        full = np.floor(minutes + MINUTE_TOLERANCE)
        seconds = 100.0 * np.maximum(minutes - full, 0.0)
        minutes = np.where(seconds < MINUTES, full + seconds / MINUTES, np.nan)
    degrees = np.where(minutes < MINUTES, whole + minutes / MINUTES, np.nan)
    return np.asarray(np.sign(values) * degrees * units.DEG)


#: angles whose decimals are something else, in words
SEXAGESIMAL: dict[str, Notation] = {
    "minutes": partial(_sexagesimal, with_seconds=False),
    "minutes and seconds": partial(_sexagesimal, with_seconds=True),
}


LABELS: Final = ("setup", "run")  #: columns of text
REQUIRED: Final = ("setup", "run", "order")  #: columns that every file has
#: columns without a unit in their name
UNITLESS: Final = (*REQUIRED, "direction", "repeat")
#: SI unit by covariate; temperatures of bodies, `temp_<body>_C`, come in addition
COVARIATES: Final[Mapping[str, str]] = {
    "time": "s",
    "direction": "1",
    "feed": "m/s",
    "payload": "N",
    "repeat": "1",
}
#: tension of a cable, `tension_<k>_N`, k from 1 as its joint
TENSION: Final = "tension_"
SIGMA: Final = "sigma_"  #: standard deviation of one reading, `sigma_<channel>_<unit>`
#: unit of a feed: the only one with an underscore of its own
FEED_UNIT: Final = "mm_min"
#: unit in which a quantity is written, where it is not its SI unit
_WRITTEN: Final = {"m": "mm", "rad": "deg", "K": "C", "m/s": FEED_UNIT}


@dataclasses.dataclass(frozen=True, slots=True)
class ReadingsColumn:
    """A column of a readings file."""

    name: str  #: as in the header
    stem: str  #: the name without its unit
    unit: str  #: SI unit
    factor: float  #: from the column's numbers to SI

    @classmethod
    def parse(cls, name: str) -> "ReadingsColumn":
        """The column of a name. Raises UnitError where it carries no known unit."""
        if name in UNITLESS:
            return cls(name, name, "1", 1.0)
        if name == f"feed_{FEED_UNIT}":
            return cls(name, "feed", "m/s", units.MM_PER_MIN)
        stem, unit = units.split(name)
        return cls(name, stem, units.si_unit(unit), units.factor(unit))

    @classmethod
    def stem_of(cls, name: str) -> str:
        """Stem of a column's name; the name itself where it has no known unit."""
        try:
            return cls.parse(name).stem
        except units.UnitError:
            return name

    @classmethod
    def of(cls, stem: str, si: str) -> "ReadingsColumn":
        """The column in which a quantity is written: `z_mm`, `psi_deg`, `direction`."""
        if stem in UNITLESS:
            return cls(stem, stem, "1", 1.0)
        unit, factor = _written_unit(si)
        return cls(f"{stem}_{unit}", stem, si, factor)

    @classmethod
    def from_covariate(cls, stem: str) -> "ReadingsColumn | None":
        """The column of a covariate, temperatures and tensions included; None of others."""
        if stem.startswith(TENSION):
            return cls.of(stem, "N")
        if stem in COVARIATES or temperature_body(stem) is not None:
            return cls.of(stem, COVARIATES.get(stem, "K"))
        return None

    @property
    def is_unitless(self) -> bool:
        """Whether the name carries no unit."""
        return self.name == self.stem


def cell(value: float, si: str) -> str:
    """An SI value as it is written in a file; empty where it is not finite."""
    if not math.isfinite(value):
        return ""
    return f"{written(value, si)[0]:.15g}"


def written(value: float, si: str) -> tuple[float, str]:
    """An SI value as it is written in a file, and its unit."""
    unit, factor = _written_unit(si)
    return value / factor, unit


def _written_unit(si: str) -> tuple[str, float]:
    """The unit in which a quantity is written, and its factor to SI."""
    unit = _WRITTEN.get(si, si)
    return unit, units.MM_PER_MIN if unit == FEED_UNIT else units.factor(unit)


def column_names(stem: str, si: str) -> list[str]:
    """All names under which a quantity may be given."""
    return [f"{stem}_{unit}" for unit in units.UNITS if units.si_unit(unit) == si]


def temperature_body(stem: str) -> str | None:
    """The body of a column of temperatures, `temp_<body>`; None of other columns."""
    body = stem.removeprefix("temp_")
    return body if body and body != stem else None


def tension_columns(machine: Machine) -> list[str]:
    """Stems of the tensions of a machine's cables; none where it has no cables."""
    if machine.cable_stiffness is None:
        return []
    return [f"{TENSION}{k + 1}" for k in range(len(machine.joints))]


def expected_columns(
    machine: Machine, instruments: Sequence[Instrument]
) -> dict[str, str]:
    """SI unit of every stem that a column may have, temperatures aside."""
    channels = [c for instrument in instruments for c in instrument.channels]
    expected = {c.name: c.unit for c in (*machine.command, *machine.joints)}
    expected |= {c.name: c.unit for c in channels} | sigma_units(channels)
    for instrument in instruments:
        expected |= instrument.inner_columns
    tensions = dict.fromkeys(tension_columns(machine), "N")
    return {**expected, **COVARIATES, **tensions}


def sigma_units(channels: Iterable[Channel]) -> dict[str, str]:
    """SI unit of the standard deviations of readings, by stem."""
    return {f"{SIGMA}{channel.name}": channel.unit for channel in channels}
