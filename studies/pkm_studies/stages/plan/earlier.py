"""EstimatedParameters from an earlier session: identified machine, covariance, time spent."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from oed.base import units
from oed.base.arrays import Array
from oed.design.candidates import reading_time
from oed.design.stages.option import Option
from oed.measurement.measurement import Measurement
from oed.mechanism.kinematics import Kinematics
from oed.model.machine import Machine
from oed.result import CorrectedSection, ParameterEstimate, StudyResult
from pkm_studies.base.errors import Place
from pkm_studies.resolve.plan import PlanRequest, request_of
from pkm_studies.resolve.resolved import ResolvedStudy, measurement_factory
from pkm_studies.stages.forecast.task import EstimatedParameters

#: identified parameters by name
Estimates = Mapping[str, ParameterEstimate]
FILE = "posterior.nc"


@dataclasses.dataclass(frozen=True, kw_only=True)
class EarlierSession:
    """What an earlier session tells a plan.

    resolved    the study about the machine as identified, without measurements done
    plan        what [plan] then requests
    covariance  (n, n) of the machine's free parameters, in units of their tolerances
    seconds     time that the session took
    words       the same as a sentence
    """

    resolved: ResolvedStudy
    plan: PlanRequest
    covariance: Array
    seconds: float
    words: str


def read_earlier_session(
    resolved: ResolvedStudy, request: PlanRequest, folder: Path, stored: StudyResult
) -> EarlierSession:
    """What the result `stored` in `folder` tells about the study's machine.

    The covariance is that of the section `corrected` where there is one, which effects
    do not bend. Otherwise it comes from the draws of the posterior, or, where there are
    none, from the standard deviations of the estimate.

    Raises InputError where the result does not fit the study.
    """
    machine = resolved.machine
    measurement = resolved.measurement_with(())
    free = _free_names(measurement)
    estimate = _estimate(stored, machine.name, free, folder)
    if stored.corrected is not None:
        value, covariance, source = _corrected(stored.corrected, free)
    else:
        value, covariance, source = _posterior(folder / FILE, estimate, free)
    identified = dict(zip(free, value, strict=True))
    parameters = [
        dataclasses.replace(p, nominal=float(identified.get(p.name, p.nominal)))
        for p in machine.parameters
    ]
    done = Counter(stored.drawing.reading_of if stored.drawing else [])
    seconds = _session_seconds(resolved, request.options, done)
    tolerance = measurement.tolerance[measurement.free]
    words = (
        f"Planned after {', '.join(done) or 'no readings'} ({sum(done.values())}"
        f" readings, {units.number(seconds, 'min'):.0f} min), with the machine as"
        f" identified from them ({source})."
    )
    others = machine.with_parameters(parameters)
    resolved, plan = _without_done(resolved, request, others, done)
    return EarlierSession(
        resolved=resolved,
        plan=plan,
        covariance=covariance / np.outer(tolerance, tolerance),
        seconds=seconds,
        words=words,
    )


def stored_knowledge(
    resolved: ResolvedStudy, stored: StudyResult, folder: Path
) -> EstimatedParameters | None:
    """The machine's parameters as identified in a folder; None where none were.

    Raises InputError where the result is about another machine.
    """
    if stored.final_estimate is None:
        return None
    machine = resolved.machine
    measurement = resolved.measurement_with(())
    free = _free_names(measurement)
    estimate = _estimate(stored, machine.name, free, folder)
    if stored.corrected is not None:
        value, covariance, _ = _corrected(stored.corrected, free)
    else:
        value, covariance, _ = _posterior(folder / FILE, estimate, free)
    at = [machine.index(name) for name in free]
    values = machine.nominal.copy()
    values[at] = value
    whole = np.zeros((len(values), len(values)))
    whole[np.ix_(at, at)] = covariance
    return EstimatedParameters(values, whole)


def _free_names(measurement: Measurement) -> list[str]:
    """Names of the free parameters."""
    pairs = zip(measurement.names, measurement.free, strict=True)
    return [name for name, is_free in pairs if is_free]


def _estimate(
    stored: StudyResult, machine: str, free: Sequence[str], folder: Path
) -> Estimates:
    """The estimated parameters of a stored result, all of the free ones among them."""
    place = Place(str(folder / "result.json")).key("estimate")
    section = stored.final_estimate
    if section is None:
        raise place.error("nothing was identified there", "make it with `oed identify`")
    estimate = section.parameters
    remedy = f"give a result for {machine} of this study"
    absent = [name for name in free if name not in estimate]
    if absent:
        raise place.error(f"it has no estimate of {absent[0]}", remedy)
    if stored.machine.name != machine:
        raise place.error(f"it is about {stored.machine.name}", remedy)
    return estimate


def _without_done(
    resolved: ResolvedStudy,
    request: PlanRequest,
    machine: Machine,
    done: Mapping[str, int],
) -> tuple[ResolvedStudy, PlanRequest]:
    """The study about another machine, without the measurements that are done."""
    measurement_with = measurement_factory(Kinematics(machine), resolved.setups)
    plan = request_of(
        request.table,
        resolved.study,
        measurement_with,
        resolved.setups,
        request.prediction,
        done,
    )
    changed = dataclasses.replace(
        resolved,
        machine=machine,
        measurement_with=measurement_with,
        measurement=measurement_with(resolved.measurement.setups),
        plan=plan,
    )
    return changed, plan


def _corrected(
    corrected: CorrectedSection, free: Sequence[str]
) -> tuple[Array, Array, str]:
    """Values (n,), their covariance (n, n), SI, and where they come from."""
    names = list(corrected.parameters)
    at = [names.index(name) for name in free]
    rows = [corrected.parameters[name] for name in free]
    value = _in_si([row.value for row in rows], rows)
    factors = np.array([units.factor(row.unit) for row in rows])
    covariance = np.array(corrected.covariance)[np.ix_(at, at)]
    source = "parameters and effects estimated together"
    return value, covariance * np.outer(factors, factors), source


def _posterior(
    draws: Path, estimate: Estimates, free: list[str]
) -> tuple[Array, Array, str]:
    """Values (n,), their covariance (n, n), SI, and where they come from."""
    sample = read_draws(draws, free) if draws.is_file() else None
    if sample is not None:
        covariance = np.atleast_2d(np.cov(sample.T))
        return sample.mean(axis=0), covariance, "draws of the posterior"
    rows = [estimate[name] for name in free]
    value = _in_si([row.value for row in rows], rows)
    sd = _in_si([row.sd for row in rows], rows)
    source = "standard deviations of the estimate, taken as independent"
    return value, np.diag(sd**2), source


def _in_si(numbers: Sequence[float], rows: Sequence[ParameterEstimate]) -> Array:
    """One number (n,) of each estimate, given in the estimate's unit."""
    pairs = zip(numbers, rows, strict=True)
    return np.array([float(units.to_si(number, row.unit)) for number, row in pairs])


