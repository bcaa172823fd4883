"""A commented study to start from, for any machine with any instrument of the
catalogue.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from oed import units
from oed.arrays import Array
from oed.instrument import Instrument, mount
from oed.kinematics import AssemblyError
from oed.machine import Coordinate, Machine
from oed.measurement import Measurement
from pkm_studies import catalogue, files
from pkm_studies.errors import InputError, Place
from pkm_studies.resolve.quantities import column
from pkm_studies.study import SUFFIX

#: values a coordinate of the grid that is offered; fewer where these make more poses
#: than so many
VALUES, FEWER, POSES = 5, 3, 1000
#: share of the workspace that the grid spans
SHARE = 0.6
#: readings of the plan that is offered, where the grid has as many
READINGS = 30
TURN = 12
#: share of the grid's poses to which an instrument must be able to lead the tool for a
#: coordinate to be "hold"
LED = 0.3
SETUP = "setup1"
GAP = """\
# What calibration leaves: `oed diagnose` looks for its causes in any readings; with [gap], `oed run` does as well, and
# tells beforehand which causes could be found. It knows more with columns time_s, direction, feed_mm_min, payload_N.
# [gap]
# effects = ["all"]  # of `oed list effects`, or files of your own
# gravity = [0.0, 0.0, -1.0]  # its direction in the base frame

# [gap.conditions]  # how the virtual machine is read
# start_min = 30.0
# feed_mm_min = 1000.0

# [[gap.acting]]  # what it has
# effect = "encoder_scale"
"""


def write(name: str, machine: str, instrument: str, folder: Path) -> Path:
    """Write NAME.study.toml; returns its path. Raises InputError for a bad name, or
    where the file is there.
    """
    name = name.removesuffix(SUFFIX)
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
        raise InputError(
            "this is no name for a study",
            "use letters, digits, _ and -",
            field="NAME",
            value=name,
        )
    path = folder / f"{name}{SUFFIX}"
    if path.exists():
        raise InputError(
            "there is a study of this name",
            "choose another name, or remove it",
            file=str(path),
        )
    place = Place("oed new")
    model = catalogue.machine(machine, folder, place.key("--machine"))
    tool = catalogue.instrument(instrument, folder, place.key("--instrument"))
    reason = tool.unfit(model)
    if reason is not None:
        raise place.key("--instrument").error(
            f"it cannot read {model.name}: {reason}", "take another", instrument
        )
    return files.write_whole(path, text(name, machine, model, instrument, tool))


def text(
    name: str, model: str, machine: Machine, reference: str, instrument: Instrument
) -> str:
    """The text of a study that `oed check` finds sound."""
    blocks = [
        _head(name, machine, instrument),
        _machine(model, machine),
        _setup(reference, machine, instrument),
        _noise(instrument),
        _prior(machine),
        _design(machine, instrument),
        _rest(machine, instrument),
    ]
    return "\n".join(blocks)


def _head(name: str, machine: Machine, instrument: Instrument) -> str:
    return f"""\
# {machine.about or machine.name}, measured with: {instrument.about or instrument.name}.
# Every number carries its unit in the name of its field. `oed check` tells what is wrong, `oed run` runs it.

schema = 1
name = "{name}"
title = "{machine.name} with {instrument.name}"
question = "Which readings see the machine's errors best, and how accurate is it afterwards?"
seed = 0
"""


def _machine(model: str, machine: Machine) -> str:
    p = machine.parameters[0]
    key = column(p.name, p.unit)
    held = ", ".join(f'"{n}"' for n in machine.frame)
    return f"""\
[machine]
model = "{model}"
# fixed = [{held}]  # parameters held; these only choose the base frame

# [machine.nominal]
# {key} = {_number(p.nominal, p.unit)}  # {p.about}: your machine's number instead of the model's
"""


def _setup(reference: str, machine: Machine, instrument: Instrument) -> str:
    lines = ["[[setup]]", f'name = "{SETUP}"', f'instrument = "{reference}"']
    lines += ["# tool_mm = [0.0, 0.0, 0.0]  # tool point, from the reference tool's"]
    for s in instrument.settings:
        value = 0.0 if s.default is None else s.default
        remark = s.about if s.default is not None else f"{s.about}: measure it"
        lines.append(f"{column(s.name, s.unit)} = {_number(value, s.unit)}  # {remark}")
    if instrument.reference == "teach":
        lines.append(
            f"teach = {_pose(machine.command, machine.home_command)}  # the pose at"
            " which it was taught"
        )
    for n in instrument.nuisances:
        lines.append(
            f"# tolerance.{column(n.name, n.unit)} = {_number(n.tolerance, n.unit)}  #"
            f" {n.about}"
        )
    return "\n".join(lines) + "\n"


def _noise(instrument: Instrument) -> str:
    fine = {c.name: units.FINE[c.unit] for c in instrument.channels}
    lines = [
        f"{c.name}_{fine[c.name]} = {_in(c.sigma, fine[c.name])}  # standard deviation"
        " of one reading"
        for c in instrument.channels
    ]
    return "[noise]\n" + "\n".join(lines) + "\n"


def _prior(machine: Machine) -> str:
    p = machine.parameters[0]
    return f"""\
