"""From what a study says to the kernel's objects: machine, set-ups, grids, readings;
all SI, no TOML beyond here.

Raises InputError, naming file and field, for everything that does not fit the machine
or the instruments.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from oed import units
from oed.arrays import Array
from oed.instrument import Protocol, Setup, mount
from oed.kinematics import AssemblyError
from oed.machine import Machine, Parameter
from oed.measurement import Measurement, Series
from pkm_studies import catalogue
from pkm_studies.errors import Place, suggest
from pkm_studies.resolve import design as resolve_design
from pkm_studies.resolve import gap as resolve_gap
from pkm_studies.resolve import gap_design as resolve_gap_design
from pkm_studies.resolve import grids, naming, quantities
from pkm_studies.resolve import plan as resolve_plan
from pkm_studies.resolve.design import Asked
from pkm_studies.resolve.gap import GapAsked
from pkm_studies.resolve.gap_design import GapDesignAsked
from pkm_studies.resolve.grids import Circles, ReferencePlan
from pkm_studies.resolve.plan import PlanAsked
from pkm_studies.study.load import SetupTable, Study

if TYPE_CHECKING:
    from oed.dataset import Dataset


@dataclasses.dataclass(frozen=True, kw_only=True)
class Resolved:
    """A study as objects.

    measurement  machine with the set-ups that candidates and readings use; where there
                 are neither, with those of the reference plans, or all: a set-up that
                 only [[kappa]] or a reference plan names stays out
    candidates   one series for each [[design.candidates]], within its limits; refused
                 {reason: number of others}
    asked        what [design] asks for;  plan: what [plan] asks for, where it lists
                 measurements
    references   the given plans, by name
    truth        parameters (SI) of the virtual machine by name, nominal where absent
    dataset      the readings, where the study has some
    fit          set-ups whose readings are fitted; None: all but `predict`
    stages       patterns of the parameters freed in turn
    prediction   commands (n, n_dof) at which accuracy is predicted
    gap          what [gap] asks for, where there is one;  gap_design  likewise
                 [gap.design]
    warnings     what was left out, in words
    """

    study: Study
    machine: Machine
    setups: Mapping[str, Setup]
    measurement: Measurement
    measure: Callable[[Iterable[str]], Measurement]
    candidates: tuple[Series, ...]
    refused: Mapping[str, int]
    asked: Asked | None
    plan: PlanAsked | None
    references: tuple[ReferencePlan, ...]
    kappa: tuple[Circles, ...]
    truth: Mapping[str, float]
    dataset: Dataset | None
    fit: tuple[str, ...] | None
    predict: tuple[str, ...]
    stages: tuple[tuple[str, ...], ...]
    prediction: Array | None
    gap: GapAsked | None
    gap_design: GapDesignAsked | None
    warnings: tuple[str, ...]


def resolve(study: Study, *, readings: Sequence[Path] | None = None) -> Resolved:
    """The objects of a study.

    `readings`: files to read instead of what [readings] names; none where it is empty.
    """
    model = catalogue.machine(
        study.machine.model, study.folder, study.place.key("machine").key("model")
    )
    machine = _machine(study, model)
    setups = _setups(study, machine)
    machine, setups = _tolerances(study, machine, setups)
    measure = measurer(machine, setups)
    everything = measure(setups)
    candidates, refused, warnings = resolve_design.candidates(study, everything)
    references = resolve_design.references(study, everything)
    asked = resolve_design.asked(study, everything, references)
    fit, predict = _roles(study, setups)
    _check_stages(study, everything)
    return Resolved(
        study=study,
        machine=machine,
        setups=setups,
        measurement=measure(_used(study, candidates, asked, references, setups)),
        measure=measure,
        candidates=candidates,
        refused=refused,
        asked=asked,
        plan=resolve_plan.planned(study, measure, setups),
        references=references,
        kappa=tuple(
            resolve_design.circles(study, k, i, measure)
            for i, k in enumerate(study.kappa)
        ),
        truth=_truth(study, everything),
        dataset=_dataset(study, everything, readings),
        fit=fit,
        predict=predict,
        stages=tuple(tuple(stage) for stage in study.identify.stages),
        prediction=_prediction(study, machine),
        gap=resolve_gap.asked(study, machine),
        gap_design=resolve_gap_design.asked(study, references, everything),
        warnings=warnings,
    )


# -- machine and set-ups ---------------------------------------------------------------


def _machine(study: Study, model: Machine) -> Machine:
    """The model with the study's nominal numbers."""
    known = {p.name: p.unit for p in model.parameters}
    nominal = quantities.read(
        study.machine.nominal, known, study.place.key("machine").key("nominal")
    )
    table = [
        dataclasses.replace(p, nominal=nominal.get(p.name, p.nominal))
        for p in model.parameters
    ]
    return model.with_parameters(table)


