"""Tolerances and fixed parameters of machine and set-ups, as the study gives them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import scipy  # its parts load when first used

from oed import history, trust, units
from oed.base import Array
from oed.dataset import is_counted
from oed.instrument import ParameterVector, Setup
from oed.model import CommonTolerance, Machine, Parameter
from oed.noise import NoiseStatement
from oed.result import StudyResult
from oed.text import suggest
from pkm_studies import quantities
from pkm_studies.base import Location
from pkm_studies.earlier_result import (
    known_parameters,
    machine_difference,
    si_estimates,
)
from pkm_studies.resolve.machine import matching_names, names_of_one_unit
from pkm_studies.results import load_result
from pkm_studies.study import Study
from pkm_studies.tables import BoundsTable, ToleranceTable

# Noise of the set-ups, and what else of it is stated, as the study gives them.

#: least noise of an instrument, SI: below it sums of squares lose all digits
MIN_SIGMA = 1e-12
#: largest noise and tolerance, SI: above it sums of squares lose all digits
LARGEST = 1e3
#: ends of the names of an error that all readings of a run share, and of a display's step
RUN, RESOLUTION = "_run", "_resolution"
SEATING = "seating"  #: name of what each run seats anew


def with_noise(study: Study, setups: Mapping[str, Setup]) -> dict[str, Setup]:
    """Set-ups with stated noise: of one, of all, or their own. Raises InputError."""
    location = study.location.key("noise")
    common, special = quantities.split_tables(study.noise.sigma)
    for name in special:
        if name not in setups:
            raise location.key(name).error("no such set-up", suggest(name, setups))
    law = _law(study, location)
    general = _amounts(common, list(setups.values()), location)
    noisy = {}
    for name, setup in setups.items():
        stated = _amounts(special.get(name, {}), [setup], location.key(name))
        noisy[name] = _add_amounts(setup, general | stated, law)
    return noisy


def _law(study: Study, location: Location) -> NoiseStatement:
    table = study.noise
    if table.carried == 0.0 and table.reach_readings is not None:
        raise location.key("reach_readings").error(
            "nothing is carried along, as carried = 0",
            "remove one of the two",
            table.reach_readings,
        )
    if table.student_dof is not None and table.outlier_share:
        problem = "student_dof states the tails already"
        remedy = "remove one of the two"
        raise location.key("outlier_share").error(problem, remedy, table.outlier_share)
    # what nobody measured anchors nothing: no part of it is split into further parts
    nothing = 0.0 if table.assumed else None
    return NoiseStatement(
        correlated=nothing if table.carried is None else table.carried,
        reach=table.reach_readings,
        student_dof=table.student_dof,
        outlier_share=table.outlier_share,
        is_assumed=table.assumed,
        has_course=table.course,
    )


def _add_amounts(
    setup: Setup, stated: Mapping[str, float], law: NoiseStatement
) -> Setup:
    """A set-up with stated amounts of noise, SI, by name.

    `channel_run` is a run's error, `channel_resolution` the step of its display, whose
    rounding has a twelfth of its square as variance (Sheppard 1898).
    """
    protocol = setup.protocol
    root = math.sqrt(len(protocol.pass_names)) if protocol.average else 1.0
    channels, sigma = [], []
    for channel in setup.instrument.channels:
        step = stated.get(f"{channel.name}{RESOLUTION}", 0.0)
        single = stated.get(channel.name, channel.sigma)
        single = math.hypot(single, step / math.sqrt(12.0))
        run = stated.get(f"{channel.name}{RUN}", channel.shared * single)
        channels.append(
            dataclasses.replace(channel, shared=run / single, resolution=step)
        )
        sigma.append(single / root)
    levels = [c.name for c in channels if f"{c.name}{RUN}" in stated or law.is_assumed]
    statement = dataclasses.replace(
        law,
        levels=frozenset(levels),
        seating=stated.get(SEATING) if setup.instrument.renewed else None,
    )
    instrument = dataclasses.replace(setup.instrument, channels=tuple(channels))
    return dataclasses.replace(
        setup, instrument=instrument, sigma=tuple(sigma), statement=statement
    )


def _amounts(
    table: Mapping[str, float], setups: Sequence[Setup], location: Location
) -> dict[str, float]:
    """Amounts of noise, SI, by name: what a table states of some set-ups."""
    unit_of = _units(table, setups)
    values = quantities.read_values(table, unit_of, location)
    for key, (name, value) in zip(table, values.items(), strict=True):
        field, amount = location.key(key), table[key]
        if name.endswith(RUN) or name == SEATING:
            if value < 0.0:
                problem = "an amount of noise is a standard deviation"
                remedy = "give a number >= 0; 0 says that there is none"
                raise field.error(problem, remedy, amount)
        elif value <= 0.0:
            remedy = "give the standard deviation of one reading"
            raise field.error("noise must be above 0", remedy, amount)
        if value != 0.0 and not MIN_SIGMA <= value <= LARGEST:
            raise field.error(
                "no instrument has such a noise",
                f"check its unit; {MIN_SIGMA:g} to {LARGEST:g} {unit_of[name]} are"
                " possible",
                amount,
            )
        if name == SEATING and not any(s.instrument.renewed for s in setups):
            names = ", ".join(s.name for s in setups)
            remedy = "remove it: it is for a ball bar, whose cup each run seats anew"
            raise field.error(f"no run of {names} seats anything anew", remedy, amount)
    return values


def _units(table: Mapping[str, float], setups: Sequence[Setup]) -> dict[str, str]:
    """SI units of the amounts that can be stated of some set-ups, by name."""
    channels = [c for s in setups for c in s.instrument.channels]
    unit_of = {c.name: c.unit for c in channels}
    unit_of |= {f"{c.name}{end}": c.unit for c in channels for end in (RUN, RESOLUTION)}
    renewed = {
        n.unit for s in setups for n in s.nuisances if n.name in s.instrument.renewed
    }
    if renewed or any(key.startswith(SEATING) for key in table):
        unit_of[SEATING] = next(iter(renewed), "m")
    return unit_of


# The prior of a study from the results of other machines of its model.

#: tolerances by which the nominal numbers of a machine of the same model may differ
MAX_TOLERANCES = 4.0


def fleet_knowledge(
    study: Study, machine: Machine, free: Sequence[str], location: Location
) -> tuple[Array, Array]:
    """Mean (n,), covariance (n, n), SI, of a further machine. Raises InputError."""
    indices = [machine.index(name) for name in free]
    nominal = machine.nominal[indices]
    tolerance = np.array([machine.parameters[k].tolerance for k in indices])
    machines = []
    results: dict[str, StudyResult] = {}
    folders = [study.folder / name for name in study.prior.from_]
    for i, name in enumerate(study.prior.from_):
        here = location.item(i)
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
    prior = history.fleet_prior(machines)
    covariance = prior.covariance * np.outer(tolerance, tolerance)
    return nominal + tolerance * prior.mean, covariance


def result_folder(study: Study, name: str, location: Location) -> Path:
    """The folder that a study names at a place. Raises InputError without a result."""
    folder = study.folder / name
    if not (folder / "result.json").is_file():
        problem = f"there is no result.json in {folder}"
        if not folder.is_dir():
            problem = f"there is no folder {folder}"
        remedy = "name the folder of an `oed identify`, relative to the study's file"
        raise location.error(problem, remedy, name)
    return folder


def _check(
    result: StudyResult,
    machine: Machine,
    free: Sequence[str],
    location: Location,
    name: str,
) -> None:
    """Raises InputError for a result that says nothing of this model by itself."""
    if result.machine.name != machine.name:
        problem = f"it is the result of another machine: {result.machine.name}"
        raise location.error(problem, f"name results of {machine.name}", name)
    section = result.final_estimate
    if section is None or not section.covariance:
        remedy = "make it with `oed identify STUDY --readings CSV --out DIR`"
        raise location.error("it has no estimate with its covariance", remedy, name)
    if result.machine.earlier or result.machine.fleet:
        raise location.error(
            "its prior is that of other sessions, whose readings would count twice",
            "name results whose prior is their tolerances",
            name,
        )
    if "[[prior.correlated]]" in result.study_text:
        raise location.error(
            "its tolerances are correlated, and what its readings say alone is unknown",
            "identify it without [[prior.correlated]]",
            name,
        )
    objections = trust.objections(result)
    if objections:
        remedy = "run `oed diagnose` on its readings, or remove it here"
        raise location.error(
            f"{objections[0]}: nothing should rest on it", remedy, name
        )
    for parameter in free:
        row = section.parameters.get(parameter)
        if row is None or row.prior_sd == 0.0:
            problem = f"{parameter} was not free there"
            remedy = "identify it there, or hold it here: [machine] fixed"
            raise location.error(problem, remedy, name)


def _information(
    result: StudyResult,
    free: Sequence[str],
    nominal: Array,
    tolerance: Array,
    location: Location,
    name: str,
) -> history.MachineInformation:
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
    if np.abs(shift).max() > MAX_TOLERANCES:
        k = int(np.abs(shift).argmax())
        raise location.error(
            f"its nominal {free[k]} differs by {abs(shift[k]):.3g} tolerances: it is a"
            " machine of another size",
            "name machines of one model",
            name,
        )
    block = si_estimates(section, free)[1]
    information = history.MachineInformation.from_posterior(value, block, start, prior)
    return information.rescaled(tolerance / prior, shift)


#: least eigenvalue of a correlation matrix: nearer to 0 one combination has no error left
MIN_EIGENVALUE = 1e-6
#: least share of the machines of the tolerances that keep to all bounds
MIN_SHARE = 0.02


def replace_tolerances(
    study: Study, machine: Machine, setups: dict[str, Setup]
) -> tuple[Machine, dict[str, Setup]]:
    """Machine and set-ups with the study's tolerances and noise. Raises InputError."""
    names = {p.name: p.unit for p in machine.parameters}
    for one in setups.values():
        names |= {f"{one.owner}.{n.name}": n.unit for n in one.nuisances}
    location = study.location.path("prior", "tolerance")
    prior: dict[str, float] = {}  # later tables win
    for i, table in enumerate(study.prior.tolerance):
        prior |= _matching_tolerances(table, names, location.item(i))
    fixed = None
    if study.machine.fixed is not None:
        field = study.location.path("machine", "fixed")
        fixed = set(matching_names(study.machine.fixed, names, field))
    parameters = [
        dataclasses.replace(p, tolerance=prior.get(p.name, p.tolerance))
        for p in machine.parameters
    ]
    machine = machine.with_parameters(parameters)
    if fixed is not None:
        frame = tuple(p.name for p in machine.parameters if p.name in fixed)
        machine = dataclasses.replace(machine, frame=frame)
        prior |= {name: 0.0 for name in fixed}
    machine = with_bounds(study, machine)
    machine = add_correlation(study, machine)
    machine = add_earlier(study, machine)
    setups = with_noise(study, setups)
    stated = {
        s.name: {key.rpartition("_")[0] for key in s.tolerance} for s in study.setup
    }
    changed = {}
    for name, setup in setups.items():
        nuisances = [
            _replace_tolerance(n, setup.owner, stated[name], prior)
            for n in setup.nuisances
        ]
        changed[name] = dataclasses.replace(setup, nuisances=tuple(nuisances))
    return machine, changed


