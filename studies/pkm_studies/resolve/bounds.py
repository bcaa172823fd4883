"""Bounds of parameters, as the study states them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy import special

from oed.model.machine import Machine
from pkm_studies.base.errors import Place
from pkm_studies.resolve import lookup, quantities
from pkm_studies.study import Study
from pkm_studies.study.tables import BoundsTable

#: least share of the machines of the tolerances that keep to all bounds
LEAST_SHARE = 0.02


def with_bounds(study: Study, machine: Machine) -> Machine:
    """The machine with the bounds of [[prior.bounds]].

    Raises InputError for names and units that do not fit, for a nominal value that is out
    of bounds, and where hardly any machine of the tolerances keeps to them.
    """
    if not study.prior.bounds:
        return machine
    place = study.place.key("prior").key("bounds")
    for i, table in enumerate(study.prior.bounds):
        machine = _bounded(machine, table, place.item(i))
    shares = [_share(machine, k) for k in range(len(machine.parameters))]
    if math.prod(shares) < LEAST_SHARE:
        raise place.error(
            f"{100.0 * math.prod(shares):.2g} % of the machines of the tolerances keep to"
            " these bounds",
            "narrow the tolerances, or widen the bounds",
        )
    return machine


def _bounded(machine: Machine, table: BoundsTable, place: Place) -> Machine:
    """The machine with the bounds of one table."""
    units = {p.name: p.unit for p in machine.parameters}
    matched, unit = lookup.names_of_one_unit(
        table.parameters, units, place.key("parameters")
    )
    ends = quantities.read_values(table.ends, {"lower": unit, "upper": unit}, place)
    if not ends:
        key = quantities.column("lower", unit)
        raise place.key(key).error("missing", "give lower, upper, or both")
    low, high = ends.get("lower", -np.inf), ends.get("upper", np.inf)
    parameters = []
    for parameter in machine.parameters:
        if parameter.name not in matched:
            parameters.append(parameter)
            continue
        if not low <= parameter.nominal <= high or low == high:
            nominal = quantities.format_as(
                parameter.nominal, unit, next(iter(table.ends))
            )
            raise place.error(
                f"the nominal value of {parameter.name}, {nominal}, is not within",
                "bounds are of the value, not of its error; check their unit",
                table.ends,
            )
        parameters.append(dataclasses.replace(parameter, bounds=(low, high)))
    return machine.with_parameters(parameters)


def _share(machine: Machine, number: int) -> float:
    """Share of the values of a parameter's tolerance that are within its bounds."""
    parameter = machine.parameters[number]
    if parameter.tolerance == 0.0 or parameter.name in machine.frame:
        return 1.0
    ends = (np.array(parameter.bounds) - parameter.nominal) / parameter.tolerance
    low, high = special.ndtr(ends)
    return float(high - low)
