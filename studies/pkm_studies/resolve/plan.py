"""Table [plan] as objects: options to plan with, target accuracies, sequences; SI.

Everything that does not fit the machine or the instruments raises InputError with file
and field.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from oed import planning, units
from oed.base import Array
from oed.measurement import Measurement, Series
from pkm_studies import quantities
from pkm_studies.base import Location
from pkm_studies.resolve import grids
from pkm_studies.resolve.gap import NO_EFFECTS, PLAN, GapRequest
from pkm_studies.resolve.machine import known_name
from pkm_studies.resolve.prediction import PredictionRequest
from pkm_studies.study import Study
from pkm_studies.tables import GridTable, MeasuredTable, PlanTable

if TYPE_CHECKING:
    from oed.design import Nuisances
    from oed.effects import PlannedEffects
    from oed.planning import Option

MeasurementWith = Callable[[Iterable[str]], Measurement]


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlanRequest:
    """What [plan] requests."""

    table: PlanTable  #: the table itself
    prediction: PredictionRequest  #: where accuracy counts
    options: tuple[Option, ...]  #: the measurements, in the study's order
    targets: Mapping[str, float]  #: {pose component: accuracy}, SI
    budget: float  #: time for accuracy, s
    #: sequences of names of measurements to compare with the plan
    compare: tuple[tuple[str, ...], ...]
    reserved: float = 0.0  #: time kept for [gap.design], s
    #: what effects beside the geometry do to all candidate readings and the tool; None
    #: where the plan allows for none
    effects: PlannedEffects | None = None

    def option(self, name: str) -> Option:
        """A measurement by its name."""
        return next(o for o in self.options if o.name == name)


def plan_request(
    study: Study,
    measurement_with: MeasurementWith,
    prediction: PredictionRequest | None,
    done: Iterable[str] = (),
) -> PlanRequest | None:
    """What [plan] requests; None without measurements. Raises InputError.

    prediction  what [prediction] requests
    done        set-ups whose readings are taken: their measurements are left out
    """
    table = study.plan
    if table is None or not table.measurement:
        return None
    location = study.location.key("plan")
    available = _budget_min(table, location)
    if prediction is None:
        problem = "a plan aims at accuracy over a workspace, and the study has none"
        raise location.key("measurement").error(
            problem, "add a [prediction] table: reference and coordinates"
        )
    _check_names(table, location, [setup.name for setup in study.setup])
    _check_sequences(table, location)
    finished = set(done)
    open_tables = {
        t.name: (t, location.path("measurement", i))
        for i, t in enumerate(table.measurement)
        if not set(t.mounted) & finished
    }
    machine = measurement_with(()).machine
    components = {c.name: c.unit for c in machine.components}
    effects = _effects(table, study, open_tables, measurement_with, prediction)
    options = []
    first = 0
    for measured, field in open_tables.values():
        nuisances = None if effects is None else effects.readings.after(first)
        option = _option(measured, measurement_with, field, nuisances)
        first += len(option.nominal_readings)
        options.append(option)
    reserved = _reserved_seconds(study, available)
    budget = units.factor("min") * available
    return PlanRequest(
        table=table,
        prediction=prediction,
        options=tuple(options),
        targets=quantities.read_values(
            table.wanted, components, location.key("wanted")
        ),
        budget=budget - reserved,
        reserved=reserved,
        compare=tuple(
            tuple(names) for names in table.compare if set(names) <= set(open_tables)
        ),
        effects=effects,
    )


STATE_SEED = 0  #: seed of the states of the workspace in which effects act
#: combinations of effects that are unknowns of a plan, at most: its search carries a
#: covariance of them from stage to stage
MAX_EFFECT_UNKNOWNS = 20


def _effects(
    table: PlanTable,
    study: Study,
    tables: Mapping[str, tuple[MeasuredTable, Location]],
    measurement_with: MeasurementWith,
    prediction: PredictionRequest,
) -> PlannedEffects | None:
    """What the effects of [plan] do to the readings of all its measurements.

    Raises InputError for names that are no effects, and where virtual machines are asked
    for, which have none.
    """
    if table.effects == NO_EFFECTS or not tables:
        return None
    location = study.location.path("plan", "effects")
    if table.virtual_machines:
        raise location.error(
            "virtual machines of a plan have no effects",
            "write virtual_machines = 0, or leave effects out",
        )
    names = [name for measured, _ in tables.values() for name in measured.mounted]
    measurement = measurement_with(names)
    series = [
        _grid(measured, name, measurement_with(measured.mounted), field)
        for measured, field in tables.values()
        for name in measured.mounted
    ]
    return GapRequest.from_study(study, measurement.machine).planned_effects(
        measurement,
        series,
        table.effects,
        location,
        prediction,
        np.random.default_rng(STATE_SEED),
        MAX_EFFECT_UNKNOWNS,
        units.factor("min") * _budget_min(table, study.location.key("plan")),
    )


def _reserved_seconds(study: Study, available: float) -> float:
    """Time (s) that [gap.design] takes from the plan's `available` minutes."""
    design = None if study.gap is None else study.gap.design
    if design is None or design.keep != PLAN or design.budget_min is None:
        return 0.0
    if design.budget_min >= available:
        location = study.location.path("gap", "design", "budget_min")
        problem = (
            f"the plan has {available:g} min in all, so no time remains for accuracy"
        )
        raise location.error(problem, "give less, or [plan] more", design.budget_min)
    return units.factor("min") * design.budget_min


