"""Turns a study into the kernel's objects: machine, set-ups, grids, readings, requests.

All numbers are SI from here on. A *table* is what the user wrote; a *request* is what
it means to the kernel. Every misfit raises InputError, which names file and field.
"""

from __future__ import annotations

import csv
import dataclasses
import json
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from oed import units
from oed.base import Array
from oed.compensate import InterpolationTable
from oed.dataset import is_counted, reading_digests, shared
from oed.effect_model import Effect
from oed.instrument import Instrument, Protocol, Setup, mount
from oed.measurement import Measurement, Series
from oed.mechanism import NO_TOOL, AssemblyError, Controller, Kinematics
from oed.model import Machine
from oed.result import StudyResult
from oed.text import suggest
from pkm_studies import catalogue, csv_table, files, quantities, user_code
from pkm_studies.base import InputError, Location
from pkm_studies.earlier_result import ROUNDING, controller_values
from pkm_studies.quantities import column, display_unit
from pkm_studies.resolve import grids
from pkm_studies.resolve.design import (
    DesignRequest,
    candidates,
    circles,
    design_request,
    references,
)
from pkm_studies.resolve.gap import (
    ALL_EFFECTS,
    NO_EFFECTS,
    GapDesignRequest,
    GapRequest,
    effect_with_sizes,
    gap_design_request,
    stated_request,
)
from pkm_studies.resolve.grids import Circles, ReferencePlan
from pkm_studies.resolve.machine import (
    check_joint_range,
    known_name,
    matching_names,
    reach_problem,
    study_kinematics,
)
from pkm_studies.resolve.plan import PlanRequest, plan_request
from pkm_studies.resolve.prediction import (
    PredictionRequest,
    check_reach,
    check_states,
    prediction_request,
    wanted_accuracy,
)
from pkm_studies.resolve.tolerances import (
    check_not_negative,
    named_result,
    replace_tolerances,
    result_folder,
)
from pkm_studies.results import load_result
from pkm_studies.study import Study
from pkm_studies.tables import SetupTable

if TYPE_CHECKING:
    import pandas as pd

    from oed.dataset import Dataset


# Which readings are fitted, held out or simulated.
def reading_roles(
    study: Study, setups: Mapping[str, Setup]
) -> tuple[tuple[str, ...] | None, tuple[str, ...]]:
    """Set-ups whose readings are fitted (None: all others), and those held out."""
    if study.readings is None:
        return None, ()
    location = study.location.key("readings")
    fit, predict = study.readings.fit, study.readings.predict
    for field, names in (("fit", fit or []), ("predict", predict)):
        for i, name in enumerate(names):
            known_name(name, setups, location.path(field, i))
    both = set(fit or ()) & set(predict)
    if both:
        raise location.key("predict").error(
            f"{min(both)} is fitted as well", "name each set-up in fit or in predict"
        )
    if fit is not None and not fit:
        raise location.key("fit").error(
            "the list is empty", "name the set-ups to fit, or leave fit out"
        )
    return (None if fit is None else tuple(fit)), tuple(predict)


def true_parameters(study: Study, measurement: Measurement) -> dict[str, float]:
    """Parameters of the virtual machine, SI, by name; of set-ups from their tables."""
    if study.readings is None:
        return {}
    location = study.location.path("readings", "truth")
    common, special = quantities.split_tables(study.readings.truth)
    unit_of = {p.name: p.unit for p in measurement.parameters}
    truth = quantities.read_values(common, unit_of, location)
    for name, table in special.items():
        field_location = location.key(name)
        setup = measurement.setups[known_name(name, measurement.setups, field_location)]
        unit_of = {n.name: n.unit for n in setup.nuisances}
        values = quantities.read_values(table, unit_of, field_location)
        truth |= {f"{name}.{key}": value for key, value in values.items()}
    return truth


