"""Orders a plan: set-ups by what has to be changed, readings by short joint travel.

Readings of a labelled run stay together. Runs whose order means something are kept as
they are: those read against their first pose, in passes, or chosen as a whole.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed import units
from oed.base import Index
from oed.measurement import Measurement, Series
from oed.poses import ChangeTimes, ReadingOrder
from oed.result import WorkingOrder
from pkm_studies.base import Location
from pkm_studies.resolve import ResolvedStudy, reference_command
from pkm_studies.tables import DesignTable, OrderTable


@dataclasses.dataclass(frozen=True)
class OrderedPlan:
    """Readings in working order; `scheduled` has thermal references in between."""

    series: tuple[Series, ...]
    scheduled: tuple[Series, ...]
    summary: WorkingOrder


def order_plan(
    table: DesignTable,
    location: Location,
    measurement: Measurement,
    retained: Sequence[Series],
    series: Sequence[Series],
    rng: np.random.Generator,
) -> OrderedPlan:
    """Readings of a plan in working order; retained ones come first in their set-up.

    table   the order that it asks for
    location  of the table, for errors

    Raises InputError where the thermal reference cannot be read in time.
    """
    location = location.key("order")
    mounted = list(dict.fromkeys(s.setup for s in retained))
    names = list(dict.fromkeys(s.setup for s in series))
    changes = ChangeTimes(
        60.0 * table.order.change_tool_min,
        60.0 * table.order.change_place_min,
        60.0 * table.order.change_settings_min,
    )
    names, mounting = changes.order_mounting(
        [measurement.setups[n] for n in names], rng
    )
    labelled = [_added_readings(s) if s.setup in mounted else s for s in series]
    orders: dict[str, ReadingOrder] = {}
    scheduled: dict[str, Series] = {}
    ends = []
    for name in names:
        whole = _joined(measurement, name, [s for s in labelled if s.setup == name])
        orders[name] = _order_readings(measurement, whole, table, rng)
        scheduled[name], end = _add_references(orders[name], table.order, location)
        ends.append(end)
    setups = [n for n in mounted if n not in names] + names
    ordered = {name: o.ordered for name, o in orders.items()}
    summary = WorkingOrder(
        setups=setups,
        before_s=sum(o.as_given for o in orders.values()),
        after_s=sum(o.path.length for o in orders.values()),
        exact=all(o.path.exact for o in orders.values()),
        references=sum(len(scheduled[n]) - len(ordered[n]) for n in names),
        minutes=(mounting + sum(ends)) / 60.0,
    )
    return OrderedPlan(
        series=_joined_plan(setups, retained, ordered),
        scheduled=_joined_plan(setups, retained, scheduled),
        summary=summary,
    )


def check_reference(resolved: ResolvedStudy) -> None:
    """Raises InputError for thermal reference readings that no set-up can take."""
    table = resolved.study.design
    if table is None or table.order.reference_every_min is None:
        return
    location = resolved.study.location.path("design", "order")
    for name in dict.fromkeys(s.setup for s in resolved.candidates):
        every = table.order.reference_every_min
        reference_command(resolved.measurement, name, table.order, every, location)


def _joined_plan(
    setups: Sequence[str], retained: Sequence[Series], new: Mapping[str, Series]
) -> tuple[Series, ...]:
    plan: list[Series] = []
    for name in setups:
        plan += [s for s in retained if s.setup == name]
        plan += [new[name]] if name in new else []
    return tuple(plan)


def _added_readings(series: Series) -> Series:
    """New readings in a set-up with retained ones: the names of their runs say so."""
    labels = ["added" if run == "1" else f"added {run}" for run in series.run]
    return dataclasses.replace(series, run=np.array(labels, dtype=np.str_))


def _order_readings(
    measurement: Measurement,
    series: Series,
    table: DesignTable,
    rng: np.random.Generator,
) -> ReadingOrder:
    """The readings of one set-up by short joint travel."""
    setup = measurement.setups[series.setup]
    linear = float(units.to_si(table.order.speed_mm_s, "mm"))
    angular = float(units.to_si(table.order.speed_deg_s, "deg"))
    joints = measurement.machine.joints
    passes = not setup.protocol.average and len(setup.protocol.pass_names) > 1
    relative = setup.instrument.reference == "run"
    return ReadingOrder.of_readings(
        measurement,
        series,
        [linear if joint.unit == "m" else angular for joint in joints],
        rng,
        from_home=table.order.start == "home",
        keeps_runs=table.whole_runs or relative or passes,
    )


def _joined(measurement: Measurement, setup: str, parts: list[Series]) -> Series:
    """Series of one set-up as one; runs of one name with references get a number."""
    if len(parts) == 1:
        return parts[0]
    if measurement.setups[setup].instrument.reference != "run":
        labels = [str(run) for s in parts for run in s.run]
        commands = np.vstack([s.reading_commands() for s in parts])
        return measurement.series(setup, commands, labels)
    runs: list[str] = []
    index: list[Index] = []
    poses = 0
    for s in parts:
        clash = set(runs) & set(s.run)
        number = len(index) + 1
        runs += [f"{run} ({number})" if clash else str(run) for run in s.run]
        index.append(s.index + poses)
        poses += len(s.q)
    return Series(
        setup=setup,
        q=np.vstack([s.q for s in parts]),
        start=np.vstack([s.start for s in parts]),
        command=np.vstack([s.command for s in parts]),
        index=np.vstack(index),
        run=np.array(runs, dtype=np.str_),
    )


# -- thermal reference readings --------------------------------------------------------
def _add_references(
    order: ReadingOrder, table: OrderTable, location: Location
) -> tuple[Series, float]:
    """The readings with reference readings in between, if any; when the last ends, s.

    Raises InputError where the set-up has a reference of its own, or time is too short.
    """
    every = table.reference_every_min
    if every is None:
        return order.ordered, order.seconds
    setup = order.series.setup
    command = reference_command(order.measurement, setup, table, every, location)
    try:
        return order.add_references(command, 60.0 * every)
    except ValueError as error:
        field_location = location.key("reference_every_min")
        raise field_location.error(str(error), "raise it") from error
