"""Writes a study to start from: its machine, an instrument, and a draft that is sound."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from oed import units
from oed.base import Array
from oed.instrument import Instrument, mount
from oed.measurement import Measurement, commands_at_fixed_reading
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Coordinate, Family, Machine
from pkm_studies import catalogue, files, shipped
from pkm_studies.base import InputError, Location
from pkm_studies.drafts import time_budget
from pkm_studies.drafts.bodies import families
from pkm_studies.quantities import column, display_unit
from pkm_studies.resolve import resolve
from pkm_studies.study import SUFFIX, parse
from pkm_studies.tables import TO_MEASURE, PredictionReference
from pkm_studies.user_code import Origin

# Values of coordinates in a new study, in numbers that a user would write.


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
#: SI numbers of a geometry below this are rounding errors
ROUNDING = 1e-12


def axis(c: Coordinate, machine: Machine, share: float, free: int | None = None) -> str:
    """A coordinate's values; `free`, how many coordinates an instrument leaves free."""
    key = column(c.name, c.unit)
    if turns_round(c, share):
        count = TURN_VALUES
        return (
            f"{key} = {{ from = 0.0, to = 360.0, count = {count}, endpoint = false }}"
        )
    low, high = (
        format_number(end, c.unit) for end in span_of_values(c, machine, share)
    )
    return f"{key} = {{ from = {low}, to = {high}, count = {count_of_values(machine, free)} }}"


def count_of_values(machine: Machine, free: int | None = None) -> int:
    """Values of each coordinate: five, or fewer where six would make 15625 poses.

    More where an instrument leaves at most two free.
    """
    every = len(machine.command)
    free = every if free is None else free
    if free < every and free <= 2:
        return MORE_VALUES if free == 2 else MORE_VALUES**2 // 2
    few = VALUES**free > POSES
    return FEWER_VALUES if few else VALUES


def turns_round(c: Coordinate, share: float) -> bool:
    """Whether an angle goes all the way round: not in a part of the workspace.

    Where its range has no end, only a cautious try goes round.
    """
    full_turn = 2.0 * math.pi - 1e-9
    whole = c.unit == "rad" and c.lower <= 0.0 and c.upper >= full_turn
    has_ends = math.isfinite(c.lower) and math.isfinite(c.upper)
    return whole and (share == SHARES[0] or has_ends)


def span_of_values(
    c: Coordinate, machine: Machine, share: float
) -> tuple[float, float]:
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


def prediction_table(
    machine: Machine, errors: PredictionReference = "home", share: float = SHARES[0]
) -> str:
    """The table [prediction]; `errors`, what the errors refer to.

    share  of the workspace that its poses span
    """
    axes = "\n".join(axis(c, machine, share) for c in machine.command)
    driven = next((c for c in machine.components if c.compensatable), None)
    limit = ""
    if driven is not None:
        key = f"{driven.name}_{units.FINE[driven.unit]}"
        limit = (
            f"# wanted = {{ {key} = 50 }}  # rms error to reach, judged in the report\n"
        )
    return f"""\
[prediction]
reference = "{errors}"  # home, absolute or best_fit
{limit}{axes}
"""


def format_pose(coordinates: tuple[Coordinate, ...], values: Array) -> str:
    fields = [
        f"{column(c.name, c.unit)} = {format_number(value, c.unit)}"
        for c, value in zip(coordinates, values, strict=True)
    ]
    return "{ " + ", ".join(fields) + " }"


def format_number(value: float, si: str) -> str:
    """An SI value as TOML, in the unit of its column."""
    return number_text(value, display_unit(si))


def format_numbers(value: object, si: str) -> str:
    """An SI number, or nested lists of them, as TOML."""
    if isinstance(value, list | tuple | np.ndarray):
        return f"[{', '.join(format_numbers(item, si) for item in value)}]"
    number = float(value)  # type: ignore[arg-type]
    return format_number(number if abs(number) > ROUNDING else 0.0, si)


def number_text(value: float, unit: str) -> str:
    number = f"{float(units.from_si(value, unit)):.9g}"
    return number if re.search(r"[.e]", number) else f"{number}.0"


# The text of a commented study to start from, for a machine with an instrument.


#: a number that only the user can know, as TOML
OPEN = f'"{TO_MEASURE}"'
#: readings of the design, where the grid has as many
READINGS = 30
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
SETUP = "setup1"


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
    blocks = [
        _head(name, machine, instrument),
        _machine(model, machine, table),
        _setup(reference, machine, instrument),
        _noise(instrument),
        _prior(machine),
        _design(machine, instrument, share),
        _readings(machine),
        prediction_table(machine, share=share),
        _plan(machine, instrument, share),
        GAP,
        _claims(),
    ]
    return "\n".join(blocks)


# -- tables ----------------------------------------------------------------------------


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