def check_stages(study: Study, measurement: Measurement) -> None:
    """Raises InputError for an identification stage that frees no parameter."""
    location = study.location.path("identify", "stages")
    for i, stage in enumerate(study.identify.stages):
        if not matching_names(stage, measurement.names, location.item(i)):
            raise location.item(i).error(
                "the list is empty", 'name parameters or patterns: ["*"] frees all'
            )


# Readings that a study's prior rests on, and whether new ones are among them.

#: share of readings that equal those of the prior, from which a user must know
MIN_PRIOR_SHARE = 0.2


def prior_results(study: Study) -> Iterator[tuple[Location, str, StudyResult]]:
    """Results that [prior] takes, with place and name. Raises InputError."""
    prior = study.prior
    location = study.location.key("prior")
    named = [(location.path("from", i), name) for i, name in enumerate(prior.from_)]
    if prior.earlier is not None:
        named.append((location.key("earlier"), prior.earlier))
    for field, name in named:
        yield field, name, load_result(result_folder(study, name, field))


def doubtful_sessions(study: Study, new: Collection[str]) -> list[str]:
    """Sentences on results of the prior that share some readings with new ones.

    new  digests of readings

    Raises InputError where the readings are those of a result, or have those in them.
    """
    sentences = []
    for location, name, result in prior_results(study):
        if is_counted(new, result.readings):
            raise location.error(
                "the readings are among those that this result rests on: they would"
                " count twice",
                "give the readings of another session, or take its result out of"
                " [prior]",
                name,
            )
        share = shared(new, result.readings)
        if share >= MIN_PRIOR_SHARE:
            sentences.append(
                f"{share:.0%} of the readings equal some that the prior of {name} rests"
                " on: take those out that were taken once; a coarse scale repeats values"
            )
    return sentences


# The machine with the study's nominal numbers, and its set-ups as mounted.
def mounted_setups(study: Study, kinematics: Kinematics) -> dict[str, Setup]:
    """Every [[setup]] by its name. Raises InputError."""
    location = study.location.key("setup")
    stations: dict[str, Setup] = {}
    setups = {}
    for i, table in enumerate(study.setup):
        setup = _setup(study, table, kinematics, location.item(i))
        setups[table.name] = setup
        first = stations.setdefault(setup.owner, setup)
        if first.nuisances != setup.nuisances or table.station in setups:
            raise location.path(i, "station").error(
                "no station of these set-ups",
                "give all that share it one instrument and the same tolerances, and a"
                " name that no set-up has",
                table.station,
            )
    return setups


def _setup(
    study: Study, table: SetupTable, kinematics: Kinematics, location: Location
) -> Setup:
    machine = kinematics.machine
    instrument = _instrument(study, table, machine, location)
    x, y, z = (float(v) for v in units.to_si(table.tool_mm, "mm"))
    setup = mount(
        instrument,
        table.name,
        tool=(x, y, z),
        teach=_teach(table, instrument.reference == "teach", machine, location),
        tolerances=_tolerances(table, instrument, location),
        **_settings(table, instrument, location),  # type: ignore[arg-type]
    )
    protocol = Protocol(table.repeats, table.both_directions, table.average)
    if len(protocol.pass_names) > 1 and instrument.reference == "run":
        problem = (
            f"{instrument.name} reads against the first pose of a run, so its runs"
            " are not repeated here"
        )
        remedy = "list the repeated runs in the grids"
        raise location.key("repeats").error(problem, remedy, table.repeats)
    setup = dataclasses.replace(setup, protocol=protocol, station=table.station or "")
    if setup.teach is None:
        return setup
    # a teach pose may lie outside the workspace, but the machine must reach it
    field, command = location.key("teach"), np.array([setup.teach])
    try:
        series = Measurement(machine, [setup], kinematics).series(setup.name, command)
    except AssemblyError as error:
        problem = reach_problem(error, machine)
        raise field.error(problem, "give a pose the machine can reach") from error
    check_joint_range(machine, series.command, series.q, field)
    return setup