def _budget_min(table: PlanTable, location: Location) -> float:
    """The time that the plan may take, min. Raises InputError where none is stated."""
    if table.budget_min is None:
        raise location.key("budget_min").error(
            "missing", "state the time that is available: budget_min = 120.0"
        )
    return table.budget_min


def _check_names(table: PlanTable, location: Location, setups: Sequence[str]) -> None:
    """Check names of measurements and set-ups: known, and each used once."""
    names: set[str] = set()
    owners: dict[str, str] = {}
    for i, measured in enumerate(table.measurement):
        entry = location.path("measurement", i)
        if measured.name in names:
            raise entry.key("name").error(
                "used twice", "give each measurement its own name", measured.name
            )
        names.add(measured.name)
        field = entry.key("setups" if measured.setup is None else "setup")
        if (measured.setup is None) == (not measured.setups):
            raise field.error(
                "a measurement needs set-ups to mount",
                'write setup = "NAME", or setups = ["A", "B"]',
            )
        for name in measured.mounted:
            known_name(name, setups, field)
            if name in owners:
                problem = (
                    f"{owners[name]} mounts it as well; a set-up that is mounted again"
                    " stands elsewhere"
                )
                raise field.error(
                    problem, "give each measurement a [[setup]] of its own", name
                )
            owners[name] = measured.name


def _check_sequences(table: PlanTable, location: Location) -> None:
    """Check the sequences to compare: known measurements, each named once."""
    names = [measured.name for measured in table.measurement]
    for i, sequence in enumerate(table.compare):
        entry = location.path("compare", i)
        for j, name in enumerate(sequence):
            known_name(name, names, entry.item(j), "measurement")
        if len(set(sequence)) < len(sequence):
            raise entry.error(
                "a measurement is named twice", "name each once", sequence
            )


def _option(
    table: MeasuredTable,
    measurement_with: MeasurementWith,
    location: Location,
    nuisances: Nuisances | None,
) -> Option:
    """A measurement to plan with, whose numbers are the first that nuisances change."""
    measurement = measurement_with(table.mounted)
    series = [_grid(table, name, measurement, location) for name in table.mounted]
    mounting = table.setup_min
    travel = table.travel_mm
    if nuisances is not None:
        setups = measurement.setups
        numbers = sum(len(s) * len(setups[s.setup].sigma) for s in series)
        nuisances = nuisances.take(slice(numbers))
    try:
        option = planning.build_option(
            measurement.machine,
            [measurement.setups[n] for n in table.mounted],
            series,
            name=table.name,
            counts=table.counts,
            travel=math.inf if travel is None else units.factor("mm") * travel,
            whole_runs=table.whole_runs,
            mounting_seconds=(
                None if mounting is None else units.factor("min") * mounting
            ),
            price=table.price,
            operator=table.operator,
            nuisances=nuisances,
        )
    except ValueError as error:
        raise location.error(str(error), "change counts, or the grid") from error
    if table.reading_s is None:
        return option
    mounted, candidates = option.measurement, option.candidates
    each = []
    for setup in candidates.setups:
        usual = mounted.setups[setup].instrument.cost.reading
        each.append(table.reading_s * mounted.reading_seconds(setup) / usual)
    seconds: Array = np.array(each)[candidates.setup] * candidates.members[:, 1]
    return dataclasses.replace(option, candidate_seconds=seconds)


def _grid(
    table: MeasuredTable, setup: str, measurement: Measurement, location: Location
) -> Series:
    grid = GridTable(
        setup=setup,
        runs_by=table.runs_by,
        pairs_mm=table.pairs_mm,
        coordinates=table.coordinates,
    )
    series = grids.grid_series(grid, measurement, location, strict=False)[0]
    if not table.whole_runs:
        return series
    # the readings of a run must follow each other, whichever coordinate varies slowest
    positions = {run: k for k, run in enumerate(dict.fromkeys(series.run))}
    order = np.argsort([positions[run] for run in series.run], kind="stable")
    return series.take(order)
