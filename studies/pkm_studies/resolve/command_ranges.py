"""Ranges of commands: their units, and what is outside the workspace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from oed.base import Array
from oed.mechanism import Kinematics
from oed.model import Machine
from pkm_studies.base import Location
from pkm_studies.quantities import format_as


def command_units(machine: Machine) -> dict[str, str]:
    """SI units of the command coordinates, by name."""
    return {c.name: c.unit for c in machine.command}


def check_workspace(
    machine: Machine,
    command: Array,
    keys: Mapping[str, str],
    location: Location,
) -> None:
    """Raises InputError for the first command outside the machine's workspace."""
    for _, name, value, lower, upper in machine.out_of_range(command)[:1]:
        unit, key = command_units(machine)[name], keys.get(name, name)
        stated, low, high = (format_as(v, unit, key) for v in (value, lower, upper))
        raise location.key(key).error(
            f"{stated} is outside the workspace of {machine.name}",
            f"{name} goes from {low} to {high}",
        )


def check_tool_workspace(
    kinematics: Kinematics,
    command: Array,
    keys: Mapping[str, str],
    location: Location,
    tool: Sequence[float],
) -> None:
    """The same of a tool's commands.

    The workspace moves with the tool as it points at home. Where a command is outside
    it, it counts whether the reference tool is outside as well.
    """
    machine = kinematics.machine
    outside = {row for row, *_ in machine.out_of_range(command, tuple(tool))}
    if outside:
        rows = command[sorted(outside)]
        at_reference = kinematics.at_reference_tool(rows, np.array(tool))
        check_workspace(machine, at_reference, keys, location)