def _replace_tolerance(
    nuisance: Parameter, owner: str, stated: set[str], prior: Mapping[str, float]
) -> Parameter:
    """A set-up's unknown with its tolerance: [[setup]] goes before [prior]."""
    if nuisance.name in stated:
        return nuisance
    tolerance = prior.get(f"{owner}.{nuisance.name}", nuisance.tolerance)
    return dataclasses.replace(nuisance, tolerance=tolerance)


def _matching_tolerances(
    table: ToleranceTable, names: Mapping[str, str], location: Location
) -> dict[str, float]:
    matched, unit = names_of_one_unit(
        table.parameters, names, location.key("parameters")
    )
    sigma = quantities.read_values(table.sigma, {"sigma": unit}, location).get("sigma")
    if sigma is None:
        key = quantities.column("sigma", unit)
        raise location.key(key).error("missing", "give the standard deviation")
    key = next(iter(table.sigma))
    check_not_negative(sigma, location.key(key))
    if sigma > LARGEST:
        problem = "no machine has such a tolerance"
        remedy = f"check its unit; up to {LARGEST:g} {unit} is possible"
        raise location.key(key).error(problem, remedy, table.sigma[key])
    return dict.fromkeys(matched, sigma)


def check_not_negative(value: float, location: Location) -> None:
    """Raises InputError for a tolerance below 0."""
    if value < 0.0:
        raise location.error(
            "a tolerance is a standard deviation", "give a number >= 0", value
        )