def read_draws(path: Path, free: list[str]) -> Array | None:
    """Draws (draws, n) of the free parameters, SI; None where some are absent."""
    import xarray  # takes a second to import, and only a plan after a session needs it

    with xarray.open_dataset(path, group="posterior", engine="h5netcdf") as data:
        names = [str(name) for name in data["parameter"].values]
        if not set(free) <= set(names):
            return None
        theta = np.asarray(data["theta"].values, dtype=float)
    columns = [names.index(name) for name in free]
    return theta.reshape(-1, len(names))[:, columns]


def _session_seconds(
    resolved: ResolvedStudy, options: Sequence[Option], done: Mapping[str, int]
) -> float:
    """Time (s) that the readings {set-up: number} took.

    It follows the measurement that mounts the set-up, else the set-up's instrument.
    """
    total = 0.0
    for option in options:
        total += _option_seconds(option, done)
    planned = {name for option in options for name in option.candidates.setups}
    for name in sorted(set(done) - planned):
        if name in resolved.setups:
            mounting = resolved.setups[name].instrument.cost.setup
            reading = reading_time(resolved.measurement_with([name]), name)
            total += mounting + reading * done[name]
    return total


def _option_seconds(option: Option, done: Mapping[str, int]) -> float:
    """Time (s) of the readings that were taken with an option's set-ups."""
    candidates = option.candidates
    mounted = [name for name in candidates.setups if done.get(name)]
    total = option.mounting_seconds if mounted else 0.0
    for name in mounted:
        rows = np.flatnonzero(candidates.setup == candidates.setups.index(name))
        readings = candidates.members[rows, 1].sum()
        each = option.candidate_seconds[rows].sum() / readings
        total += float(each) * done[name]
    return total
