"""Effects as a study states them: expected sizes ([effects], `leg_thermal_C = 1`), gears."""

from __future__ import annotations

import dataclasses
import itertools
import operator
from collections.abc import Iterable, Mapping

from oed import units
from oed.effect_model import Effect
from oed.text import suggest
from pkm_studies import catalogue
from pkm_studies.study import Study
from pkm_studies.tables import DriveTable

#: how a quotient is written in the name of a field: `ppm_per_C`
PER = "_per_"


def check_sizes(study: Study, effects: Iterable[Effect]) -> None:
    """Raise InputError for a field of [effects] that names no effect or wrong unit.

    `effects` are those of the study; all of the catalogue are known as well.
    """
    by_name = {e.name: e for e in effects}
    location = study.location.key("effects")
    for entry in catalogue.listing("effects"):
        if entry.name not in by_name:
            by_name[entry.name] = catalogue.effect(entry.name, study.origin, location)
    for field in study.effects:
        name = _effect_of(field, by_name)
        field_location = location.key(field)
        if name is None:
            remedy = suggest(field, [f"{n}_{_names(e)[0]}" for n, e in by_name.items()])
            raise field_location.error("this begins with the name of no effect", remedy)
        unit = field.removeprefix(f"{name}_")
        if unit not in _factors(by_name[name]):
            names = ", ".join(f"{name}_{u}" for u in _names(by_name[name]))
            raise field_location.error(
                f"{name} is not measured in {unit}", f"write {names}"
            )


def effect_with_sizes(effect: Effect, study: Study) -> Effect:
    """The effect with the sizes that the study expects of it, and the study's drive."""
    drive = study.machine.drive
    if effect.of_drive and isinstance(drive, DriveTable):
        values = _drive_values(drive)
        if values:
            constants = {**effect.constants, effect.of_drive: values}
            effect = dataclasses.replace(effect, constants=constants)
    factors = _factors(effect)
    for field, value in study.effects.items():
        unit = field.removeprefix(f"{effect.name}_")
        if unit != field and unit in factors:
            si, factor = factors[unit]
            effect = effect.with_expected_size(si, value * factor)
    return effect


def _drive_values(drive: DriveTable) -> tuple[float, ...]:
    """Turns of each wheel a turn of the joint, or the lead of the screw, m."""
    if drive.kind == "screw":
        return () if drive.lead_mm is None else (drive.lead_mm * units.MM,)
    stages = drive.stages if drive.ratio is None else [drive.ratio]
    return tuple(itertools.accumulate([1.0, *stages], operator.mul)) if stages else ()


def _effect_of(field: str, allowed: Iterable[str]) -> str | None:
    """The longest name of an effect that begins a field."""
    matching = [name for name in allowed if field.startswith(f"{name}_")]
    return max(matching, key=len, default=None)


def _names(effect: Effect) -> list[str]:
    """Units in which reports state coefficients of an effect, as ends of fields."""
    return [_spelt(units.coefficient_unit(si)[0]) for si in effect.coefficient_units()]


def _factors(effect: Effect) -> Mapping[str, tuple[str, float]]:
    """{end of a field: (SI unit, factor to SI)} of an effect's coefficients."""
    table: dict[str, tuple[str, float]] = {}
    for si in effect.coefficient_units():
        name, factor = units.coefficient_unit(si)
        table[_spelt(name)] = (si, factor)
        for unit, (kind, to_si) in units.UNITS.items():
            if kind == si:
                table[unit] = (si, to_si)
    return table


def _spelt(unit: str) -> str:
    return unit.replace("/K", f"{PER}C").replace("/", PER)
