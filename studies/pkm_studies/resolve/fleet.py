"""The prior of a study from the results of other machines of its model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.base import units
from oed.base.arrays import Array
from oed.dataset.digests import is_counted
from oed.estimation.fleet import (
    MachineInformation,
    fleet_prior,
    readings_information,
    rescaled,
)
from oed.model.machine import Machine
from oed.result import StudyResult, trust
from pkm_studies.base import Place
from pkm_studies.earlier_result import result_folder
from pkm_studies.results import load_result
from pkm_studies.study import Study

#: tolerances by which the nominal numbers of a machine of the same model may differ
FAR = 4.0


def fleet_knowledge(
    study: Study, machine: Machine, free: Sequence[str], place: Place
) -> tuple[Array, Array]:
    """Mean (n,) and covariance (n, n), SI, of the free parameters of a further machine.

    Raises InputError where a result is not of this model, or has a prior of its own.
    """
    at = [machine.index(name) for name in free]
    nominal = machine.nominal[at]
    tolerance = np.array([machine.parameters[k].tolerance for k in at])
    machines = []
    results: dict[str, StudyResult] = {}
    folders = [study.folder / name for name in study.prior.from_]
    for i, name in enumerate(study.prior.from_):
        here = place.item(i)
        folder = result_folder(study, name, here)
        if folders[i].resolve() in [f.resolve() for f in folders[:i]]:
            raise here.error("this result is named twice", "name it once", name)
        result = load_result(folder)
        _check(result, machine, free, here, name)
        for other, earlier in results.items():
            if is_counted(result.readings, earlier.readings):
                problem = f"its readings are those of {other!r}"
                raise here.error(problem, "name each machine once", name)
        results[name] = result
        machines.append(_information(result, free, nominal, tolerance, here, name))
    prior = fleet_prior(machines)
    covariance = prior.covariance * np.outer(tolerance, tolerance)
    return nominal + tolerance * prior.mean, covariance


def _check(
    result: StudyResult, machine: Machine, free: Sequence[str], place: Place, name: str
) -> None:
    """Raises InputError for a result that says nothing of this model by itself."""
    if result.machine.name != machine.name:
        problem = f"it is the result of another machine: {result.machine.name}"
        raise place.error(problem, f"name results of {machine.name}", name)
    section = result.final_estimate
    if section is None or not section.covariance:
        remedy = "make it with `oed identify STUDY --readings CSV --out DIR`"
        raise place.error("it has no estimate with its covariance", remedy, name)
    if result.machine.earlier or result.machine.fleet:
        raise place.error(
            "its prior is that of other sessions, whose readings would count twice",
            "name results whose prior is their tolerances",
            name,
        )
    if "[[prior.correlated]]" in result.study_text:
        raise place.error(
            "its tolerances are correlated, and what its readings say alone is unknown",
            "identify it without [[prior.correlated]]",
            name,
        )
    objections = trust.objections(result)
    if objections:
        remedy = "run `oed diagnose` on its readings, or remove it here"
        raise place.error(f"{objections[0]}: nothing should rest on it", remedy, name)
    for parameter in free:
        row = section.parameters.get(parameter)
        if row is None or row.prior_sd == 0.0:
            problem = f"{parameter} was not free there"
            remedy = "identify it there, or hold it here: [machine] fixed"
            raise place.error(problem, remedy, name)


def _information(
    result: StudyResult,
    free: Sequence[str],
    nominal: Array,
    tolerance: Array,
    place: Place,
    name: str,
) -> MachineInformation:
    """What the readings of a result say, about these nominal values and tolerances."""
    section = result.final_estimate
    assert section is not None
    rows = [section.parameters[parameter] for parameter in free]
    scale = np.array([units.factor(row.unit) for row in rows])
    value, start, prior = (
        scale * np.array([getattr(row, field) for row in rows])
        for field in ("value", "nominal", "prior_sd")
    )
    shift = (start - nominal) / tolerance
    if np.abs(shift).max() > FAR:
        k = int(np.abs(shift).argmax())
        raise place.error(
            f"its nominal {free[k]} differs by {abs(shift[k]):.3g} tolerances: it is a"
            " machine of another size",
            "name machines of one model",
            name,
        )
    names = list(section.parameters)
    at = [names.index(parameter) for parameter in free]
    block = np.array(section.covariance)[np.ix_(at, at)] * np.outer(scale, scale)
    information = readings_information(value, block, start, prior)
    return rescaled(information, tolerance / prior, shift)