def with_bounds(study: Study, machine: Machine) -> Machine:
    """The machine with the bounds of [[prior.bounds]].

    Raises InputError for names and units that do not fit, for a nominal value that is out
    of bounds, and where hardly any machine of the tolerances keeps to them.
    """
    if not study.prior.bounds:
        return machine
    location = study.location.path("prior", "bounds")
    for i, table in enumerate(study.prior.bounds):
        machine = _bounded(machine, table, location.item(i))
    shares = [_share(machine, k) for k in range(len(machine.parameters))]
    if math.prod(shares) < MIN_SHARE:
        raise location.error(
            f"{100.0 * math.prod(shares):.2g} % of the machines of the tolerances keep to"
            " these bounds",
            "narrow the tolerances, or widen the bounds",
        )
    return machine


def _bounded(machine: Machine, table: BoundsTable, location: Location) -> Machine:
    units = {p.name: p.unit for p in machine.parameters}
    matched, unit = names_of_one_unit(
        table.parameters, units, location.key("parameters")
    )
    ends = quantities.read_values(table.ends, {"lower": unit, "upper": unit}, location)
    if not ends:
        key = quantities.column("lower", unit)
        raise location.key(key).error("missing", "give lower, upper, or both")
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
            problem = f"the nominal value of {parameter.name}, {nominal}, is not within"
            remedy = "bounds are of the value, not of its error; check their unit"
            raise location.error(problem, remedy, table.ends)
        parameters.append(dataclasses.replace(parameter, bounds=(low, high)))
    return machine.with_parameters(parameters)