def _instrument(
    study: Study, table: SetupTable, machine: Machine, location: Location
) -> Instrument:
    """The instrument with the channels it has here. Raises InputError."""
    field = location.key("instrument")
    listed: Instrument = catalogue.instrument(table.instrument, study.origin, field)
    instrument = listed.for_machine(machine)
    reason = instrument.unfit(machine)
    if reason is not None:
        problem = f"it cannot read {machine.name}: {reason}"
        raise field.error(problem, "take another", instrument.name)
    if table.channels is None:
        if instrument.single:
            first = instrument.channels[0].name
            names = ", ".join(c.name for c in instrument.channels)
            problem = f"{instrument.name} reads one channel, and none is named"
            remedy = f'write channels = ["{first}"], or another of {names}'
            raise location.key("channels").error(problem, remedy)
        return instrument
    try:
        return instrument.take_channels(table.channels)
    except ValueError as error:
        remedy = "name the channels that were read"
        raise location.key("channels").error(str(error), remedy) from error


def _settings(
    table: SetupTable, instrument: Instrument, location: Location
) -> dict[str, float]:
    unit_of = {s.name: s.unit for s in instrument.settings}
    settings = quantities.read_values(table.settings, unit_of, location)
    for s in instrument.settings:
        if s.default is None and s.name not in settings:
            key = quantities.column(s.name, s.unit)
            raise location.key(key).error(
                "missing", f"{instrument.name} needs it: {s.about}"
            )
    return settings


def _tolerances(
    table: SetupTable, instrument: Instrument, location: Location
) -> dict[str, float]:
    location = location.key("tolerance")
    unknowns = {n.name: n.unit for n in instrument.nuisances}
    tolerances = quantities.read_values(table.tolerance, unknowns, location)
    for key, value in table.tolerance.items():
        check_not_negative(value, location.key(key))
    return tolerances


def _teach(
    table: SetupTable, needs_teaching: bool, machine: Machine, location: Location
) -> list[float] | None:
    """The command (n_dof,) at which the instrument was taught, if it is taught."""
    location = location.key("teach")
    keys = [quantities.column(c.name, c.unit) for c in machine.command]
    example = "teach = { " + ", ".join(f"{key} = 0" for key in keys) + " }"
    if table.teach is None:
        if needs_teaching:
            remedy = f"say where {table.instrument} was taught: {example}"
            raise location.error("missing", remedy)
        return None
    if not needs_teaching:
        raise location.error(f"{table.instrument} is not taught", "remove teach")
    values = quantities.read_values(table.teach, grids.command_units(machine), location)
    for c, key in zip(machine.command, keys, strict=True):
        if c.name not in values:
            raise location.key(key).error(
                "missing", f"give every coordinate: {example}"
            )
    return [values[c.name] for c in machine.command]


# What the controller holds already: [machine] controller, from a result or a file.

#: rows of a table of parameters by name: value, unit, and nominal where it is there
Rows = Mapping[str, Mapping[str, Any]]
MAX_BYTES = 1 << 26  #: bytes of the largest file
#: what counts as the same command, in the unit of its column: six decimals are written
SAME_COMMAND = 2e-6
REMEDY = (
    "name the folder of a result, or a file of `oed compensate DIR --to json` (or csv)"
)