def _setups(study: Study, machine: Machine) -> dict[str, Setup]:
    place = study.place.key("setup")
    return {
        s.name: _setup(study, s, machine, place.item(i))
        for i, s in enumerate(study.setup)
    }


def _setup(study: Study, table: SetupTable, machine: Machine, place: Place) -> Setup:
    instrument = catalogue.instrument(
        table.instrument, study.folder, place.key("instrument")
    )
    reason = instrument.unfit(machine)
    if reason is not None:
        raise place.key("instrument").error(
            f"it cannot read {machine.name}: {reason}", "take another", instrument.name
        )
    settings = quantities.read(
        table.settings, {s.name: s.unit for s in instrument.settings}, place
    )
    for s in instrument.settings:
        if s.default is None and s.name not in settings:
            key = quantities.column(s.name, s.unit)
            raise place.key(key).error(
                "missing", f"{instrument.name} needs it: {s.about}"
            )
    unknowns = {n.name: n.unit for n in instrument.nuisances}
    tolerances = quantities.read(table.tolerance, unknowns, place.key("tolerance"))
    for key, value in table.tolerance.items():
        _not_negative(value, place.key("tolerance").key(key))
    made = mount(
        instrument,
        table.name,
        tool=_triple(table.tool_mm),
        teach=_teach(table, instrument.reference == "teach", machine, place),
        tolerances=tolerances,
        **settings,  # type: ignore[arg-type]
    )
    made = dataclasses.replace(made, protocol=_protocol(table, made, place))
    _reach(machine, made, place)
    return made


def _protocol(table: SetupTable, made: Setup, place: Place) -> Protocol:
    protocol = Protocol(table.repeats, table.both_directions, table.average)
    if len(protocol.passes) > 1 and made.instrument.reference == "run":
        problem = (
            f"{made.instrument.name} reads against the first pose of a run, so its runs"
            " are not repeated here"
        )
        raise place.key("repeats").error(
            problem, "list the repeated runs in the grids", table.repeats
        )
    return protocol


def _triple(tool_mm: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in units.to_si(tool_mm, "mm"))
    return x, y, z


def _teach(
    table: SetupTable, taught: bool, machine: Machine, place: Place
) -> list[float] | None:
    keys = [quantities.column(c.name, c.unit) for c in machine.command]
    example = "teach = { " + ", ".join(f"{k} = 0" for k in keys) + " }"
    if table.teach is None:
        if taught:
            raise place.key("teach").error(
                "missing", f"say where {table.instrument} was taught: {example}"
            )
        return None
    if not taught:
        raise place.key("teach").error(
            f"{table.instrument} is not taught", "remove teach"
        )
    values = quantities.read(table.teach, grids.wanted(machine), place.key("teach"))
    for c, key in zip(machine.command, keys, strict=True):
        if c.name not in values:
            raise (
                place.key("teach")
                .key(key)
                .error("missing", f"give every coordinate: {example}")
            )
    return [values[c.name] for c in machine.command]


def _reach(machine: Machine, setup: Setup, place: Place) -> None:
    """A teach pose may lie outside the workspace, but the machine must get there."""
    if setup.teach is None:
        return
    try:
        made = Measurement(machine, [setup]).series(setup.name, np.array([setup.teach]))
    except AssemblyError as error:
        raise place.key("teach").error(
            str(error), "give a pose the machine can reach"
        ) from error
    grids.in_joint_range(machine, made, place.key("teach"))


# -- noise and tolerances --------------------------------------------------------------


