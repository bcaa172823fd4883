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

    def of(machine: Machine) -> ControllerFormat:
        return others.get(machine.name, usual)

    def joints(texts: Texts, compensation: Compensation) -> Array:
        formula = of(compensation.machine).joints
        assert formula is not None  # formats of firmwares all decide the joints
        return formula(texts, compensation)

    return dataclasses.replace(
        usual,
        write=lambda compensation: of(compensation.machine).write(compensation),
        joints=joints,
        unfit=lambda machine: of(machine).unfit(machine),
        notes=lambda compensation: of(compensation.machine).notes(compensation),
    )
