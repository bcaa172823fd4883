"""Heights of a delta's endstops over the bed, of what a Marlin log has of home."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Literal

from pkm_printers.gcode import Command
from pkm_printers.marlin_log import Settings
from pkm_printers.marlin_version import (
    STEPS_PER_MM,
    PossibleRules,
    dead_band,
    home_offset,
)
from pkm_studies.tables import NOT_KNOWN

TOWERS = "XYZ"
#: fewest steps per mm that printers have, as of a motor with 8 microsteps
FEWEST_STEPS = 40.0
NO_HEIGHT = (
    "this version has none: add a line home_height_mm = 250 with the home height of its"
    " configuration (MANUAL_Z_HOME_POS); M206 Z is added to it"
)


@dataclasses.dataclass(frozen=True)
class Home:
    """Where a printer is at home.

    endstops      heights (3,) of the nozzle over the bed at each endstop, mm
    offset        height of the nozzle at home over M665 H, M666 aside, mm; NOT_KNOWN
                  where the log does not show it, and the height is taken as H
    probe_z       M851 Z, mm; None where the log has none
    steps_per_mm  of the towers; None where the log has no M92
    notes         sentences
    """

    endstops: tuple[float, ...]
    offset: float | Literal["not known"]
    probe_z: float | None
    steps_per_mm: float | None
    notes: list[str]


def home(
    settings: Settings, given: Mapping[str, tuple[float, ...]], rules: PossibleRules
) -> Home:
    """Home by the settings in force. Raises InputError."""
    probe, notes = settings.command("M851"), list[str]()
    probe_z = probe.number("Z") if "Z" in probe.words else None
    steps_per_mm = _steps(settings.command("M92"))
    offset = home_offset(rules, probe_z, steps_per_mm)
    height = _height(settings, given) + (offset or 0.0)
    if offset:
        notes.append(
            f"Home: the nozzle is {offset:+.4g} mm from M665 H there, as this version"
            " homes; the study has the height of the nozzle."
        )
    elif offset is None:
        notes.append(
            "Home: its height is taken as M665 H. Versions count M851 Z to it, or go"
            " further from the switches, and the log does not show which: on other"
            " firmware set the height anew."
        )
    moves = [_move(settings.command("M666"), k, steps_per_mm, rules) for k in TOWERS]
    notes += _band_text(settings.command("M666"), moves)
    endstops = tuple(height + move for move in moves)
    stated: float | Literal["not known"] = NOT_KNOWN if offset is None else offset
    return Home(endstops, stated, probe_z, steps_per_mm, notes)


def _steps(steps: Command) -> float | None:
    """Steps per mm of the towers; None without M92. Raises InputError."""
    if "X" not in steps.words:
        return None
    if steps.number("X") <= 0.0:
        problem = "steps per mm must be above 0"
        raise steps.line.error(problem, "correct the line", "M92 X")
    return steps.number("X")


def _height(settings: Settings, given: Mapping[str, tuple[float, ...]]) -> float:
    """Height at home: M665 H; without, the configuration's and M206 Z. InputError."""
    delta, shift = settings.command("M665"), settings.command("M206")
    for letter in "XY":
        if shift.number(letter, 0.0) != 0.0:
            raise shift.line.error(
                "home is off the middle, which moves all carriages",
                "set it to 0 (M206 X0 Y0), home, probe again",
                f"M206 {letter}",
            )
    if "H" in delta.words:
        return delta.number("H")
    stated = given.get("home_height_mm")
    if stated is None:
        for letter in "LR":  # a command that sets one number alone lacks these as well
            delta.number(letter)
        raise delta.line.error("M665 has no H", NO_HEIGHT)
    return stated[0] + shift.number("Z", 0.0)


def _move(
    stops: Command, tower: str, steps_per_mm: float | None, rules: PossibleRules
) -> float:
    """How far a carriage goes down from its switch by M666, mm. Raises InputError.

    An adjustment of -0.5 lowers the tower from its switch: that is higher by 0.5.
    """
    down = -stops.number(tower, 0.0)
    if down < 0.0 and rules.agreed("positive") == "no move":
        return 0.0
    if not 0.0 < down <= dead_band(steps_per_mm or FEWEST_STEPS):
        return down
    retreat = rules.agreed("retreat")
    if retreat is None and any(rule.retreat == "dead band" for rule in rules.rules):
        raise stops.line.error(
            "Marlin 2.0.6 and later makes no move for so small a value",
            "add a line firmware_version = 2.1.2, with the version of your printer",
            f"M666 {tower}",
        )
    if retreat != "dead band":
        return down
    if steps_per_mm is None:
        raise stops.line.error(
            "this version makes no move for a value of up to six steps of the motor,"
            f" {dead_band(STEPS_PER_MM):g} mm at {STEPS_PER_MM:g} steps per mm",
            "log the answer of M503 whole, or add the line M92 X80 Y80 Z80 with the steps"
            " per mm of your printer",
            f"M666 {tower}",
        )
    return 0.0


def _band_text(stops: Command, moves: list[float]) -> list[str]:
    """A sentence on values of M666 for which the firmware made no move."""
    values = [stops.number(tower, 0.0) for tower in TOWERS]
    idle = [
        f"{tower}{stops.words[tower]}"
        for tower, value, move in zip(TOWERS, values, moves, strict=True)
        if value and not move
    ]
    if not idle:
        return []
    return [
        f"M666 {' '.join(idle)} counts as 0: this version makes no move for a value of up"
        " to six steps of the motor, or above 0."
    ]
