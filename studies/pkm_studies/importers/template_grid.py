"""Grids of candidates of a new study, as an instrument leaves coordinates free."""

from __future__ import annotations

import math

import numpy as np

from oed.base.arrays import Array
from oed.measurement.fixed_reading import commands_at_fixed_reading
from oed.measurement.measurement import Measurement
from oed.mechanism.kinematics import AssemblyError, Kinematics
from oed.model.instrument import Instrument, mount
from oed.model.machine import Machine
from pkm_studies.importers.axis_lines import (
    axis,
    count_of_values,
    format_number,
    span_of_values,
    turns_round,
)
from pkm_studies.resolve.quantities import column

#: least share of the grid's poses to which an instrument leads a "hold" coordinate
LED_SHARE = 0.3
SETUP = "setup1"


def grid_lines(machine: Machine, instrument: Instrument, share: float) -> list[str]:
    hold = _led_coordinate(machine, instrument, share)
    fixed = [
        c.name for c in machine.command if instrument.fixed_point and c.name in "xyz"
    ]
    free = len(machine.command) - len(fixed) - (hold is not None)
    lines = []
    for c in machine.command:
        if c.name in fixed:
            key = column(c.name, c.unit)
            value = format_number(machine.home[c.name], c.unit)
            lines.append(f"{key} = [{value}]  # the place of the tool point")
        elif c.name == hold:
            lines.append(f'{c.name} = "hold"  # led by the instrument')
        else:
            lines.append(axis(c, machine, share, free))
    return lines


def _led_coordinate(
    machine: Machine, instrument: Instrument, share: float
) -> str | None:
    """The coordinate by which the instrument leads the tool at most poses, if any."""
    if instrument.fixed_reading is None:
        return None
    axes = []
    for c in machine.command:
        whole_turn = (0.0, 2.0 * math.pi)
        low, high = (
            whole_turn if turns_round(c, share) else span_of_values(c, machine, share)
        )
        axes.append(np.linspace(low, high, count_of_values(machine)))
    mesh = np.meshgrid(*axes, indexing="ij")
    command = np.column_stack([m.ravel() for m in mesh])
    kinematics = Kinematics(machine)
    shares = {
        c.name: _led_share(kinematics, instrument, command, c.name)
        for c in machine.command
    }
    best = max(shares, key=lambda name: shares[name])
    return best if shares[best] >= LED_SHARE else None


def _led_share(
    kinematics: Kinematics, instrument: Instrument, command: Array, coordinate: str
) -> float:
    """Share of the commands at which some value of a coordinate keeps the reading."""
    machine = kinematics.machine
    settings = {s.name: s.default or 0.0 for s in instrument.settings}
    teach = machine.home_command if instrument.reference == "teach" else None
    setup = mount(instrument, SETUP, teach=teach, **settings)  # type: ignore[arg-type]
    try:
        measurement = Measurement(machine, [setup], kinematics)
        _, solvable = commands_at_fixed_reading(measurement, SETUP, command, coordinate)
    except (AssemblyError, ValueError):
        return 0.0
    return float(solvable.mean())
