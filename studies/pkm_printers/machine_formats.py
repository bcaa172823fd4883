"""One name for the formats of a firmware's machines: the identified one decides."""

import dataclasses
from collections.abc import Mapping

from oed.base import Array
from oed.model import Machine
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts


def choose_by_machine(
    usual: ControllerFormat, others: Mapping[str, ControllerFormat]
) -> ControllerFormat:
    """The usual format, with others for machines of these names."""

    def chosen(machine: Machine) -> ControllerFormat:
        return others.get(machine.name, usual)

    def joints(texts: Texts, compensation: Compensation) -> Array:
        formula = chosen(compensation.machine).joints
        assert formula is not None  # formats of firmwares all decide the joints
        return formula(texts, compensation)

    return dataclasses.replace(
        usual,
        write=lambda compensation: chosen(compensation.machine).write(compensation),
        joints=joints,
        unfit=lambda machine: chosen(machine).unfit(machine),
        notes=lambda compensation: chosen(compensation.machine).notes(compensation),
    )
