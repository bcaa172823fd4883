"""The working order of a plan: set-ups by what must be changed, readings by a short way
of the joints, references.

Readings of a labelled run stay together. Runs whose order means something (told against
their first pose, in passes, or chosen as a whole) are kept as they are; in others the
readings are ordered too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed import result, units
from oed.arrays import Array, Index
from oed.design import candidates, move_times, order, schedule
from oed.measurement import Measurement, Series
from pkm_studies.errors import Place
from pkm_studies.resolve import grids
from pkm_studies.resolve.resolved import ResolvedStudy
from pkm_studies.study.tables import Axis, DesignTable, OrderTable

#: run label of thermal reference readings
REFERENCE = "reference"
#: random changes tried of a way, times its readings: long ways take longer to change
KICKS, EFFORT = 200, 20_000


@dataclasses.dataclass(frozen=True)
class Arranged:
    """Readings in working order; `scheduled` with the thermal references between them,
    for the machine's operator.
    """

    series: tuple[Series, ...]
    scheduled: tuple[Series, ...]
    told: result.WorkingOrder


@dataclasses.dataclass(frozen=True)
class _Way:
    """One set-up's readings in order; seconds of travel before and after, and until the
    last reading ends.
    """

    series: Series
    scheduled: Series
    before: float
    after: float
    seconds: float
    exact: bool


def arrange(
    resolved: ResolvedStudy,
    measurement: Measurement,
    kept: Sequence[Series],
    series: Sequence[Series],
    rng: np.random.Generator,
) -> Arranged:
    """Readings of a plan in working order; those kept come first in their set-up, as
    they are.
    """
    design = resolved.study.design
    assert design is not None
    place = resolved.study.place.key("design").key("order")
    mounted = list(dict.fromkeys(s.setup for s in kept))
    names, mounting = _setups(
        measurement, list(dict.fromkeys(s.setup for s in series)), design.order, rng
    )
    new = [_added(s) if s.setup in mounted else s for s in series]
    ways = {
        n: _way(measurement, n, [s for s in new if s.setup == n], design, rng, place)
        for n in names
    }
    everything = [n for n in mounted if n not in names] + names
    told = result.WorkingOrder(
        setups=everything,
        before_s=sum(w.before for w in ways.values()),
        after_s=sum(w.after for w in ways.values()),
        exact=all(w.exact for w in ways.values()),
        references=sum(len(w.scheduled) - len(w.series) for w in ways.values()),
        minutes=(mounting + sum(w.seconds for w in ways.values())) / 60.0,
    )

    def all_with(parts: Mapping[str, Series]) -> tuple[Series, ...]:
        table = {
            n: [*(s for s in kept if s.setup == n), *([parts[n]] if n in parts else [])]
            for n in everything
        }
        return tuple(s for n in everything for s in table[n])

    ordered = all_with({n: w.series for n, w in ways.items()})
    return Arranged(ordered, all_with({n: w.scheduled for n, w in ways.items()}), told)


def _added(series: Series) -> Series:
    """New readings in a set-up that has kept ones: their runs say so."""
    labels = ["added" if r == "1" else f"added {r}" for r in series.run]
    return dataclasses.replace(series, run=np.array(labels, dtype=np.str_))


def _setups(
    measurement: Measurement,
    names: list[str],
    said: OrderTable,
    rng: np.random.Generator,
) -> tuple[list[str], float]:
    """Set-ups in the order of least re-mounting, and the time for that, s."""
    changes = move_times.ChangeTimes(
        60.0 * said.change_tool_min,
        60.0 * said.change_place_min,
        60.0 * said.change_settings_min,
    )
    costs, first = move_times.remounting(
        [measurement.setups[n] for n in names], changes
    )
    path = order.order_setups(costs, rng, first)
    return [names[k] for k in path.indices], path.length


def _way(
    measurement: Measurement,
    setup: str,
    parts: list[Series],
    design: DesignTable,
    rng: np.random.Generator,
    place: Place,
) -> _Way:
    whole, said = _joined(measurement, setup, parts), design.order
    speeds = [
        float(
            units.to_si(said.speed_mm_s, "mm")
            if j.unit == "m"
            else units.to_si(said.speed_deg_s, "deg")
        )
        for j in measurement.machine.joints
    ]
    distance = move_times.travel_between(measurement, whole, speeds)
    start = (
        move_times.travel_from(measurement, whole, speeds)
        if said.start == "home"
        else None
    )
    chosen = measurement.setups[setup]
    kept = design.whole_runs or chosen.instrument.reference == "run"
    kept |= not chosen.protocol.average and len(chosen.protocol.passes) > 1
    runs = _runs(whole, distance, kept, rng)
    path = order.order_poses(
        distance,
        rng,
        start,
        runs=runs,
        reversible=not kept,
        kicks=min(KICKS, EFFORT // len(whole)),
    )
    taken = whole.take(path.indices)
    reading = candidates.reading_time(measurement, setup)
    before = float(distance[np.arange(len(whole) - 1), np.arange(1, len(whole))].sum())
    before += 0.0 if start is None else float(start[0])
    after, seconds, scheduled = path.length, path.length + reading * len(whole), taken
    if said.reference_every_min is not None:
        scheduled, seconds = _referenced(
            measurement, whole, path, speeds, reading, said, place
        )
    return _Way(taken, scheduled, before, after, seconds, path.exact)


def _runs(
    series: Series, distance: Array, kept: bool, rng: np.random.Generator
) -> list[list[int]] | None:
    """Readings that stay together, each run in an order of its own; None where each
    reading stands for itself.
    """
    labels = list(dict.fromkeys(series.run))
    if len(labels) == 1 and not kept:
        return None
    runs = []
    for label in labels:
        members = np.flatnonzero(series.run == label)
        if not kept:
            members = members[
                order.order_poses(
                    distance[np.ix_(members, members)],
                    rng,
                    kicks=min(KICKS, EFFORT // len(members)),
                ).indices
            ]
        runs.append([int(k) for k in members])
    return runs


def _joined(measurement: Measurement, setup: str, parts: list[Series]) -> Series:
    """Series of one set-up as one; runs of one name that carry a reference of their own
    get a number.
    """
    if len(parts) == 1:
        return parts[0]
    if measurement.setups[setup].instrument.reference != "run":
        labels = [str(r) for s in parts for r in s.run]
        return measurement.series(
            setup, np.vstack([s.commands() for s in parts]), labels
        )
    runs: list[str] = []
    index: list[Index] = []
    poses = 0
    for s in parts:
        clash = set(runs) & set(s.run)
        runs += [f"{r} ({len(index) + 1})" if clash else str(r) for r in s.run]
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


# -- thermal reference -----------------------------------------------------------------


def _referenced(
    measurement: Measurement,
    whole: Series,
    path: order.Route,
    speeds: Sequence[float],
    reading: float,
    said: OrderTable,
    place: Place,
) -> tuple[Series, float]:
    """The readings in time with those of the reference between, and when the last one
    ends, s.
    """
    assert said.reference_every_min is not None
    if measurement.setups[whole.setup].instrument.reference == "run":
        problem = (
            f"{whole.setup} tells its readings against the first pose of each run: that"
            " is its reference"
        )
        raise place.key("reference_every_min").error(
            problem, "remove it", said.reference_every_min
        )
    command = _command(measurement, whole, path, said.reference, place.key("reference"))
    there = measurement.series(whole.setup, command[None])
    ways = move_times.travel_times(there.q[:1], whole.q[whole.index[:, 0]], speeds)[0]
    home = (
        move_times.travel_from(measurement, there, speeds)[0]
        if said.start == "home"
        else 0.0
    )
    every = 60.0 * said.reference_every_min
    try:
        made = schedule.interleave(
            path, reading, every, ways, ways, reading, float(home)
        )
    except ValueError as error:
        raise place.key("reference_every_min").error(str(error), "raise it") from error
    commands = np.array([command if k < 0 else whole.commands()[k] for k in made.pose])
    labels = [REFERENCE if k < 0 else str(whole.run[k]) for k in made.pose]
    return measurement.series(whole.setup, commands, labels), made.seconds


def _command(
    measurement: Measurement,
    whole: Series,
    path: order.Route,
    axes: Mapping[str, Axis],
    place: Place,
) -> Array:
    """The reference's command (n_dof,): what the study says, or the first pose of the
    way.
    """
    if not axes:
        return np.asarray(whole.commands()[path.indices[0]])
    command, hold, keys = grids.grid_commands(axes, measurement.machine, place)
    if len(command) != 1:
        raise place.error(
            "the reference is one pose", "give one value for each coordinate"
        )
    if hold is not None:
        command[:, [c.name for c in measurement.machine.command].index(hold)] = np.nan
        limits = {
            c.name: c
            for c in measurement.machine.workspace(measurement.setups[whole.setup].tool)
        }[hold]
        command = np.nan_to_num(command, nan=(limits.lower + limits.upper) / 2.0)
    grids.check_workspace(
        measurement.machine, command, keys, place, measurement.setups[whole.setup].tool
    )
    command, _ = grids.solve_held(
        measurement, whole.setup, command, hold, place, strict=True
    )
    return np.asarray(command[0])
