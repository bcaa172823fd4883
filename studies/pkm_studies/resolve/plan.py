"""What [plan] says, as objects: a catalogue of measurements to order, the accuracy
wanted, sequences to compare; SI.

Raises InputError, naming file and field, for everything that does not fit the machine
or the instruments.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from oed.arrays import Array
from oed.design.candidates import reading_time
from oed.measurement import Measurement, Series
from oed.planning.option import Option, option
from pkm_studies.errors import Place
from pkm_studies.resolve import grids, lookup, quantities
from pkm_studies.study import Study
from pkm_studies.study.tables import GridTable, MeasuredTable
from pkm_studies.study.tables.gap_design import PLAN

Measure = Callable[[Iterable[str]], Measurement]


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlanAsked:
    """What [plan] asks for.

    options  the measurements, in the study's order;  wanted {component: accuracy}, SI
    budget   time for accuracy, s;  reserved: time for the cause of what is left, s
    compare  sequences of names of measurements
    """

    options: tuple[Option, ...]
    wanted: Mapping[str, float]
    budget: float
    compare: tuple[tuple[str, ...], ...]
    reserved: float = 0.0

    def named(self, name: str) -> Option:
        """A measurement by its name."""
        return next(o for o in self.options if o.name == name)


def planned(
    study: Study, measure: Measure, setups: Iterable[str], done: Iterable[str] = ()
) -> PlanAsked | None:
    """What the study's [plan] asks for; None where it lists no measurement.

    `setups`: all names; `done`: those whose readings are taken: measurements with them
    are left out.
    """
    said = study.plan
    if said is None or not said.measurement:
        return None
    place = study.place.key("plan")
    _sound(study, place)
    tables = [
        (t, place.key("measurement").item(i)) for i, t in enumerate(said.measurement)
    ]
    _setups(tables, list(setups))
    left = [(t, p) for t, p in tables if not set(t.mounted) & set(done)]
    known = {c.name: c.unit for c in measure(()).machine.components}
    names = [t.name for t, _ in tables]
    for i, sequence in enumerate(said.compare):
        for j, name in enumerate(sequence):
            lookup.known_name(
                name, names, place.key("compare").item(i).item(j), "measurement"
            )
        if len(set(sequence)) < len(sequence):
            raise (
                place.key("compare")
                .item(i)
                .error("a measurement is named twice", "name each once", sequence)
            )
    there, reserved = {t.name for t, _ in left}, _reserved(study)
    return PlanAsked(
        options=tuple(_option(t, measure, p) for t, p in left),
        wanted=quantities.read_values(said.wanted, known, place.key("wanted")),
        budget=60.0 * (said.budget_min or 0.0) - reserved,
        reserved=reserved,
        compare=tuple(tuple(s) for s in said.compare if set(s) <= there),
    )


def _reserved(study: Study) -> float:
    """Time, s, that [gap.design] takes from the plan's to find the cause of what the
    plan leaves.
    """
    design = None if study.gap is None else study.gap.design
    if design is None or design.keep != PLAN or design.budget_min is None:
        return 0.0
    assert study.plan is not None
    assert study.plan.budget_min is not None
    if design.budget_min >= study.plan.budget_min:
        place = study.place.key("gap").key("design").key("budget_min")
        problem = (
            f"the plan has {study.plan.budget_min:g} min in all, and none is left for"
            " accuracy"
        )
        raise place.error(problem, "give less, or [plan] more", design.budget_min)
    return 60.0 * design.budget_min


def _sound(study: Study, place: Place) -> None:
    """Fields that measurements need."""
    assert study.plan is not None
    if study.plan.budget_min is None:
        raise place.key("budget_min").error(
            "missing", "say how much time there is: budget_min = 120.0"
        )
    if study.prediction is None:
        problem = (
            "measurements are planned for accuracy over a workspace, and the study"
            " tells none"
        )
        raise place.key("measurement").error(
            problem, "add a [prediction] table: reference and coordinates"
        )


def _setups(tables: list[tuple[MeasuredTable, Place]], setups: list[str]) -> None:
    """Names of measurements and their set-ups: known, and each used once."""
    names: list[str] = []
    owner: dict[str, str] = {}
    for table, place in tables:
        if table.name in names:
            raise place.key("name").error(
                "used twice", "give each measurement its own name", table.name
            )
        names.append(table.name)
        field = place.key("setups" if table.setup is None else "setup")
        if (table.setup is None) == (not table.setups):
            raise field.error(
                "a measurement needs set-ups to mount",
                'write setup = "NAME", or setups = ["A", "B"]',
            )
        for name in table.mounted:
            lookup.known_name(name, setups, field)
            if name in owner:
                problem = (
                    f"{owner[name]} mounts it as well; what is mounted again stands"
                    " elsewhere"
                )
                raise field.error(
                    problem, "give each measurement a [[setup]] of its own", name
                )
            owner[name] = table.name


def _option(table: MeasuredTable, measure: Measure, place: Place) -> Option:
    measurement = measure(table.mounted)
    series = [_grid(table, name, measurement, place) for name in table.mounted]
    try:
        made = option(
            measurement.machine,
            [measurement.setups[n] for n in table.mounted],
            series,
            name=table.name,
            counts=table.counts,
            travel=None if table.travel_mm is None else 1e-3 * table.travel_mm,
            whole_runs=table.whole_runs,
            mounting=None if table.setup_min is None else 60.0 * table.setup_min,
            price=table.price,
            operator=table.operator,
        )
    except ValueError as error:
        raise place.error(str(error), "change counts, or the grid") from error
    return (
        made
        if table.reading_s is None
        else dataclasses.replace(made, seconds=_seconds(made, table.reading_s))
    )


def _grid(
    table: MeasuredTable, setup: str, measurement: Measurement, place: Place
) -> Series:
    grid = GridTable(
        setup=setup,
        runs_by=table.runs_by,
        pairs_mm=table.pairs_mm,
        coordinates=table.coordinates,
    )
    made = grids.grid_series(grid, measurement, place, strict=False)[0]
    if not table.whole_runs:
        return made
    # the readings of a run must follow each other, whichever coordinate varies slowest
    labels = {run: k for k, run in enumerate(dict.fromkeys(made.run))}
    return made.take(np.argsort([labels[r] for r in made.run], kind="stable"))


def _seconds(made: Option, reading: float) -> Array:
    """Time (C,) of each candidate where one pass of a reading takes `reading` seconds."""
    found = made.candidates
    usual = [found.measurement.setups[n] for n in found.setups]
    each = np.array(
        [
            reading
            * reading_time(found.measurement, s.name)
            / s.instrument.cost.reading
            for s in usual
        ]
    )
    return np.asarray(each[found.setup] * found.members[:, 1])