def hold_parameters(study: Study, kinematics: Kinematics) -> Kinematics:
    """The kinematics under the controller that the study states. Raises InputError."""
    name = study.machine.controller
    if name is None:
        return kinematics
    location = study.location.path("machine", "controller")
    path = study.folder / name
    machine = kinematics.machine
    if not path.is_file():
        if path.suffix in (".json", ".csv"):
            raise location.error(f"there is no file {path}", REMEDY, name)
        result, _ = named_result(study, name, location, machine)
        values, _ = controller_values(result, machine)
        return kinematics.with_controller(Controller(values))
    rows: Rows | None
    if path.suffix == ".json":
        text = files.read_text(path, limit=MAX_BYTES, what="parameter table")
        try:
            document = json.loads(text)
            rows = {str(n): dict(r) for n, r in document["parameters"].items()}
            other = str(document.get("machine", machine.name))
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
            raise location.error(
                "this is no table of parameters", REMEDY, name
            ) from None
        if other != machine.name:
            raise _other_machine(location, name, f"{machine.name} for {other}")
    elif path.suffix != ".csv":
        raise location.error("this is no table of parameters", REMEDY, name)
    else:
        with csv_table.named_errors(str(path)):
            rows = _csv_rows(path, location, name)
    if rows is None:
        return kinematics.with_controller(_tabled(kinematics, path, location))
    values = _parameters(rows, machine, location, name)
    return kinematics.with_controller(Controller(values))


def _csv_rows(path: Path, location: Location, name: str) -> Rows | None:
    """The same of a table of parameters; None of a table of another kind."""
    text = files.read_text(path, limit=MAX_BYTES, what="parameter table")
    reader = csv.DictReader(text.splitlines())
    if not {"name", "value", "unit"} <= set(reader.fieldnames or ()):
        return None
    rows: dict[str, Mapping[str, Any]] = {}
    for row in reader:
        parameter = str(row["name"])
        if parameter in rows:
            problem = f"{path.name} has several rows of {parameter}"
            raise location.error(problem, "leave one of them", name)
        rows[parameter] = row
    if not rows:
        raise location.error(f"{path.name} has no row", REMEDY, name)
    return rows


def _parameters(rows: Rows, machine: Machine, location: Location, name: str) -> Array:
    """Parameters (np,), SI; those without a row are nominal. Raises InputError."""
    values = machine.nominal.copy()
    names_of_machine = [p.name for p in machine.parameters]
    for parameter, row in rows.items():
        if parameter not in names_of_machine:
            problem = f"{machine.name} has no parameter {parameter}"
            raise location.error(
                problem, suggest(parameter, names_of_machine, "parameters"), name
            )
        k = names_of_machine.index(parameter)
        si = machine.parameters[k].unit
        number, nominal = _number(row, "value"), _number(row, "nominal")
        unit = str(row.get("unit"))
        if unit not in units.UNITS or units.si_unit(unit) != si or number is None:
            problem = f"{parameter} has no number in a unit such as {display_unit(si)}"
            raise location.error(problem, REMEDY, name)
        values[k] = units.to_si(number, unit)
        drawn = units.number(machine.nominal[k], unit)
        if nominal is not None and not math.isclose(
            nominal, drawn, rel_tol=ROUNDING, abs_tol=ROUNDING
        ):
            phrase = f"{parameter} = {drawn:.9g} for {nominal:.9g} {unit}"
            raise _other_machine(location, name, phrase)
    return values