def _tolerances(
    study: Study, machine: Machine, setups: dict[str, Setup]
) -> tuple[Machine, dict[str, Setup]]:
    """Machine and set-ups with the study's priors, fixed parameters and noise."""
    found = _priors(study, machine, setups)
    fixed = _fixed(study, machine, setups)
    table = [
        dataclasses.replace(p, tolerance=found.get(p.name, p.tolerance))
        for p in machine.parameters
    ]
    machine = machine.with_parameters(table)
    if fixed is not None:
        frame = tuple(p.name for p in machine.parameters if p.name in fixed)
        machine = dataclasses.replace(machine, frame=frame)
        found |= {name: 0.0 for name in fixed}
    noise = _noise(study, setups)
    said = {s.name: s.tolerance for s in study.setup}
    new = {}
    for name, setup in setups.items():
        own = {key.rpartition("_")[0] for key in said[name]}
        new[name] = dataclasses.replace(
            setup,
            nuisances=tuple(_with(n, name, own, found) for n in setup.nuisances),
            sigma=noise[name],
        )
    return machine, new


def _with(
    nuisance: Parameter, setup: str, own: set[str], found: Mapping[str, float]
) -> Parameter:
    """A set-up's unknown with its tolerance: what [[setup]] says comes before what
    [prior] says.
    """
    value = (
        nuisance.tolerance
        if nuisance.name in own
        else found.get(f"{setup}.{nuisance.name}", nuisance.tolerance)
    )
    return dataclasses.replace(nuisance, tolerance=value)


def _names(machine: Machine, setups: Mapping[str, Setup]) -> dict[str, str]:
    """All parameters with their SI units: the machine's, and `set-up.unknown`."""
    table = {p.name: p.unit for p in machine.parameters}
    return table | {
        f"{s.name}.{n.name}": n.unit for s in setups.values() for n in s.nuisances
    }


def _priors(
    study: Study, machine: Machine, setups: Mapping[str, Setup]
) -> dict[str, float]:
    names = _names(machine, setups)
    found: dict[str, float] = {}
    for i, table in enumerate(study.prior.tolerance):
        place = study.place.key("prior").key("tolerance").item(i)
        matched = naming.match(table.parameters, names, place.key("parameters"))
        if not matched:
            raise place.key("parameters").error(
                "the list is empty", 'name parameters or patterns: ["dq*"]'
            )
        kinds = {names[n]: n for n in matched}
        if len(kinds) > 1:
            told = " and ".join(f"{n} ({unit})" for unit, n in kinds.items())
            raise place.key("parameters").error(
                f"parameters of different kinds: {told}", "make one table for each kind"
            )
        unit = next(iter(kinds))
        value = quantities.read(table.sigma, {"sigma": unit}, place).get("sigma")
        if value is None:
            raise place.key(quantities.column("sigma", unit)).error(
                "missing", "give the standard deviation"
            )
        _not_negative(value, place.key(next(iter(table.sigma))))
        found |= dict.fromkeys(matched, value)
    return found


def _fixed(
    study: Study, machine: Machine, setups: Mapping[str, Setup]
) -> set[str] | None:
    if study.machine.fixed is None:
        return None
    place = study.place.key("machine").key("fixed")
    return set(naming.match(study.machine.fixed, _names(machine, setups), place))


def _noise(study: Study, setups: Mapping[str, Setup]) -> dict[str, tuple[float, ...]]:
    """Noise (SI) of each channel by set-up: the instrument's, for all set-ups, for one."""
    place = study.place.key("noise")
    own = {k: v for k, v in study.noise.sigma.items() if isinstance(v, Mapping)}
    common = {k: v for k, v in study.noise.sigma.items() if not isinstance(v, Mapping)}
    for name in own:
        if name not in setups:
            raise place.key(name).error("no such set-up", suggest(name, setups))
    channels = {c.name: c.unit for s in setups.values() for c in s.instrument.channels}
    general = _sigma(common, channels, place)
    sigma = {}
    for name, setup in setups.items():
        special = _sigma(
            own.get(name, {}),
            {c.name: c.unit for c in setup.instrument.channels},
            place.key(name),
        )
        found = {c.name: c.sigma for c in setup.instrument.channels} | general | special
        mean = math.sqrt(len(setup.protocol.passes)) if setup.protocol.average else 1.0
        sigma[name] = tuple(found[c.name] / mean for c in setup.instrument.channels)
    return sigma


def _sigma(
    table: Mapping[str, float], channels: Mapping[str, str], place: Place
) -> dict[str, float]:
    values = quantities.read(table, channels, place)
    for key, value in table.items():
        if value <= 0.0:
            raise place.key(key).error(
                "noise must be above 0",
                "give the standard deviation of one reading",
                value,
            )
    return values


