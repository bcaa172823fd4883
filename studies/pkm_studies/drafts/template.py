"""The text of a commented study to start from, for a machine with an instrument."""

import dataclasses
import math
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from oed import units
from oed.base import Array
from oed.instrument import Instrument, mount
from oed.measurement import Measurement, commands_at_fixed_reading
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Family, Machine
from pkm_studies.drafts.axis_lines import (
    SHARES,
    axis,
    count_of_values,
    format_number,
    format_numbers,
    format_pose,
    number_text,
    prediction_table,
    span_of_values,
    turns_round,
)
from pkm_studies.quantities import column
from pkm_studies.tables import TO_MEASURE

OPEN = f'"{TO_MEASURE}"'  #: a number that only the user can know, as TOML
DEFAULT_READINGS = 30  #: readings of the design, where the grid has as many
READINGS_PER_UNKNOWN = 1.5  #: of the design, where the unknowns ask for more
#: shares of its usual length at which a bar is sold or made: 300, 150, 100, 50, 25, 10 mm
LENGTH_SHARES = (1.0, 1 / 2, 1 / 3, 1 / 6, 1 / 12, 1 / 30)
GAP = """\
# Real machines have small effects beside their geometry. `oed identify` asks its readings
# about all that the machine can have. About some alone, or none:
# [identify]
# effects = ["backlash", "leg_thermal"]

# What calibration leaves: `oed diagnose` looks for its causes in any readings.
# With [gap], `oed run` does so too, and predicts which causes the readings could find.
# The columns time_s, direction, feed_mm_min and payload_N help to find more.
# [gap]
# effects = ["all"]  # of `oed list effects`, or files of your own
# gravity = [0.0, 0.0, -1.0]  # its direction in the base frame

# [gap.conditions]  # how the virtual machine is read
# start_min = 30.0
# feed_mm_min = 1000.0

# [[gap.acting]]  # an effect of the virtual machine
# effect = "encoder_scale"
"""
#: least share of the grid's poses to which an instrument leads a "hold" coordinate
LED_SHARE = 0.3
FITTING_SHARE = 0.6  #: the same of a bar whose length is to be chosen
SETUP = "setup1"


class Lead(NamedTuple):
    """The coordinate by which an instrument leads the tool at most poses, if any."""

    coordinate: str | None
    share: float  #: of the grid's poses at which it does


def draft_text(
    name: str,
    model: str,
    machine: Machine,
    reference: str,
    instrument: Instrument,
    share: float = SHARES[0],
    table: str = "",
) -> str:
    """The text of a study; `model` and `reference` name its objects.

    share  of the workspace that its poses span
    table  numbers of the machine, where they are not the model's
    """
    instrument, lead = _fitting(machine, instrument, share)
    grid = grid_lines(machine, instrument, share, lead.coordinate)
    blocks = [
        _head(name, machine, instrument),
        _machine(model, machine, table),
        _setup(reference, machine, instrument),
        _noise(instrument),
        _prior(machine),
        _design(machine, instrument, grid, lead),
        _readings(machine),
        prediction_table(machine, share=share),
        _plan(instrument, grid),
        GAP,
        _claims(),
    ]
    return "\n".join(blocks)


def _head(name: str, machine: Machine, instrument: Instrument) -> str:
    machine_about = machine.about or machine.name
    instrument_about = instrument.about or instrument.name
    return f"""\
# {machine_about}, measured with: {instrument_about}.
# Every number has its unit in the name of its field. `oed check` finds errors in this
# file, `oed run` runs it.

schema = 1
name = "{name}"
title = "{machine.name} with {instrument.name}"
question = "Which readings identify the machine best, and how accurate is it afterwards?"
seed = 0
"""


def _machine(model: str, machine: Machine, table: str) -> str:
    if table:
        return f'[machine]\nmodel = "{model}"\n\n{table}'
    p = machine.parameters[0]
    nominal = f"{column(p.name, p.unit)} = {format_number(p.nominal, p.unit)}"
    fixed = ", ".join(f'"{name}"' for name in machine.frame)
    geometry = "" if machine.family is None else _geometry(machine.family)
    return f"""\
[machine]
model = "{model}"
# fixed = [{fixed}]  # not identified: these only choose the base frame
{geometry}
# [machine.nominal]
# {nominal}  # {p.about}: your machine's number in place of the model's
"""


def _geometry(family: Family) -> str:
    """The table of geometry as comments, one entry a line, with the model's numbers."""
    lines = ["# [machine.geometry]  # of your machine, in place of the model's"]
    for d in family.dimensions:
        key = d.name if d.unit == "1" else column(d.name, d.unit)
        if d.default is None:
            lines.append(f"# {key}: {d.about}; derived where it is not given")
            continue
        lines.append(f"# {key} = {format_numbers(d.default, d.unit)}  # {d.about}")
    return "\n" + "\n".join(lines) + "\n"


def _setup(reference: str, machine: Machine, instrument: Instrument) -> str:
    lines = ["[[setup]]", f'name = "{SETUP}"', f'instrument = "{reference}"']
    lines += _channels(machine, instrument)
    lines += ["# tool_mm = [0.0, 0.0, 0.0]  # tool point, from the reference tool's"]
    for s in instrument.settings:
        value = OPEN if s.default is None else format_number(s.default, s.unit)
        lines.append(f"{column(s.name, s.unit)} = {value}  # {s.about}")
    if instrument.reference == "teach":
        pose = format_pose(machine.command, machine.home_command)
        lines.append(f"teach = {pose}  # the pose at which it was taught")
    for n in instrument.nuisances:
        tolerance = f"{column(n.name, n.unit)} = {format_number(n.tolerance, n.unit)}"
        lines.append(f"# tolerance.{tolerance}  # {n.about}")
    return "\n".join(lines) + "\n"