def _design(machine: Machine, instrument: Instrument, share: float) -> str:
    grid = grid_lines(machine, instrument, share)
    counts = [int(n) for n in re.findall(r"count = (\d+)", "\n".join(grid))]
    readings = min(READINGS, math.prod(counts) // 2)  # fewer than there are candidates
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


def _plan(machine: Machine, instrument: Instrument, share: float) -> str:
    """A plan with one measurement.

    Only a pointer where a setting is open: its readings say nothing.
    """
    about = (
        "# Which measurement at which stage, within a time: see [plan] in `oed schema"
        " study`,\n# and `oed plan`.\n"
    )
    if any(s.default is None for s in instrument.settings):
        return about
    grid = "\n".join(f"# {line}" for line in grid_lines(machine, instrument, share))
    return f"""\
{about}# [plan]
# budget_min = 120.0

# [[plan.measurement]]
# name = "first"
# setup = "{SETUP}"
# counts = [6, 12, 24]
{grid}
"""


def _claims() -> str:
    return """\
# Claims: `pytest` on this file checks them.
# [expect]
# rank = { of = "identifiability.rank", min = 1 }
"""


# -- candidates ------------------------------------------------------------------------


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


#: instruments to draft a study with, the most informative first
DEFAULTS = ("pose_tracker", "pose_tracker_position", "redundancy")


@dataclasses.dataclass(frozen=True)
class StartingModel:
    """A machine to start from.

    name       as a study names its model
    table      numbers of the machine in a study, where they are not the model's
    sentences  on what was read of a file
    """

    name: str
    machine: Machine
    table: str = ""
    sentences: tuple[str, ...] = ()


def model_of(machine: str, origin: Origin, loops: Path | None = None) -> StartingModel:
    """The machine of a name or file of Python, of MJCF, or of URDF with its loops.

    Raises InputError for a machine that is none.
    """
    if families.is_model_file(machine):
        described = families.described(origin.folder / machine, loops)
        name = described.machine.name
        table = families.study_tables(described)
        return StartingModel(name, described.machine, table, described.sentences)
    location = Location("oed new").key("--machine")
    if loops is not None:
        raise location.error(
            "only URDF needs a table of loops", "leave out --loops", machine
        )
    return StartingModel(machine, catalogue.machine(machine, origin, location))


def default_instrument(model: Machine, origin: Origin) -> tuple[str, list[str]]:
    """An instrument that can read a machine as it stands, and the others that can.

    It is the first of DEFAULTS, or of the catalogue, whose settings all have defaults.
    Raises InputError where none can read it.
    """
    location = Location("oed new")
    names = [entry.name for entry in catalogue.listing("instruments")]
    tools = {
        name: catalogue.instrument(name, origin, location).for_machine(model)
        for name in names
    }
    able = [name for name in names if tools[name].unfit(model) is None]
    ready = [n for n in able if all(s.default is not None for s in tools[n].settings)]
    chosen = next((name for name in DEFAULTS if name in ready), None)
    if chosen is None and not able:
        raise location.key("--instrument").error(
            f"no instrument of the catalogue can read {model.name}",
            "write one, see the reference, and name its file with --instrument",
        )
    chosen = chosen or [*ready, *able][0]
    return chosen, [name for name in able if name != chosen]


def write_draft(
    name: str | None,
    machine: str | StartingModel,
    instrument: str,
    origin: Origin,
    seconds: float | None = None,
) -> Path:
    """Write NAME.study.toml into a folder; its path. Without a name, the machine's.

    origin   the folder, and whether the models' files may run
    seconds  that the readings may take; None: READINGS of them

    Raises InputError for a bad name, an existing file, an instrument that cannot read
    the machine, and too short a time.
    """
    location = Location("oed new")
    start = model_of(machine, origin) if isinstance(machine, str) else machine
    model = start.machine
    path = shipped.new_path(model.name if name is None else name, origin.folder)
    listed = catalogue.instrument(instrument, origin, location.key("--instrument"))
    tool = listed.for_machine(model)
    reason = tool.unfit(model)
    if reason is not None:
        raise location.key("--instrument").error(
            f"it cannot read {model.name}: {reason}", "take another", instrument
        )
    if tool.single:
        tool = tool.take_channels([tool.channels[0].name])
    study = path.name.removesuffix(SUFFIX)
    drafts = (
        draft_text(study, start.name, model, instrument, tool, share, start.table)
        for share in SHARES
    )
    draft = first_sound(drafts, path, origin)
    if seconds is not None:
        draft = time_budget.with_time(draft, seconds, tool)
    return files.write_whole(path, draft)


def first_sound(drafts: Iterable[str], path: Path, origin: Origin) -> str:
    """The first draft whose poses the machine can take, or whose fault is another.

    A user's machine may reach less than its ranges say. Raises InputError where it does
    not even reach what lies near its home pose.
    """
    problems: list[InputError] = []
    for draft in drafts:
        try:
            # any number will do to check the others
            whole = draft.replace(OPEN, "0.0")
            resolve(parse(whole, path, origin.consent), readings=())
        except (InputError, AssemblyError) as error:
            if not isinstance(error, InputError):
                error = InputError(str(error), "")
            problems.append(error)
            continue
        return draft
    problem = problems[0]
    raise InputError(
        f"no draft of a study passes its check: {problem.problem}",
        "check the machine's home pose, the ranges of commands and joints, and guess",
        file=problem.file,
        field=problem.field,
    )