def _not_negative(value: float, place: Place) -> None:
    if value < 0.0:
        raise place.error(
            "a tolerance is a standard deviation", "give a number >= 0", value
        )


# -- measurements and grids ------------------------------------------------------------


def measurer(
    machine: Machine, setups: Mapping[str, Setup]
) -> Callable[[Iterable[str]], Measurement]:
    made: dict[tuple[str, ...], Measurement] = {}

    def measure(names: Iterable[str]) -> Measurement:
        """The measurement with these set-ups, in the study's order; made once."""
        wanted = set(names)
        key = tuple(n for n in setups if n in wanted)
        if key not in made:
            made[key] = Measurement(machine, [setups[n] for n in key])
        return made[key]

    return measure


def _prediction(study: Study, machine: Machine) -> Array | None:
    if study.prediction is None:
        return None
    place = study.place.key("prediction")
    command, hold, keys = grids.expand(study.prediction.coordinates, machine, place)
    if hold is not None:
        raise place.key(hold).error(
            "accuracy is predicted without an instrument",
            "give values with a unit",
            "hold",
        )
    grids.in_workspace(machine, command, keys, place)
    return command


# -- readings --------------------------------------------------------------------------


def _used(
    study: Study,
    candidates: Sequence[Series],
    asked: Asked | None,
    references: Sequence[ReferencePlan],
    setups: Mapping[str, Setup],
) -> Iterable[str]:
    used = {s.setup for s in candidates}
    if candidates and asked is not None:
        used |= {s.setup for s in asked.kept}
    if study.readings is not None:
        recorded = not study.readings.simulate
        used |= set(study.readings.fit or (setups if recorded else ())) | set(
            study.readings.predict
        )
    return used or {n for plan in references for n in plan.setups} or setups


def _roles(
    study: Study, setups: Mapping[str, Setup]
) -> tuple[tuple[str, ...] | None, tuple[str, ...]]:
    """Set-ups whose readings are fitted, and those kept out."""
    if study.readings is None:
        return None, ()
    place = study.place.key("readings")
    for field, names in (
        ("fit", study.readings.fit or []),
        ("predict", study.readings.predict),
    ):
        for i, name in enumerate(names):
            naming.known(name, setups, place.key(field).item(i))
    fit = study.readings.fit
    both = set(fit or ()) & set(study.readings.predict)
    if both:
        raise place.key("predict").error(
            f"{min(both)} is fitted as well", "name each set-up in fit or in predict"
        )
    if fit is not None and not fit:
        raise place.key("fit").error(
            "the list is empty", "name the set-ups to fit, or leave fit out"
        )
    return (None if fit is None else tuple(fit)), tuple(study.readings.predict)


def _truth(study: Study, measurement: Measurement) -> dict[str, float]:
    """Parameters of the virtual machine, SI; a set-up's unknowns stand in a table named
    as the set-up.
    """
    if study.readings is None:
        return {}
    place = study.place.key("readings").key("truth")
    own = {k: v for k, v in study.readings.truth.items() if isinstance(v, Mapping)}
    common = {
        k: v for k, v in study.readings.truth.items() if not isinstance(v, Mapping)
    }
    truth = quantities.read(
        common, {p.name: p.unit for p in measurement.parameters}, place
    )
    for name, table in own.items():
        setup = measurement.setups[
            naming.known(name, measurement.setups, place.key(name))
        ]
        known = {n.name: n.unit for n in setup.nuisances}
        values = quantities.read(table, known, place.key(name))
        truth |= {f"{name}.{k}": v for k, v in values.items()}
    return truth


def _check_stages(study: Study, measurement: Measurement) -> None:
    place = study.place.key("identify").key("stages")
    for i, stage in enumerate(study.identify.stages):
        if not naming.match(stage, measurement.names, place.item(i)):
            raise place.item(i).error(
                "the list is empty", 'name parameters or patterns: ["*"] frees all'
            )


def _dataset(
    study: Study, measurement: Measurement, readings: Sequence[Path] | None
) -> Dataset | None:
    """The readings: files given to the command, files of the study, or its source."""
    said = study.readings
    if readings is None and (said is None or said.simulate):
        return None
    if readings is not None and not readings:
        return None
    from pkm_studies import sources  # pandas takes a second to import

    if readings is not None:
        return sources.from_files(readings, measurement)
    return sources.readings(study, measurement)
