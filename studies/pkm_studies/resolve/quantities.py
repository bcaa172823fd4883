"""Numbers of a study with the unit in their name (`radius_mm`), turned into SI."""

from __future__ import annotations

from collections.abc import Mapping

from oed import units
from pkm_studies.errors import InputError, Place, suggest


def allowed(si: str) -> list[str]:
    """Units that measure the same kind of quantity as the SI unit."""
    return [u for u in units.UNITS if units.si_unit(u) == si]


def column(name: str, si: str) -> str:
    """How a quantity is usually written: `radius_mm`, `theta_deg`."""
    return f"{name}_{'deg' if si == 'rad' else units.display(si)}"


def split(key: str, wanted: Mapping[str, str], place: Place) -> tuple[str, str]:
    """Name and unit of a key; `wanted` are the known names with their SI units. Raises
    InputError.
    """
    stem, _, unit = key.rpartition("_")
    if stem in wanted and unit in allowed(wanted[stem]):
        return stem, unit
    if key in wanted and wanted[key] == "1":
        return key, "1"
    raise _refused(key, stem, unit, wanted, place)


def _refused(
    key: str, stem: str, unit: str, wanted: Mapping[str, str], place: Place
) -> InputError:
    known = [column(name, si) for name, si in wanted.items()]
    name = stem if stem in wanted else key
    if name not in wanted:
        return place.key(key).error("unknown field", suggest(key, known))
    problem = (
        f'"{unit}" is no unit for {stem}'
        if name == stem
        else "the unit is missing in the name"
    )
    return place.key(key).error(
        problem, "allowed: " + ", ".join(f"{name}_{u}" for u in allowed(wanted[name]))
    )


def read(
    table: Mapping[str, float], wanted: Mapping[str, str], place: Place
) -> dict[str, float]:
    """SI values by name. `wanted` maps each known name to its SI unit. Raises
    InputError.
    """
    values: dict[str, float] = {}
    for key, value in table.items():
        name, unit = split(key, wanted, place)
        if name in values:
            raise place.key(key).error(
                f"{name} is given twice", "keep one of the two", value
            )
        values[name] = float(units.to_si(value, unit))
    return values


def told(value: float, si: str) -> str:
    """An SI value in the unit a person writes it in."""
    unit = "deg" if si == "rad" else units.display(si)
    return f"{float(units.from_si(value, unit)):.6g} {unit if unit != '1' else ''}".rstrip()