def _channels(machine: Machine, instrument: Instrument) -> list[str]:
    """What is read, of an instrument whose channels are the machine's passive joints."""
    if instrument.adapt is None:
        return []
    names = [c.name for c in instrument.channels]
    every = [c.name for c in instrument.adapt(machine).channels]
    chosen = ", ".join(f'"{name}"' for name in names)
    if instrument.single:
        return [f"channels = [{chosen}]  # one of {', '.join(every)}"]
    return [f"# channels = [{chosen}]  # those that are read"] if names[1:] else []


def _noise(instrument: Instrument) -> str:
    lines = ["[noise]  # standard deviation of one reading"]
    sign = ""
    if instrument.inner:
        lines = [f"# {lines[0]}, in place of what the set-up's numbers give"]
        sign = "# "
    for channel in instrument.channels:
        unit = units.FINE[channel.unit]
        lines.append(
            f"{sign}{channel.name}_{unit} = {number_text(channel.sigma, unit)}"
        )
    if instrument.renewed:
        lines.append(
            "# seating_um = 0.3  # of a cup that each run seats anew, if known"
        )
    return "\n".join(lines) + "\n"


def _prior(machine: Machine) -> str:
    p = machine.parameters[0]
    sigma = f"{column('sigma', p.unit)} = {format_number(p.tolerance, p.unit)}"
    return f"""\
# Tolerances from drawing or assembly, where they differ from the model's:
# [[prior.tolerance]]
# parameters = ["{p.name}"]  # names or patterns, as in "{p.name[:1]}*"
# {sigma}
"""


def _design(
    machine: Machine, instrument: Instrument, grid: Sequence[str], lead: Lead
) -> str:
    candidates = grid_size("\n".join(grid))
    if lead.coordinate is not None:
        candidates = int(lead.share * candidates)
    fixed = sum(p.name in machine.frame for p in machine.parameters)
    unknowns = len(machine.parameters) - fixed + len(instrument.nuisances)
    wanted = READINGS_PER_UNKNOWN * unknowns / len(instrument.channels)
    # fewer than there are candidates
    readings = min(DEFAULT_READINGS, candidates // 2)
    readings = max(readings, min(math.ceil(wanted), candidates - 1))
    lines = [
        "[design]",
        'criterion = "D"  # or Ds, A, c, I, G, E, kappa, O1 to O5: `oed schema study`',
        f"readings = {readings}",
        'scaling = "length"',
        "",
        "[[design.candidates]]",
        f'setup = "{SETUP}"',
        *grid,
    ]
    return "\n".join(lines) + "\n"


def _readings(machine: Machine) -> str:
    return f"""\
[readings]
simulate = true  # or: files = ["{machine.name}.readings.csv"]
draw = true  # the virtual machine's errors come from the tolerances
"""


def _plan(instrument: Instrument, grid: Sequence[str]) -> str:
    """A plan with one measurement.

    Only a pointer where a setting is open: its readings say nothing.
    """
    about = (
        "# Which measurement at which stage, within a time: see [plan] in `oed schema"
        " study`,\n# and `oed plan`.\n"
    )
    if any(s.default is None for s in instrument.settings):
        return about
    lines = "\n".join(f"# {line}" for line in grid)
    return f"""\
{about}# [plan]
# budget_min = 120.0

# [[plan.measurement]]
# name = "first"
# setup = "{SETUP}"
# counts = [6, 12, 24]
{lines}
"""


def _claims() -> str:
    return """\
# Claims: `pytest` on this file checks them.
# [expect]
# rank = { of = "identifiability.rank", min = 1 }
"""


def grid_lines(
    machine: Machine, instrument: Instrument, share: float, hold: str | None
) -> list[str]:
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


def grid_size(lines: str) -> int:
    """Poses of a grid, from its lines."""
    return math.prod(int(n) for n in re.findall(r"count = (\d+)", lines))


def _fitting(
    machine: Machine, instrument: Instrument, share: float
) -> tuple[Instrument, Lead]:
    """The instrument with the longest bar that the workspace holds, where it has one.

    Where none reaches most poses, the one that reaches the most; as it is where that
    leads the tool nowhere.
    """
    if instrument.fixed_reading is None:
        return instrument, Lead(None, 0.0)
    lengths = [s for s in instrument.settings if s.name == "length" and s.default]
    if not lengths:
        return instrument, _lead(machine, instrument, share)
    (length,) = lengths
    tried = []
    for part in LENGTH_SHARES:
        shorter = dataclasses.replace(length, default=part * (length.default or 0.0))
        settings = tuple(shorter if s is length else s for s in instrument.settings)
        fitted = dataclasses.replace(instrument, settings=settings)
        tried.append((fitted, _lead(machine, fitted, share)))
        if tried[-1][1].share >= FITTING_SHARE:
            return tried[-1]
    best = max(tried, key=lambda one: one[1].share)
    return best if best[1].coordinate is not None else (instrument, tried[0][1])


def _lead(machine: Machine, instrument: Instrument, share: float) -> Lead:
    """How an instrument that keeps its reading leads the tool."""
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
    return Lead(best if shares[best] >= LED_SHARE else None, shares[best])


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
