"""Grids of candidates of a new study, in numbers that a user would write."""

from __future__ import annotations

import math
import re

import numpy as np

from oed.base import units
from oed.base.arrays import Array
from oed.measurement.fixed_reading import commands_at_fixed_reading
from oed.measurement.measurement import Measurement
from oed.mechanism.kinematics import AssemblyError, Kinematics
from oed.model.instrument import Instrument, mount
from oed.model.machine import Coordinate, Machine
from pkm_studies.resolve.quantities import column, display_unit

#: most poses of the grid; its values a coordinate, and with too many poses
POSES, VALUES, FEWER_VALUES = 1000, 5, 3
#: values where an instrument leaves two coordinates free: enough readings to choose from
MORE_VALUES = 8
#: values of an angle that goes all the way round
TURN_VALUES = 12
#: shares of the workspace that the grid spans: the first whose poses can be measured
SHARES = (0.6, 0.4, 0.25, 0.15, 0.08, 0.04)
#: half a range of a coordinate without end, m or rad
HALF_RANGE = 0.1
#: least share of the grid's poses to which an instrument leads a "hold" coordinate
LED_SHARE = 0.3
SETUP = "setup1"
#: SI numbers of a geometry below this are rounding errors
ROUNDING = 1e-12


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


def axis(c: Coordinate, machine: Machine, share: float, free: int | None = None) -> str:
    """A coordinate's values; `free`, how many coordinates an instrument leaves free."""
    key = column(c.name, c.unit)
    if _turns(c, share):
        count = TURN_VALUES
        return (
            f"{key} = {{ from = 0.0, to = 360.0, count = {count}, endpoint = false }}"
        )
    low, high = (format_number(end, c.unit) for end in _span(c, machine, share))
    return f"{key} = {{ from = {low}, to = {high}, count = {_count(machine, free)} }}"


def _count(machine: Machine, free: int | None = None) -> int:
    """Values of each coordinate: five, or fewer where six would make 15625 poses.

    More where an instrument leaves at most two free.
    """
    every = len(machine.command)
    free = every if free is None else free
    if free < every and free <= 2:
        return MORE_VALUES if free == 2 else MORE_VALUES**2 // 2
    few = VALUES**free > POSES
    return FEWER_VALUES if few else VALUES


def _turns(c: Coordinate, share: float) -> bool:
    """Whether an angle goes all the way round: not in a part of the workspace.

    Where its range has no end, only a cautious try goes round.
    """
    full_turn = 2.0 * math.pi - 1e-9
    whole = c.unit == "rad" and c.lower <= 0.0 and c.upper >= full_turn
    has_ends = math.isfinite(c.lower) and math.isfinite(c.upper)
    return whole and (share == SHARES[0] or has_ends)


def _span(c: Coordinate, machine: Machine, share: float) -> tuple[float, float]:
    """The middle of a coordinate's range; a smaller part of it lies about home.

    So does that of a coordinate without end.
    """
    home = machine.home[c.name]
    low = c.lower if np.isfinite(c.lower) else home - HALF_RANGE
    high = c.upper if np.isfinite(c.upper) else home + HALF_RANGE
    centre, half = (low + high) / 2.0, (high - low) / 2.0
    if share == SHARES[0]:
        return centre - share * half, centre + share * half
    return max(home - share * half, low), min(home + share * half, high)


def _led_coordinate(
    machine: Machine, instrument: Instrument, share: float
) -> str | None:
    """The coordinate by which the instrument leads the tool at most poses, if any."""
    if instrument.fixed_reading is None:
        return None
    axes = []
    for c in machine.command:
        whole_turn = (0.0, 2.0 * math.pi)
        low, high = whole_turn if _turns(c, share) else _span(c, machine, share)
        axes.append(np.linspace(low, high, _count(machine)))
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


# -- numbers ---------------------------------------------------------------------------


def format_pose(coordinates: tuple[Coordinate, ...], values: Array) -> str:
    fields = [
        f"{column(c.name, c.unit)} = {format_number(value, c.unit)}"
        for c, value in zip(coordinates, values, strict=True)
    ]
    return "{ " + ", ".join(fields) + " }"


def format_number(value: float, si: str) -> str:
    """An SI value as TOML, in the unit of its column."""
    return in_unit(value, display_unit(si))


def format_numbers(value: object, si: str) -> str:
    """An SI number, or nested lists of them, as TOML."""
    if isinstance(value, list | tuple | np.ndarray):
        return f"[{', '.join(format_numbers(item, si) for item in value)}]"
    number = float(value)  # type: ignore[arg-type]
    return format_number(number if abs(number) > ROUNDING else 0.0, si)


def in_unit(value: float, unit: str) -> str:
    number = f"{float(units.from_si(value, unit)):.9g}"
    return number if re.search(r"[.e]", number) else f"{number}.0"
