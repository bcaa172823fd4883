"""RepRapFirmware: M669 K6 and M666 of a Hangprinter.

The firmware takes the place where all motors are 0 for its origin, so that anchors are
written as seen from there.
"""

from __future__ import annotations

import numpy as np

from oed import units
from oed.base import Array
from oed.model import Machine
from pkm_printers import gcode
from pkm_printers.delta_numbers import retained_words
from pkm_printers.hangprinter import LETTERS, machine_table
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts

COMMANDS = ("M669", "M666")
NOT_WRITTEN = (
    "S, W, T, X, Y and other words of the flex compensation stay as they are: the study"
    " does not identify them"
)


def _write(compensation: Compensation) -> Texts:
    """Anchors with two decimals of mm more than they are known to, spools and build-up."""
    count = len(compensation.machine.joints)
    anchors = [_place(compensation, f"anchor{i + 1}") for i in range(count)]
    places = np.array(anchors) - _place(compensation, "origin_")
    radii = [compensation.parameter(f"radius{i + 1}") for i in range(count)]
    retained = [retained_words(compensation, "rrf", name) for name in COMMANDS]
    (spool_words,) = gcode.commands(gcode.lines_of(f"M666 {retained[1]}"))
    buildup = compensation.parameter("buildup") / spool_words.number("O", 1.0)
    cells = [":".join(f"{v:.4f}" for v in place) for place in places]
    phrases = [f"{k}{v}" for k, v in zip(LETTERS, cells, strict=False)]
    spools = ":".join(f"{v:.4f}" for v in units.from_si(np.array(radii), "mm"))
    lines = [
        *(f"; {sentence}" for sentence in compensation.comments),
        f"M669 K6 N{count} {' '.join(phrases)} {retained[0]}",
        f"M666 Q{units.number(buildup, 'mm'):.6f} R{spools} {retained[1]}",
    ]
    return {".g": "\n".join([*lines, ""])}


def _joints(texts: Texts, compensation: Compensation) -> Array:
    """Motor angles of a printer with these commands, without flex."""
    lines = gcode.lines_of(texts[".g"])
    anchors, spools = (gcode.merged(lines, name, "") for name in COMMANDS)
    table = machine_table(anchors, spools)
    places = np.array(table.geometry["anchor_mm"])
    fold, gear = (np.array(table.geometry[k]) for k in ("fold", "gear"))
    radii = np.array([*table.nominal.values()])
    origin = _place(compensation, "origin_")
    commands = units.from_si(compensation.command, "mm") - origin
    distances = np.linalg.norm(commands[:, None] - places, axis=2)
    change = distances - np.linalg.norm(places, axis=1)
    # 2 / k2 (sqrt(r^2 + k2 l) - r), which holds without build-up too
    k2 = -fold * np.array(table.geometry["buildup_mm"])
    turned = 2.0 * change / (np.sqrt(radii**2 + k2 * change) + radii)
    return np.asarray(turned * fold * gear)


def _place(compensation: Compensation, stem: str) -> Array:
    """Three coordinates (3,), mm."""
    values = [compensation.parameter(f"{stem}{axis}") for axis in "xyz"]
    return units.from_si(np.array(values), "mm")


def _notes(compensation: Compensation) -> tuple[str, ...]:
    """What the file is for, where its origin is, and what it does not hold."""
    listed = ", ".join(f"{v:+.2f}" for v in _place(compensation, "origin_"))
    origin = f"the origin is where the motors are 0, {listed} mm in the study's frame"
    return "for config.g, in place of its M669 and M666", origin, NOT_WRITTEN


def _unfit(machine: Machine) -> str | None:
    if "buildup" in {p.name for p in machine.parameters}:
        return None
    return "it writes a Hangprinter whose motors were 0 at one place (zeroed = 1)"


hangprinter_format = ControllerFormat(
    name="rrf",
    about="M669 K6 and M666 of a Hangprinter",
    source="RepRapFirmware, src/Movement/Kinematics/HangprinterKinematics.cpp",
    write=_write,
    joints=_joints,
    unfit=_unfit,
    notes=_notes,
)
