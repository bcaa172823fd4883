"""What an earlier result knows: the machine as identified, how well, which set-ups are
done and the time they took.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from oed import units
from oed.arrays import Array
from oed.design.candidates import reading_time
from oed.machine import Machine
from pkm_studies.errors import Place
from pkm_studies.resolve.plan import planned
from pkm_studies.resolve.resolved import ResolvedStudy, measurement_factory

FILE = "posterior.nc"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Learned:
    """Covariance (n, n) of the machine's free parameters, in units of the study's
    tolerances; `seconds` spent.
    """

    resolved: ResolvedStudy
    covariance: Array
    seconds: float
    words: str


def learned(resolved: ResolvedStudy, folder: Path, found: Mapping[str, Any]) -> Learned:
    """What the result `found` in `folder` knows of the study's machine. Raises
    InputError where it does not fit.

    The posterior's draws tell the covariance; where there are none, the standard
    deviations of the estimate.
    """
    place = Place(str(folder / "result.json"))
    if not found.get("estimate"):
        raise place.key("estimate").error(
            "nothing was identified there", "make it with `oed identify`"
        )
    machine = resolved.machine
    base = resolved.measurement_with(())
    free = [n for n, f in zip(base.names, base.free, strict=True) if f]
    estimate = found["estimate"]["parameters"]
    absent = [n for n in free if n not in estimate]
    if found["machine"]["name"] != machine.name or absent:
        problem = (
            f"it is about {found['machine']['name']}"
            if not absent
            else f"it does not tell {absent[0]}"
        )
        raise place.key("estimate").error(
            problem, f"give a result for {machine.name} of this study"
        )
    tolerance = base.tolerance[base.free]
    value, covariance, source = _known(folder / FILE, estimate, free)
    believed = dict(zip(free, value, strict=True))
    table = [
        dataclasses.replace(p, nominal=float(believed.get(p.name, p.nominal)))
        for p in machine.parameters
    ]
    done = Counter(str(n) for n in (found.get("drawing") or {}).get("reading_of", []))
    spent = _seconds(resolved, done)
    count = sum(done.values())
    words = (
        f"Planned after {', '.join(done) or 'no readings'} ({count} readings,"
        f" {spent / 60.0:.0f} min), with the machine as identified from them"
        f" ({source})."
    )
    return Learned(
        resolved=_believing(resolved, machine.with_parameters(table), list(done)),
        covariance=covariance / np.outer(tolerance, tolerance),
        seconds=spent,
        words=words,
    )


def _believing(
    resolved: ResolvedStudy, machine: Machine, done: list[str]
) -> ResolvedStudy:
    """The study about the machine as believed, without the measurements that are done."""
    measure = measurement_factory(machine, resolved.setups)
    return dataclasses.replace(
        resolved,
        machine=machine,
        measurement_with=measure,
        measurement=measure(resolved.measurement.setups),
        plan=planned(resolved.study, measure, resolved.setups, done),
    )


def _known(
    draws: Path, estimate: Mapping[str, Any], free: list[str]
) -> tuple[Array, Array, str]:
    """Values (n,), their covariance (n, n), SI, and where they come from."""
    if draws.is_file():
        import xarray

        with xarray.open_dataset(draws, group="posterior", engine="h5netcdf") as data:
            names = [str(n) for n in data["parameter"].values]
            if set(free) <= set(names):
                columns = [names.index(n) for n in free]
                flat = np.asarray(data["theta"].values, dtype=float).reshape(
                    -1, len(names)
                )[:, columns]
                return (
                    flat.mean(axis=0),
                    np.atleast_2d(np.cov(flat.T)),
                    "draws of the posterior",
                )
    value = np.array(
        [float(units.to_si(estimate[n]["value"], estimate[n]["unit"])) for n in free]
    )
    sd = np.array(
        [float(units.to_si(estimate[n]["sd"], estimate[n]["unit"])) for n in free]
    )
    return (
        value,
        np.diag(sd**2),
        "standard deviations of the estimate, taken as independent",
    )


def _seconds(resolved: ResolvedStudy, done: Mapping[str, int]) -> float:
    """Time that readings {set-up: number} took: as the measurement that mounts it
    tells, else as its instrument.
    """
    total = 0.0
    options = resolved.plan.options if resolved.plan is not None else ()
    for option in options:
        mine = [n for n in option.candidates.setups if done.get(n)]
        total += option.mounting if mine else 0.0
        for name in mine:
            rows = np.flatnonzero(
                option.candidates.setup == option.candidates.setups.index(name)
            )
            each = option.seconds[rows].sum() / option.candidates.members[rows, 1].sum()
            total += float(each) * done[name]
    told = {n for option in options for n in option.candidates.setups}
    for name in set(done) - told:
        if name in resolved.setups:
            cost = resolved.setups[name].instrument.cost.setup
            total += (
                cost
                + reading_time(resolved.measurement_with([name]), name) * done[name]
            )
    return total