# Tolerances from drawing or assembly, where they differ from the model's:
# [[prior.tolerance]]
# parameters = ["{p.name}"]  # names or patterns, as "{p.name[:1]}*"
# {column("sigma", p.unit)} = {_number(p.tolerance, p.unit)}
"""


def _design(machine: Machine, instrument: Instrument) -> str:
    criteria = (
        'criterion = "D"  # or Ds, A, c, I, G, E, kappa, O1 to O5: see `oed schema'
        " study`"
    )
    grid = _grid(machine, instrument)
    counts = [int(n) for n in re.findall(r"count = (\d+)", "\n".join(grid))]
    readings = min(READINGS, math.prod(counts) // 2)  # fewer than there are candidates
    lines = ["[design]", criteria, f"readings = {readings}", 'scaling = "length"', ""]
    lines += ["[[design.candidates]]", f'setup = "{SETUP}"']
    return "\n".join([*lines, *grid]) + "\n"


def _grid(machine: Machine, instrument: Instrument) -> list[str]:
    hold = _held(machine, instrument)
    return [
        (
            f'{c.name} = "hold"  # led by the instrument'
            if c.name == hold
            else _axis(c, machine)
        )
        for c in machine.command
    ]


def _axis(c: Coordinate, machine: Machine) -> str:
    low, high = _span(c, machine)
    key = column(c.name, c.unit)
    if _turns(c):
        return f"{key} = {{ from = 0.0, to = 360.0, count = {TURN}, endpoint = false }}"
    return (
        f"{key} = {{ from = {_number(low, c.unit)}, to = {_number(high, c.unit)}, count"
        f" = {_values(machine)} }}"
    )


def _values(machine: Machine) -> int:
    """Values a coordinate: with six of them, five each would be 15625 poses, and
    minutes.
    """
    return VALUES if VALUES ** len(machine.command) <= POSES else FEWER


def _turns(c: Coordinate) -> bool:
    """An angle that may go all the way round."""
    return c.unit == "rad" and c.lower <= 0.0 and c.upper >= 2.0 * math.pi - 1e-9


def _rest(machine: Machine, instrument: Instrument) -> str:
    axes = "\n".join(_axis(c, machine) for c in machine.command)
    plan = _plan(machine, instrument)
    return f"""\
[readings]
simulate = true  # or: files = ["{machine.name}.readings.csv"]
draw = true  # the virtual machine's errors come from the tolerances

[prediction]
reference = "home"  # home, absolute or best_fit
{axes}

{plan}
{GAP}
# Claims: `pytest` on this file tells whether they hold.
# [expect]
# rank = {{ of = "identifiability.rank", min = 1 }}
"""


def _plan(machine: Machine, instrument: Instrument) -> str:
    """A plan with one measurement; a pointer where the set-up's place is a placeholder,
    which tells no noise.
    """
    about = (
        "# Which measurement at which stage, within a time: see [plan] in `oed schema"
        " study`, and `oed plan`.\n"
    )
    if any(s.default is None for s in instrument.settings):
        return about
    grid = "\n".join(f"# {line}" for line in _grid(machine, instrument))
    return f"""\
{about}# [plan]
# budget_min = 120.0

# [[plan.measurement]]
# name = "first"
# setup = "{SETUP}"
# counts = [6, 12, 24]
{grid}
"""


def _span(c: Coordinate, machine: Machine) -> tuple[float, float]:
    """The middle of a coordinate's range; about home where it has no end."""
    home = machine.home[c.name]
    low = c.lower if np.isfinite(c.lower) else home - 0.1
    high = c.upper if np.isfinite(c.upper) else home + 0.1
    centre, half = (low + high) / 2.0, (high - low) / 2.0
    return centre - SHARE * half, centre + SHARE * half


def _held(machine: Machine, instrument: Instrument) -> str | None:
    """The coordinate by which the instrument can lead the tool at most poses of the
    grid, if there is one.
    """
    if instrument.fixed_reading is None:
        return None
    ends = [
        (0.0, 2.0 * math.pi) if _turns(c) else _span(c, machine)
        for c in machine.command
    ]
    axes = [np.linspace(low, high, _values(machine)) for low, high in ends]
    command = np.column_stack([m.ravel() for m in np.meshgrid(*axes, indexing="ij")])
    shares = {
        c.name: _share(machine, instrument, command, c.name) for c in machine.command
    }
    best = max(shares, key=lambda name: shares[name])
    return best if shares[best] >= LED else None


def _share(
    machine: Machine, instrument: Instrument, command: Array, coordinate: str
) -> float:
    settings = {
        s.name: 0.0 if s.default is None else s.default for s in instrument.settings
    }
    teach = machine.home_command if instrument.reference == "teach" else None
    setup = mount(instrument, SETUP, teach=teach, **settings)  # type: ignore[arg-type]
    try:
        return float(
            Measurement(machine, [setup])
            .commands_at_fixed_reading(SETUP, command, coordinate)[1]
            .mean()
        )
    except (AssemblyError, ValueError):
        return 0.0


def _pose(coordinates: tuple[Coordinate, ...], values: Array) -> str:
    said = [
        f"{column(c.name, c.unit)} = {_number(v, c.unit)}"
        for c, v in zip(coordinates, values, strict=True)
    ]
    return "{ " + ", ".join(said) + " }"


def _number(value: float, unit: str) -> str:
    """An SI value as TOML, in the unit that `column` writes."""
    return _in(value, column("x", unit).removeprefix("x_"))


def _in(value: float, unit: str) -> str:
    told = f"{float(units.from_si(value, unit)):.9g}"
    return told if re.search(r"[.e]", told) else f"{told}.0"
