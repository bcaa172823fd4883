"""RepRapFirmware: a rotary delta, M669 K10 with M666, in and out.

Limbs stand at 210, 330 and 90 degrees and M669 X, Y, Z more. An arm at its switch counts as
at the largest angle over the horizontal, the second number of M669 A, plus its M666. M500
stores two decimals of M669, so its lines are for config.g.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from oed.base import Array
from pkm_printers import gcode
from pkm_printers.delta_geometry import TOWER_ANGLES
from pkm_printers.delta_numbers import ACCEPTED_LOSS, retained_words
from pkm_printers.gcode import Command, TextLine
from pkm_printers.rotary_delta import RotaryGeometry, identified_geometry, rotary_joints
from pkm_printers.rrf_sequence import WORDS
from pkm_printers.words import HARMLESS, READ, WordTable, refused, same
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts

KINEMATICS: Final = "10"
KEPT: Final = "BST"  #: words of M669 that the fit leaves as they are
USUAL_RANGE: Final = "-45:45"  #: M669 A that the firmware has without, degrees
USUAL_TRIGGER: Final = 0.7  #: mm: G31 Z that the firmware has without
OF_DELTAS: Final = refused(
    "this command is of linear deltas, which this printer is not by its M669 K",
    "remove what the printer does not have from a copy",
)
ROTARY_WORDS: Final[WordTable] = {
    **WORDS,
    "M665": {"": OF_DELTAS},
    "M666": same(READ, "XYZ"),
    "M669": {**same(READ, "KULHRXYZA"), **same(HARMLESS, KEPT)},
    # such a machine does not move alike at all heights, so that this one counts
    "G31": {**WORDS["G31"], "Z": READ},
}
NOTES: Final = (
    "for config.g of RepRapFirmware 3, in place of its M669 and M666; where M501 reads"
    " config-override.g, below it",
    "M500 stores two decimals of M669 alone, which are 0.005 mm and 0.005 deg: keep these"
    " lines",
)


def rotary_geometry(lines: Sequence[TextLine]) -> RotaryGeometry:
    """The geometry of M669 K10 and M666. Raises InputError."""
    delta = gcode.merged(lines, "M669", "give the config.g that has M669 K10")
    stops = gcode.optional(lines, "M666")
    heights = _limb_numbers(delta, "H")
    if np.ptp(heights) > ACCEPTED_LOSS:
        raise delta.line_of("H").error(
            "the model has its three shoulders at one height",
            "level them, and give the one height that they have then",
            "M669 H",
        )
    return RotaryGeometry(
        radius=delta.number("R"),
        height=float(heights.mean()),
        upper=_limb_numbers(delta, "U"),
        lower=_limb_numbers(delta, "L"),
        angles=TOWER_ANGLES + delta.numbers("XYZ"),
        endstops=_largest(delta) + stops.numbers("XYZ"),
    )


def kinematics_words(lines: Sequence[TextLine]) -> dict[str, str]:
    """Words of M669 that are written back as they are; A holds what M666 counts from."""
    return {"M669": gcode.merged(lines, "M669", "").text_of(f"A{KEPT}")}


def trigger_height(lines: Sequence[TextLine]) -> float:
    """Height of the nozzle at which the probe triggers, mm."""
    return gcode.optional(lines, "G31").number("Z", USUAL_TRIGGER)


def _largest(command: Command) -> float:
    """The angle at the switches, deg. Raises InputError."""
    stated = Command("M669", {"A": USUAL_RANGE} | command.words, command.line)
    return stated.values("A", 2)[1]


def _limb_numbers(command: Command, letter: str) -> Array:
    """Numbers (3,) of the limbs; one stands for all. Raises InputError."""
    return np.array(command.values(letter, 1, 3)) * np.ones(3)


def _write(compensation: Compensation) -> Texts:
    """M669 and M666, four decimals of mm and five of degrees."""
    geometry = identified_geometry(compensation)
    retained = retained_words(compensation, "rrf", "M669")
    if not retained.startswith("A"):
        retained = f"A{USUAL_RANGE} {retained}".rstrip()
    # limbs of other firmwares stand elsewhere: the same angle from -180 to 180
    lean = (geometry.angles - TOWER_ANGLES + 180.0) % 360.0 - 180.0
    command = gcode.merged(gcode.lines_of(f"M669 {retained}"), "M669", "")
    adjust = geometry.endstops - _largest(command)
    lengths = (("U", geometry.upper), ("L", geometry.lower))
    arms = " ".join(f"{k}{':'.join(f'{v:.4f}' for v in row)}" for k, row in lengths)
    lines = [
        f"M669 K{KINEMATICS} R{geometry.radius:.4f} H{geometry.height:.4f} {arms}"
        f" {_letters(lean)} {retained}",
        f"M666 {_letters(adjust)}",
    ]
    return {".g": compensation.commented(";", lines)}


def _letters(values: Array) -> str:
    """X, Y and Z with five decimals: 1e-5 degrees move an arm of 300 mm by 0.05 um."""
    return " ".join(f"{k}{v:.5f}" for k, v in zip("XYZ", values, strict=True))


def _joints(texts: Texts, compensation: Compensation) -> Array:
    """Turns of a printer with these commands."""
    geometry = rotary_geometry(gcode.lines_of(texts[".g"]))
    return rotary_joints(geometry, compensation)


rotary_format = ControllerFormat(
    name="rrf",
    about="M669 K10 and M666 of a rotary delta",
    source="RepRapFirmware, src/Movement/Kinematics/RotaryDeltaKinematics.cpp",
    write=_write,
    joints=_joints,
    notes=lambda compensation: NOTES,
)