def _share(machine: Machine, number: int) -> float:
    """Share of the values of a parameter's tolerance that are within its bounds."""
    parameter = machine.parameters[number]
    if parameter.tolerance == 0.0 or parameter.name in machine.frame:
        return 1.0
    ends = (np.array(parameter.bounds) - parameter.nominal) / parameter.tolerance
    low, high = scipy.special.ndtr(ends)
    return float(high - low)


# -- errors of a common cause ----------------------------------------------------------
def add_correlation(study: Study, machine: Machine) -> Machine:
    """The machine with [[prior.correlated]]. Raises InputError for what cannot be."""
    tables = study.prior.correlated
    if not tables:
        return machine
    location = study.location.path("prior", "correlated")
    if study.plan is not None:
        raise location.error(
            "the planner of [plan] takes tolerances as independent",
            "remove [plan], or [[prior.correlated]]",
        )
    free = {p.name for p in machine.parameters if p.tolerance > 0.0}
    free -= set(machine.frame)
    groups = []
    for i, table in enumerate(tables):
        field_location = location.item(i)
        names = [p.name for p in machine.parameters]
        matched = matching_names(
            table.parameters, names, field_location.key("parameters")
        )
        members = tuple(name for name in matched if name in free)
        if len(members) < 2:
            raise field_location.key("parameters").error(
                "fewer than two parameters that have a tolerance",
                f"name two or more of {', '.join(sorted(free))}",
                table.parameters,
            )
        groups.append(CommonTolerance(members, table.correlation))
        changed = dataclasses.replace(machine, correlated=tuple(groups))
        matrix = ParameterVector(changed, []).correlation
        if matrix is not None and np.linalg.eigvalsh(matrix)[0] < MIN_EIGENVALUE:
            raise field_location.key("correlation").error(
                "no errors have such correlations"
                + (" together with those above" if i else ""),
                f"{len(members)} parameters have one above"
                f" {-1.0 / (len(members) - 1):.3g} and below 1 between all of them",
                table.correlation,
            )
    return dataclasses.replace(machine, correlated=tuple(groups))


