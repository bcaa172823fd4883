"""Values for pose components: as an option of the command gives them, and with units."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from oed.base import units
from oed.model.machine import Machine
from pkm_studies.base import Place
from pkm_studies.resolve.quantities import split_key


def component_values(text: str, option: str, machine: Machine) -> dict[str, float]:
    """Positive values by component, SI, of `z_um=30,theta_arcsec=20`.

    Raises InputError.
    """
    known = {c.name: c.unit for c in machine.components}
    place = Place(option)
    values = {}
    for entry in filter(None, text.replace(",", " ").split()):
        key, _, number = entry.partition("=")
        name, unit = split_key(key, known, place)
        try:
            value = float(number)
        except ValueError:
            value = -1.0
        if not 0.0 < value < np.inf:
            raise place.key(key).error("not a positive number", "write z_um=30", number)
        values[name] = float(units.to_si(value, unit))
    return values


def with_fine_units(values: Mapping[str, float], machine: Machine) -> dict[str, float]:
    """SI values by component as values by component and fine unit (`z_um`)."""
    fine = {c.name: units.FINE[c.unit] for c in machine.components}
    return {f"{n}_{fine[n]}": units.number(v, fine[n]) for n, v in values.items()}
