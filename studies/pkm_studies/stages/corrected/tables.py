"""Reports the tables with which a controller corrects effects: `corrected.tables`."""

from __future__ import annotations

from oed import units
from oed.arrays import Array
from oed.correction import StateTable
from oed.correction.tables import PAYLOAD, TEMPERATURE
from oed.machine import Machine
from oed.result import EffectTable
from pkm_studies.resolve.quantities import column, display_unit
from pkm_studies.stages import describe


def effect_table(machine: Machine, table: StateTable, command: Array) -> EffectTable:
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
    )
