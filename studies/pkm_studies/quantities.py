"""Converts a study's numbers to SI; the unit is in the key (`radius_mm`)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from oed import units
from oed.text import suggest
from pkm_studies.base import InputError, Location

if TYPE_CHECKING:
    from oed.model import Machine


def allowed_units(si: str) -> list[str]:
    """Units of the same kind of quantity as the SI unit."""
    return [unit for unit in units.UNITS if units.si_unit(unit) == si]


def column(name: str, si: str) -> str:
    """The usual key of a quantity: `radius_mm`, `theta_deg`."""
    return f"{name}_{display_unit(si)}"


def display_unit(si: str) -> str:
    """The unit in which a person writes a quantity: degrees for angles."""
    return "deg" if si == "rad" else units.display(si)


def split_key(
    key: str, unit_of: Mapping[str, str], location: Location
) -> tuple[str, str]:
    """Name and unit of a key; `unit_of` gives each name's SI unit. Raises InputError."""
    stem, _, unit = key.rpartition("_")
    if stem in unit_of and unit in allowed_units(unit_of[stem]):
        return stem, unit
    if key in unit_of and unit_of[key] == "1":
        return key, "1"
    raise _refusal(key, stem, unit, unit_of, location)


def _refusal(
    key: str, stem: str, unit: str, unit_of: Mapping[str, str], location: Location
) -> InputError:
    name = stem if stem in unit_of else key
    if name not in unit_of:
        columns = [column(n, si) for n, si in unit_of.items()]
        return location.key(key).error("unknown field", suggest(key, columns))
    problem = "the unit is missing in the name"
    if name == stem:
        problem = f'"{unit}" is no unit for {stem}'
    allowed = ", ".join(f"{name}_{u}" for u in allowed_units(unit_of[name]))
    return location.key(key).error(problem, f"allowed: {allowed}")


def read_values(
    table: Mapping[str, float], unit_of: Mapping[str, str], location: Location
) -> dict[str, float]:
    """SI values by name; `unit_of` gives each name's SI unit. Raises InputError."""
    values: dict[str, float] = {}
    for key, value in table.items():
        name, unit = split_key(key, unit_of, location)
        if name in values:
            raise location.key(key).error(
                f"{name} is given twice", "keep one of the two", value
            )
        values[name] = float(units.to_si(value, unit))
    return values


def split_tables(
    table: Mapping[str, float | dict[str, float]],
) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Plain numbers of a table, and its tables for one set-up each."""
    numbers: dict[str, float] = {}
    tables: dict[str, dict[str, float]] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            tables[key] = value
        else:
            numbers[key] = value
    return numbers, tables


def format_value(value: float, si: str) -> str:
    """An SI value as text, in the unit in which a person writes it."""
    unit = display_unit(si)
    number = f"{float(units.from_si(value, unit)):.6g}"
    return number if unit == "1" else f"{number} {unit}"


def format_as(value: float, si: str, key: str) -> str:
    """An SI value as text in the unit of a field (`z_um`), or the usual one."""
    unit = key.rpartition("_")[2]
    if unit not in allowed_units(si) or unit == "1":
        return format_value(value, si)
    return f"{float(units.from_si(value, unit)):.9g} {unit}"


def component_values(text: str, option: str, machine: Machine) -> dict[str, float]:
    """Positive SI values by component of `z_um=30,theta_arcsec=20`. Raises InputError."""
    unit_of = {c.name: c.unit for c in machine.components}
    location = Location(option)
    values = {}
    for entry in filter(None, text.replace(",", " ").split()):
        key, _, number = entry.partition("=")
        name, unit = split_key(key, unit_of, location)
        try:
            value = float(number)
        except ValueError:
            value = -1.0
        if not 0.0 < value < math.inf:
            raise location.key(key).error(
                "not a positive number", "write z_um=30", number
            )
        values[name] = float(units.to_si(value, unit))
    return values


def fine_units(values: Mapping[str, float], machine: Machine) -> dict[str, float]:
    """SI values by component as values by component and fine unit (`z_um`)."""
    fine = {c.name: units.FINE[c.unit] for c in machine.components}
    return {f"{n}_{fine[n]}": units.number(v, fine[n]) for n, v in values.items()}
