"""Reports the tables with which a controller corrects effects: `corrected.tables`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from oed.base import units
from oed.base.arrays import Array
from oed.compensate.command_grid import CommandGrid, GridAxis
from oed.compensate.effects.fit import CorrectedEstimate
from oed.compensate.effects.tables import (
    PAYLOAD,
    TEMPERATURE,
    StateTable,
    TabledEffects,
    tabled_effects,
)
from oed.model.machine import Machine
from oed.result import EffectTable, PredictionSection
from pkm_studies.compensation import TableAccuracy, command_grid, table_accuracy
from pkm_studies.quantities import column, display_unit
from pkm_studies.stages import describe

#: largest number of commands of the effects' tables
COMMANDS = 1000


def effect_tables(
    corrected: CorrectedEstimate,
    command: Array,
    axes: tuple[GridAxis, ...],
    prediction: PredictionSection | None,
) -> tuple[list[EffectTable], Mapping[str, str]]:
    """Tables in display units over a box of commands, and why an effect has none.

    command     (n, n_dof) of the workspace, SI, where the box is out of reach
    prediction  the accuracy with the effects compensated
    """
    if not len(command):
        return [], {}
    tabled = tabled_effects(corrected, command)
    if not tabled.tables:
        return [], tabled.missing
    readings = corrected.readings
    kinematics = readings.measurement.kinematics
    want = table_accuracy(kinematics, prediction)

    def correction(places: Array) -> Array:
        return _stacked(tabled, tabled_effects(corrected, places))

    grid = command_grid(axes, correction, want, COMMANDS)
    costs: list[dict[str, float]] = [{} for _ in tabled.tables]
    if grid is not None:
        tabled = tabled_effects(corrected, grid.commands)
        command = grid.commands
        costs = list(_costs(tabled, grid, want))
    tables = [
        effect_table(kinematics.machine, table, command, cost)
        for table, cost in zip(tabled.tables, costs, strict=True)
    ]
    return tables, tabled.missing


def _stacked(first: TabledEffects, tabled: TabledEffects) -> Array:
    """Corrections (n, s, nq) in all states of the tables `first`, one after the other."""
    of = {(t.effect, t.axis): t.joints for t in tabled.tables}
    count = next(iter(of.values())).shape[1]
    states = []
    for table in first.tables:
        nothing = np.zeros((len(table.values), count, table.joints.shape[2]))
        states.append(of.get((table.effect, table.axis), nothing))
    return np.swapaxes(np.concatenate(states), 0, 1)


def _costs(
    tabled: TabledEffects, grid: CommandGrid, want: TableAccuracy
) -> Iterator[dict[str, float]]:
    """{component: rms error} by interpolation of each table, in its worst state."""
    ends = np.cumsum([len(table.values) for table in tabled.tables])
    for errors in np.split(grid.errors, ends[:-1]):
        worst = errors.max(axis=0)
        yield {
            name: units.number(float(size), units.FINE[unit])
            for name, unit, size in zip(want.names, want.units, worst, strict=True)
        }


def effect_table(
    machine: Machine,
    table: StateTable,
    command: Array,
    interpolation: Mapping[str, float],
) -> EffectTable:
    """A table in display units, at commands (n, n_dof), SI."""
    state = table.axis
    if state == PAYLOAD:
        state = f"{state}_N"
    if state.startswith(TEMPERATURE):
        state = f"{state}_C"
    names = [column(joint.name, joint.unit) for joint in machine.joints]
    factors = [units.factor(display_unit(joint.unit)) for joint in machine.joints]
    return EffectTable(
        effect=table.effect,
        state=state,
        joint_wise=table.joint_wise,
        values=table.values.tolist(),
        joints=names,
        commands=[describe.displayed_command(machine, c) for c in command],
        table=(table.joints / factors).tolist(),
        interpolation=dict(interpolation),
    )
