"""Tolerances and fixed parameters of machine and set-ups, as the study gives them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from oed.model.instrument import Setup
from oed.model.machine import Machine, Parameter
from pkm_studies.base.errors import Place
from pkm_studies.resolve import bounds, correlation, lookup, quantities
from pkm_studies.resolve.noise import LARGEST, with_noise
from pkm_studies.resolve.quantities import check_not_negative
from pkm_studies.study import Study
from pkm_studies.study.tables import ToleranceTable


def with_tolerances(
    study: Study, machine: Machine, setups: dict[str, Setup]
) -> tuple[Machine, dict[str, Setup]]:
    """Machine and set-ups with the study's tolerances, fixed parameters and noise.

    Raises InputError for names and units that do not fit.
    """
    names = _parameter_units(machine, setups)
    prior = _prior_tolerances(study, names)
    fixed = _fixed_parameters(study, names)
    parameters = [
        dataclasses.replace(p, tolerance=prior.get(p.name, p.tolerance))
        for p in machine.parameters
    ]
    machine = machine.with_parameters(parameters)
    if fixed is not None:
        frame = tuple(p.name for p in machine.parameters if p.name in fixed)
        machine = dataclasses.replace(machine, frame=frame)
        prior |= {name: 0.0 for name in fixed}
    machine = bounds.with_bounds(study, machine)
    machine = correlation.with_correlation(study, machine)
    setups = with_noise(study, setups)
    stated = {s.name: _stems(s.tolerance) for s in study.setup}
    changed = {}
    for name, setup in setups.items():
        nuisances = [
            _with_tolerance(n, name, stated[name], prior) for n in setup.nuisances
        ]
        changed[name] = dataclasses.replace(setup, nuisances=tuple(nuisances))
    return machine, changed


def _stems(table: Mapping[str, float]) -> set[str]:
    """Names in a table's keys, without their units."""
    return {key.rpartition("_")[0] for key in table}


def _with_tolerance(
    nuisance: Parameter, setup: str, stated: set[str], prior: Mapping[str, float]
) -> Parameter:
    """A set-up's unknown with its tolerance: [[setup]] goes before [prior]."""
    if nuisance.name in stated:
        return nuisance
    tolerance = prior.get(f"{setup}.{nuisance.name}", nuisance.tolerance)
    return dataclasses.replace(nuisance, tolerance=tolerance)


def _parameter_units(machine: Machine, setups: Mapping[str, Setup]) -> dict[str, str]:
    """SI units of all parameters: the machine's, and `set-up.unknown`."""
    table = {p.name: p.unit for p in machine.parameters}
    for setup in setups.values():
        table |= {f"{setup.name}.{n.name}": n.unit for n in setup.nuisances}
    return table


def _prior_tolerances(study: Study, names: Mapping[str, str]) -> dict[str, float]:
    """Standard deviations, SI, by parameter; later tables of [prior] win."""
    place = study.place.key("prior").key("tolerance")
    tolerances: dict[str, float] = {}
    for i, table in enumerate(study.prior.tolerance):
        tolerances |= _matching_tolerances(table, names, place.item(i))
    return tolerances


def _matching_tolerances(
    table: ToleranceTable, names: Mapping[str, str], place: Place
) -> dict[str, float]:
    matched, unit = lookup.names_of_one_unit(
        table.parameters, names, place.key("parameters")
    )
    sigma = quantities.read_values(table.sigma, {"sigma": unit}, place).get("sigma")
    if sigma is None:
        key = quantities.column("sigma", unit)
        raise place.key(key).error("missing", "give the standard deviation")
    key = next(iter(table.sigma))
    check_not_negative(sigma, place.key(key))
    if sigma > LARGEST:
        raise place.key(key).error(
            "no machine has such a tolerance",
            f"check its unit; up to {LARGEST:g} {unit} is possible",
            table.sigma[key],
        )
    return dict.fromkeys(matched, sigma)


def _fixed_parameters(study: Study, names: Mapping[str, str]) -> set[str] | None:
    if study.machine.fixed is None:
        return None
    place = study.place.key("machine").key("fixed")
    return set(lookup.matching_names(study.machine.fixed, names, place))
