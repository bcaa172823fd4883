"""What the result of an earlier session knows of a machine: parameters, covariance."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from oed import units
from oed.base import Array
from oed.model import Machine
from oed.result import MachineInfo, MixtureSection, StudyResult
from pkm_studies.base import Location
from pkm_studies.results import Estimated

FILE = "posterior.nc"
#: difference of two nominal numbers, in their unit and relative, that is rounding
ROUNDING = 1e-9


def machine_difference(stored: MachineInfo, machine: Machine) -> str | None:
    """The first thing in which two machines differ, in words; None for one machine."""
    if stored.name != machine.name:
        return f"{machine.name} for {stored.name}"
    nominal = {
        p.name: units.number(p.nominal, units.display(p.unit))
        for p in machine.parameters
    }
    for row in stored.parameters:
        name = str(row["name"])
        value = nominal.pop(name, math.nan)
        if not math.isclose(
            value, float(row["nominal"]), rel_tol=ROUNDING, abs_tol=ROUNDING
        ):
            return f"{name} = {value:.9g} for {float(row['nominal']):.9g} {row['unit']}"
    return None


def controller_values(
    result: StudyResult, machine: Machine, *, with_effects: bool = False
) -> tuple[Array, Array]:
    """Parameters (np,) that a controller is given, and standard deviations, SI.

    The identified ones, but where effects may act: then those of least expected error.
    With the effects of the best answer corrected as well (`with_effects`), those
    estimated together with them.
    """
    estimated = result.final_estimate
    estimates = {} if estimated is None else estimated.parameters
    values, sd = machine.nominal.copy(), np.zeros(len(machine.parameters))
    for k, p in enumerate(machine.parameters):
        estimate = estimates.get(p.name)
        if estimate is not None:
            values[k] = units.to_si(estimate.value, estimate.unit)
            sd[k] = units.to_si(estimate.sd, estimate.unit)
    section = result.controller_mixture or result.final_estimate
    if section is None or with_effects:
        return values, sd
    for name, value in section.controller.items():
        parameter = section.parameters[name]
        values[machine.index(name)] = units.to_si(value, parameter.unit)
        sd[machine.index(name)] = units.to_si(parameter.sd, parameter.unit)
    return values, sd


def known_parameters(
    stored: StudyResult, machine: str, free: list[str], folder: Path
) -> tuple[Array, Array, str]:
    """Values (n,) of free parameters, their covariance (n, n), SI, and its source.

    After a diagnosis both are those over all of its hypotheses. Otherwise the covariance is
    that of the section `corrected` where there is one, which effects do not bend, or comes
    from the draws of the posterior, or, where there are none, from the estimate.

    Raises InputError where not all of them were identified there.
    """
    location = Location(str(folder / "result.json")).key("estimate")
    section = stored.final_estimate
    if section is None:
        raise location.error(
            "nothing was identified there", "make it with `oed identify`"
        )
    remedy = f"give a result for {machine} of this study"
    absent = [name for name in free if name not in section.parameters]
    if absent:
        raise location.error(f"it has no estimate of {absent[0]}", remedy)
    if stored.machine.name != machine:
        raise location.error(f"it is about {stored.machine.name}", remedy)
    mixture = stored.controller_mixture
    if mixture is not None and set(free) <= set(mixture.parameters):
        source = "parameters over all hypotheses of the diagnosis"
        return *si_estimates(mixture, free), source
    draws = folder / FILE
    if stored.corrected is None and draws.is_file():
        sample = read_draws(draws, free)
        if sample is not None:
            covariance = np.atleast_2d(np.cov(sample.T))
            return sample.mean(axis=0), covariance, "draws of the posterior"
    if not section.covariance:
        rows = [section.parameters[name] for name in free]
        factors = np.array([units.factor(row.unit) for row in rows])
        sd = factors * [row.sd for row in rows]
        source = "standard deviations of the estimate, taken as independent"
        return factors * [row.value for row in rows], np.diag(sd**2), source
    source = "covariance of the estimate"
    if stored.corrected is not None:
        source = "parameters and effects estimated together"
    return *si_estimates(section, free), source


def si_estimates(
    section: Estimated | MixtureSection, names: Sequence[str]
) -> tuple[Array, Array]:
    """Values (n,) and covariance (n, n), SI, of named parameters of a section."""
    listed = list(section.parameters)
    indices = [listed.index(name) for name in names]
    rows = [section.parameters[name] for name in names]
    factors = np.array([units.factor(row.unit) for row in rows])
    covariance = np.array(section.covariance)[np.ix_(indices, indices)]
    values = factors * [row.value for row in rows]
    return values, covariance * np.outer(factors, factors)


def read_draws(path: Path, free: list[str]) -> Array | None:
    """Draws (draws, n) of free parameters, SI; None if some lack. Raises InputError."""
    import xarray  # takes a second to import, and only a plan after a session needs it

    try:
        with xarray.open_dataset(path, group="posterior", engine="h5netcdf") as data:
            names = [str(name) for name in data["parameter"].values]
            theta = np.asarray(data["theta"].values, dtype=float)
        draws = theta.reshape(-1, len(names))
        if len(draws) < 2 or not np.isfinite(draws).all():
            raise ValueError("draws are missing")
    except Exception as error:  # as many kinds as HDF5 and its readers have
        raise Location(str(path)).error(
            f"these are no draws of a posterior: {error}",
            "restore the file, or make the result again; without it, the covariance of"
            " the estimate counts",
        ) from error
    if not set(free) <= set(names):
        return None
    return draws[:, [names.index(name) for name in free]]
