"""What moves the parameters of a machine, as [[machine.adjust]] states it."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Collection

from oed.model.adjustment import Adjustment
from oed.model.machine import Machine
from pkm_studies import quantities
from pkm_studies.base import Place
from pkm_studies.resolve import lookup
from pkm_studies.tables import AdjustTable, MachineTable

#: what a table may state, and what it is of the adjustment
AMOUNTS = ("step", "sd", "most")


def with_adjustments(table: MachineTable, machine: Machine, place: Place) -> Machine:
    """The machine with the study's adjustments in place of the model's, if it has any.

    Raises InputError for names and units that do not fit, and for amounts below 0.
    """
    if table.adjust is None:
        return machine
    held = machine.frame if table.fixed is None else ()
    adjustments: dict[str, Adjustment] = {}
    for i, entry in enumerate(table.adjust):
        at = place.key("adjust").item(i)
        adjustments |= _of_table(entry, machine, held, at)
    parameters = tuple(
        dataclasses.replace(p, adjust=adjustments.get(p.name))
        for p in machine.parameters
    )
    return dataclasses.replace(machine, parameters=parameters)


def _of_table(
    table: AdjustTable, machine: Machine, held: Collection[str], place: Place
) -> dict[str, Adjustment]:
    """The adjustments of one table by parameter.

    held  parameters that only choose the base frame
    """
    units = {p.name: p.unit for p in machine.parameters}
    at = place.key("parameters")
    names, unit = lookup.names_of_one_unit(table.parameters, units, at)
    known = dict.fromkeys(AMOUNTS, unit)
    amounts = quantities.read_values(table.amounts, known, place)
    for key, value in table.amounts.items():
        if value < 0.0 or (value == 0.0 and key.startswith("most")):
            raise place.key(key).error("no such amount", "give a number > 0", value)
    conventions = [name for name in names if name in held]
    if conventions:
        raise at.error(
            f"{conventions[0]} only chooses the base frame, and nothing moves it",
            "name the others",
            table.parameters,
        )
    return {name: Adjustment(_words(table.by, name), **amounts) for name in names}


def _words(by: str, name: str) -> str:
    """What moves a parameter: with the number in its name for `{i}`."""
    number = re.search(r"\d+", name)
    return by.replace("{i}", number.group() if number else name)
