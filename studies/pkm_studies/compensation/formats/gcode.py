"""G-code of the planned measuring poses, with dwell and comments (RS274/NGC)."""

from oed import units
from oed.model import Machine
from oed.text import shorten
from pkm_studies.base import InputError
from pkm_studies.catalogue import (
    MAX_COMMENT_LENGTH,
    Compensation,
    ControllerFormat,
    MeasuringPose,
    Texts,
)
from pkm_studies.quantities import display_unit

DWELL = 2.0  #: rest before a reading, s
FEED = 300  #: mm/min
TURNS = "ABC"  #: letters of angles, in the order of the command


def letters(machine: Machine) -> dict[str, str]:
    """Axis letter of each command coordinate: X, Y, Z by name, then A, B, C."""
    axes = {}
    turns = iter(TURNS)
    for c in machine.command:
        axes[c.name] = c.name.upper() if c.name in "xyz" else next(turns)
    return axes


def write(compensation: Compensation) -> Texts:
    """A move, dwell and comment for each planned pose. Raises InputError without any."""
    if not compensation.poses:
        raise InputError(
            "the result has no planned poses",
            "run a study with [design], or write the tables: --to csv",
            value="--to gcode",
        )
    axes = letters(compensation.machine)
    named = ", ".join(f"{name} is {letter}" for name, letter in axes.items())
    lines = [f"({_plain(s)})" for s in compensation.comments]
    lines += [
        f"({named}; mm and degrees; commands are not corrected)",
        f"(G4 P{DWELL:g}: seconds, as in RS274/NGC; some printers read milliseconds)",
        "G21 G90 G94",
    ]
    setup = ""
    for number, pose in enumerate(compensation.poses, start=1):
        if pose.setup != setup:
            setup = pose.setup
            lines += [f"(set-up {_plain(setup)}: mount it, then continue)", "M0"]
        lines += _reading(number, pose, compensation.machine, axes)
    return {".ngc": "\n".join([*lines, "M2", ""])}


def _reading(
    number: int, pose: MeasuringPose, machine: Machine, axes: dict[str, str]
) -> list[str]:
    phrases = [
        f"{axes[c.name]}{units.number(float(value), display_unit(c.unit)):.4f}"
        for c, value in zip(machine.command, pose.command, strict=True)
    ]
    return [
        f"G1 {' '.join(phrases)} F{FEED}",
        f"G4 P{DWELL:g}",
        f"(reading {number}, run {_plain(pose.run)})",
    ]


def _plain(text: str) -> str:
    """Text inside a comment, which ends with the line or at the first closing bracket."""
    return shorten(text, MAX_COMMENT_LENGTH).replace("(", "[").replace(")", "]")


def unfit(machine: Machine) -> str | None:
    """More than three coordinates that are no x, y, z have no letters."""
    others = [c.name for c in machine.command if c.name not in "xyz"]
    return None if len(others) <= len(TURNS) else f"no axis letters for {others}"


controller = ControllerFormat(
    name="gcode",
    about="the planned measuring poses with dwell and comments",
    source="RS274/NGC",
    write=write,
    unfit=unfit,
)