def _number(row: Mapping[str, Any], key: str) -> float | None:
    """A finite number of a row; None where there is none."""
    try:
        number = float(row[key])
    except (KeyError, TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None


def _other_machine(location: Location, name: str, phrase: str) -> InputError:
    problem = f"it is the table of another machine: {phrase}"
    return location.error(problem, "name a table of this machine", name)


def _tabled(kinematics: Kinematics, path: Path, location: Location) -> Controller:
    """A controller with nominal parameters that adds the corrections of a table."""
    machine = kinematics.machine
    joints = [(f"correction_{j.name}", j.unit) for j in machine.joints]
    rows = csv_table.read(path)
    absent = [c for c in (column(*joint) for joint in joints) if c not in rows.header]
    if absent:
        problem = f"{path} has neither parameters nor a column {absent[0]}"
        raise location.error(problem, REMEDY, path.name)
    knots, turns = _knots(machine, path.with_name(f"{path.stem}_grid.csv"))
    values = np.column_stack([_column(rows, *joint) for joint in joints])
    commands = np.column_stack([_column(rows, c.name, c.unit) for c in machine.command])
    shape = tuple(len(places) for places in knots)
    nodes = np.stack(np.meshgrid(*knots, indexing="ij"), -1).reshape(-1, len(knots))
    factors = [units.factor(display_unit(c.unit)) for c in machine.command]
    slack = SAME_COMMAND * np.array(factors)
    if nodes.shape != commands.shape or (np.abs(nodes - commands) > slack).any():
        problem = f"the rows of {path} are not those of its grid"
        raise location.error(problem, "take both files as they were written", path.name)
    names = tuple(c.name for c in machine.command)
    table = InterpolationTable(names, knots, values.reshape(*shape, -1), turns)

    def corrections(command: Array, pose: Array) -> Array:
        """The table is over commands of the reference tool."""
        return table.at(kinematics.command_of_pose(pose, command, NO_TOOL))

    return Controller(machine.nominal, corrections)


def _knots(machine: Machine, path: Path) -> tuple[tuple[Array, ...], tuple[bool, ...]]:
    """Places along the axes of a table, SI, and which axes are a full turn."""
    if not path.is_file():
        remedy = "keep the files of `oed compensate --to csv` together"
        raise InputError("the axes of the table are missing", remedy, file=str(path))
    rows = csv_table.read(path)
    ends = zip(rows.numbers("first"), rows.numbers("last"), strict=True)
    counts, turns = rows.numbers("count"), rows.cells("repeats")
    names = rows.cells("coordinate")
    wanted = [column(c.name, c.unit) for c in machine.command]
    if names != wanted or (counts < 1).any():
        raise InputError(
            f"its axes are {', '.join(names)}, those of the machine {', '.join(wanted)}",
            "name a table of this machine",
            file=str(path),
        )
    factors = [units.factor(display_unit(c.unit)) for c in machine.command]
    knots = tuple(
        np.linspace(first, last, int(count)) * factor
        for (first, last), count, factor in zip(ends, counts, factors, strict=True)
    )
    return knots, tuple(word == "yes" for word in turns)


def _column(rows: csv_table.CsvTable, name: str, si: str) -> Array:
    """A column of the table, SI."""
    return units.to_si(rows.numbers(column(name, si)), display_unit(si))


@dataclasses.dataclass(frozen=True, kw_only=True)
class ResolvedStudy:
    """A study as the kernel's objects.

    design, plan            what [design] and [plan] request
    gap, gap_design         what [gap] and [gap.design] request
    """

    #: degrees of freedom from which on the scale of a noise is known to a third
    MIN_FREEDOM_OF_SCALE: ClassVar[int] = 4

    study: Study
    machine: Machine  #: the model with the study's numbers and tolerances
    setups: Mapping[str, Setup]  #: every set-up of the study, by name
    #: machine with the set-ups that candidates and readings use; without both, those of
    #: the reference plans, or all
    measurement: Measurement
    #: the measurement with the set-ups of these names
    measurement_with: Callable[[Iterable[str]], Measurement]
    #: one series for each [[design.candidates]], within its limits
    candidates: tuple[Series, ...]
    refusals: Mapping[str, int]  #: candidates outside the limits, counted by reason
    design: DesignRequest | None
    plan: PlanRequest | None
    reference_plans: tuple[ReferencePlan, ...]  #: the plans that the study gives
    kappa_circles: tuple[Circles, ...]  #: circles of each [[kappa]] map
    #: parameters of the virtual machine, SI, by name; those not named are nominal
    true_parameters: Mapping[str, float]
    dataset: Dataset | None  #: the recorded readings, if any
    #: set-ups whose readings are fitted; None: all others
    fitted_setups: tuple[str, ...] | None
    #: set-ups whose readings are predicted, not fitted
    held_out_setups: tuple[str, ...]
    #: patterns of the parameters freed in turn
    identification_stages: tuple[tuple[str, ...], ...]
    #: what [prediction] requests: where accuracy is predicted
    prediction: PredictionRequest | None
    wanted_accuracy: Mapping[str, float]  #: rms error to reach by component, SI
    gap: GapRequest | None
    gap_design: GapDesignRequest | None
    #: sentences about candidates that were dropped, and readings
    warnings: tuple[str, ...]

    @property
    def gap_or_default(self) -> GapRequest:
        """What [gap] requests, or its defaults without the table. Raises InputError."""
        return self.gap or GapRequest.from_study(self.study, self.machine)

    @property
    def diagnosed(self) -> GapRequest:
        """The same with the effects that [identify] names, if any. Raises InputError."""
        request, names = self.gap_or_default, self.study.identify.effects
        location = self.study.location.path("identify", "effects")
        named = request.named_effects(names or ALL_EFFECTS, location)
        return dataclasses.replace(request, effects=tuple(named))

    def resume_plan(self, machine: Machine, done: Iterable[str]) -> Self:
        """The study about the identified machine, its [plan] without set-ups that are `done`."""
        controller = self.measurement.kinematics.controller
        kinematics = Kinematics(machine).with_controller(controller)
        measurement_with = measurement_factory(kinematics, self.setups)
        return dataclasses.replace(
            self,
            machine=machine,
            measurement_with=measurement_with,
            measurement=measurement_with(self.measurement.setups),
            plan=plan_request(self.study, measurement_with, self.prediction, done),
        )

    def check_states(self, covariates: pd.DataFrame) -> None:
        """Raises InputError for a state in use that no reading was recorded at."""
        check_states(self.study, covariates)

    def allows_effects(self, *, is_recorded: bool) -> bool:
        """Whether [identify] has readings diagnosed: by default those of a machine."""
        names = self.study.identify.effects
        if names is None:
            return is_recorded
        return names not in (NO_EFFECTS, [])

    def with_dataset(self, dataset: Dataset | None) -> Self:
        """The study with these readings. Raises InputError where its prior has them."""
        warnings = self.warnings
        if dataset is not None:
            fitted = self.fitted(dataset)
            check_states(self.study, fitted.covariates)
            new = reading_digests(fitted.series, fitted.y, self.setups)
            warnings = (*warnings, *doubtful_sessions(self.study, new))
        return dataclasses.replace(self, dataset=dataset, warnings=warnings)

    def read_dataset(self, readings: Sequence[Path] | None) -> Dataset | None:
        """The recorded readings of files, or of those that the study names; None: none."""
        from pkm_studies import sources  # loads what reads files

        table = self.study.readings
        everything = self.measurement_with(self.setups)
        if readings:
            return sources.read_files(readings, everything)
        if readings is not None or table is None or table.simulate:
            return None
        return sources.readings(table, self.study, everything)

    def with_stated_readings(self) -> Self:
        """The study with the readings that its file names."""
        return self.with_dataset(self.read_dataset(None))

    def counted_digests(self, new: Collection[str]) -> list[str]:
        """Digests of new readings and of those behind the prior, sorted."""
        digests = set(new)
        for _, _, result in prior_results(self.study):
            digests.update(result.readings)
        return sorted(digests)

    def noise_is_a_guess(self, measurement: Measurement, count: int) -> bool:
        """Whether the stated noise of so many values is one that they correct.

        So it is where the study says so, and where the noise is an assumption, and enough
        values remain beyond the parameters.
        """
        freedom = count - int(measurement.free.sum())
        noise = self.study.noise
        is_tested = freedom >= self.MIN_FREEDOM_OF_SCALE
        return noise.estimate is True or (noise.assumed and is_tested)

    def effect_of_catalogue(self, name: str, location: Location) -> Effect:
        """An effect with the sizes that the study expects of it. Raises InputError."""
        effect = catalogue.effect(name, self.study.origin, location)
        return effect_with_sizes(effect, self.study)

    def check_effect_names(self) -> None:
        """Raise InputError for a name in `effects` of a table that is no effect."""
        tables = {
            "design": self.study.design,
            "plan": self.study.plan,
            "identify": self.study.identify,
        }
        for key, table in tables.items():
            if table is not None and table.effects is not None:
                location = self.study.location.path(key, "effects")
                self.gap_or_default.named_effects(table.effects, location)

    @property
    def has_own_numbers(self) -> bool:
        """Whether the study states another machine than one of the catalogue."""
        table = self.study.machine
        numbers = table.geometry or table.nominal or table.workspace or table.travel
        return bool(numbers) or user_code.is_file(table.model)

    def fitted(self, dataset: Dataset) -> Dataset:
        """The readings that are fitted."""
        fitted, held_out = self.fitted_setups, self.held_out_setups
        names = [name for name in dataset.setups if name not in held_out]
        return dataset.take([n for n in names if fitted is None or n in fitted])


def resolve(study: Study, *, readings: Sequence[Path] | None = None) -> ResolvedStudy:
    """The objects of a study, with other readings where given, none for an empty list."""
    nominal = hold_parameters(study, study_kinematics(study))
    mounted = mounted_setups(study, nominal)
    machine, mounted = replace_tolerances(study, nominal.machine, mounted)
    kinematics = nominal.with_priors_of(machine)
    measurement_with = measurement_factory(kinematics, mounted)
    everything = measurement_with(mounted)
    pool, refusals, warnings = candidates(study, everything)
    plans = references(study, everything)
    design = design_request(study, everything, plans, pool)
    kappa_circles = [
        circles(study, table, i, measurement_with, plans)
        for i, table in enumerate(study.kappa)
    ]
    fitted, held_out = reading_roles(study, mounted)
    check_stages(study, everything)
    if not everything.free.any():
        raise study.location.path("machine", "fixed").error(
            "every parameter is fixed: nothing is left to identify",
            "leave the ones that the readings are to say",
            study.machine.fixed,
        )
    prediction = prediction_request(study, machine)
    if prediction is not None:
        check_reach(study, prediction, kinematics)
    # set-ups of candidates and readings; without both, of reference plans, or all
    used = {s.setup for s in pool}
    if pool and design is not None:
        used |= {s.setup for s in design.retained}
    if study.readings is not None:
        recorded = not study.readings.simulate
        used |= set(study.readings.fit or (mounted if recorded else ()))
        used |= set(study.readings.predict)
    resolved = ResolvedStudy(
        study=study,
        machine=machine,
        setups=mounted,
        measurement=measurement_with(
            used or {name for plan in plans for name in plan.setups} or mounted
        ),
        measurement_with=measurement_with,
        candidates=pool,
        refusals=refusals,
        design=design,
        plan=plan_request(study, measurement_with, prediction),
        reference_plans=plans,
        kappa_circles=tuple(kappa_circles),
        true_parameters=true_parameters(study, everything),
        dataset=None,
        fitted_setups=fitted,
        held_out_setups=held_out,
        identification_stages=tuple(tuple(s) for s in study.identify.stages),
        prediction=prediction,
        wanted_accuracy=wanted_accuracy(study, machine),
        gap=stated_request(study, machine),
        gap_design=gap_design_request(study, plans, everything),
        warnings=warnings,
    )
    return resolved.with_dataset(resolved.read_dataset(readings))


def measurement_factory(
    kinematics: Kinematics, mounted: Mapping[str, Setup]
) -> Callable[[Iterable[str]], Measurement]:
    """A function that gives the measurement with the set-ups of some names, once each."""
    cache: dict[tuple[str, ...], Measurement] = {}

    def measurement_with(names: Iterable[str]) -> Measurement:
        """The measurement with these set-ups, in the study's order."""
        wanted = set(names)
        key = tuple(name for name in mounted if name in wanted)
        if key not in cache:
            chosen = [mounted[name] for name in key]
            cache[key] = Measurement(kinematics.machine, chosen, kinematics)
        return cache[key]

    return measurement_with
