"""Columns of a readings file: labels, covariates, and names that carry their unit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Final

from oed import units
from oed.instrument import Channel
from oed.model import Machine

#: columns of text
LABELS: Final = ("setup", "run")
#: columns that every file has
REQUIRED: Final = ("setup", "run", "order")
#: columns of numbers without a unit in their name
UNITLESS: Final = ("order", "direction", "repeat")
#: SI unit by covariate; temperatures of bodies, `temp_<body>_C`, come in addition
COVARIATES: Final[Mapping[str, str]] = {
    "time": "s",
    "direction": "1",
    "feed": "m/s",
    "payload": "N",
    "repeat": "1",
}
TEMPERATURE: Final = "temp_"
#: tension of a cable, `tension_<k>_N`, k from 1 as its joint
TENSION: Final = "tension_"
#: standard deviation of one reading, `sigma_<channel>_<unit>`
SIGMA: Final = "sigma_"
#: unit of a feed: the only one with an underscore of its own
FEED_UNIT: Final = "mm_min"
#: unit in which a quantity is written, where it is not its SI unit
_WRITTEN: Final = {"m": "mm", "rad": "deg", "K": "C", "m/s": FEED_UNIT}


@dataclasses.dataclass(frozen=True, slots=True)
class ReadingsColumn:
    """A column of a readings file.

    name    as in the header
    stem    the name without its unit
    unit    SI unit
    factor  from the column's numbers to SI
    """

    name: str
    stem: str
    unit: str
    factor: float


def parse_column(name: str) -> ReadingsColumn:
    """Parse a column's name. Raises UnitError where it carries no known unit."""
    if name in LABELS or name in UNITLESS:
        return ReadingsColumn(name, name, "1", 1.0)
    if name == f"feed_{FEED_UNIT}":
        return ReadingsColumn(name, "feed", "m/s", units.MM_PER_MIN)
    stem, unit = units.split(name)
    return ReadingsColumn(name, stem, units.si_unit(unit), units.factor(unit))


def column_name(stem: str, si: str) -> str:
    """Name under which a quantity is written: `z_mm`, `psi_deg`, `direction`."""
    return stem if stem in UNITLESS else f"{stem}_{_WRITTEN.get(si, si)}"


def cell(value: float, si: str) -> str:
    """An SI value as it is written in a file; empty where it is not finite."""
    if not math.isfinite(value):
        return ""
    return f"{written(value, si)[0]:.15g}"


def written(value: float, si: str) -> tuple[float, str]:
    """An SI value as it is written in a file, and its unit."""
    unit = _WRITTEN.get(si, si)
    factor = units.MM_PER_MIN if unit == FEED_UNIT else units.factor(unit)
    return value / factor, unit


def column_names(stem: str, si: str) -> list[str]:
    """All names under which a quantity may be given."""
    return [f"{stem}_{unit}" for unit in units.UNITS if units.si_unit(unit) == si]


def is_covariate(stem: str) -> bool:
    """Whether a column is a covariate, temperatures and tensions included."""
    return stem in COVARIATES or stem.startswith((TEMPERATURE, TENSION))


def is_temperature(stem: str) -> bool:
    """Whether a column is the temperature of a named body."""
    return stem.startswith(TEMPERATURE) and len(stem) > len(TEMPERATURE)


def tension_columns(machine: Machine) -> list[str]:
    """Stems of the tensions of a machine's cables; none where it has no cables."""
    if machine.cable_stiffness is None:
        return []
    return [f"{TENSION}{k + 1}" for k in range(len(machine.joints))]


def sigma_units(channels: Iterable[Channel]) -> dict[str, str]:
    """SI unit of the standard deviations of readings, by stem."""
    return {f"{SIGMA}{channel.name}": channel.unit for channel in channels}


def covariate_unit(stem: str) -> str:
    """SI unit of a covariate."""
    if stem.startswith(TENSION):
        return "N"
    return COVARIATES.get(stem, "K")