# -- knowledge of other sessions ---------------------------------------------------
def add_earlier(study: Study, machine: Machine) -> Machine:
    """The machine with what [prior] earlier or from knows in place of its tolerances.

    earlier  the posterior of a session of this machine
    from     a further machine of those of the results

    Raises InputError where a result does not fit.
    """
    prior = study.prior
    location = study.location.key("prior")
    if prior.earlier is None and not prior.from_:
        return machine
    if prior.earlier is not None and prior.from_:
        problem = "a session of this machine, and other machines, beside each other"
        raise location.key("from").error(
            problem, "keep one: `earlier` knows more", prior.from_
        )
    field_location = location.key("earlier" if prior.earlier is not None else "from")
    value = prior.earlier if prior.earlier is not None else prior.from_
    if study.plan is not None:
        remedy = "remove [plan]; `oed plan STUDY --after DIR` plans after a session"
        raise field_location.error(
            "the planner of [plan] does not know it", remedy, value
        )
    if machine.correlated:
        remedy = "remove [[prior.correlated]]: the results have correlations"
        raise field_location.error("it has correlations of its own", remedy, value)
    fixed = {p.name for p in machine.parameters if p.tolerance == 0.0}
    fixed |= set(machine.frame)
    free = [p.name for p in machine.parameters if p.name not in fixed]
    if prior.earlier is None:
        return replace_mean_and_covariance(
            machine, free, *fleet_knowledge(study, machine, free, field_location)
        )
    result, folder = named_result(study, prior.earlier, field_location, machine)
    mean, covariance, _ = known_parameters(result, machine.name, free, folder)
    return replace_mean_and_covariance(machine, free, mean, covariance)


def named_result(
    study: Study, name: str, location: Location, machine: Machine
) -> tuple[StudyResult, Path]:
    """The result in a folder that a study names at a place, and the folder.

    A relative name starts at the study's file. Raises InputError where there is no
    result with an identification, or one of another machine.
    """
    folder = result_folder(study, name, location)
    result = load_result(folder)
    difference = machine_difference(result.machine, machine)
    if difference is not None:
        problem = f"it is the result of another machine: {difference}"
        raise location.error(problem, "name a result of this machine", name)
    if result.final_estimate is None:
        remedy = "make it with `oed identify STUDY --readings CSV --out DIR`"
        raise location.error("nothing was identified there", remedy, name)
    return result, folder


def replace_mean_and_covariance(
    machine: Machine, free: list[str], mean: Array, covariance: Array
) -> Machine:
    """The machine with this mean (n,) and covariance (n, n) of free parameters."""
    sd = np.sqrt(np.diag(covariance))
    mean_and_sd = dict(zip(free, zip(mean, sd, strict=True), strict=True))
    parameters = [
        dataclasses.replace(
            p,
            expected=float(mean_and_sd[p.name][0]),
            tolerance=float(mean_and_sd[p.name][1]),
        )
        if p.name in mean_and_sd
        else p
        for p in machine.parameters
    ]
    matrix = covariance / np.outer(sd, sd)
    correlation = tuple(tuple(float(v) for v in row) for row in matrix)
    return dataclasses.replace(
        machine.with_parameters(parameters),
        correlated=(CommonTolerance(tuple(free), correlation),),
    )
