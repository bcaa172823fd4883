"""RepRapFirmware: M665 and M666 of a delta."""

import dataclasses

import numpy as np

from oed.base import Array
from pkm_printers import gcode, hangprinter, rotary_delta, rrf_five_bar
from pkm_printers.delta_geometry import TOWER_ANGLES, DeltaGeometry
from pkm_printers.delta_numbers import (
    ACCEPTED_LOSS,
    delta_joints,
    delta_numbers,
    firmware_of,
    has_slopes,
    home_notes,
    not_a_delta,
    retained_words,
    trim_notes,
    trims,
)
from pkm_printers.hangprinter import hangprinter_format
from pkm_printers.rrf import linear_geometry
from pkm_printers.rrf_rotary import rotary_format
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts

NAME = "rrf"
USUAL_FILE = "config.g"
STORED = (
    "M501 reads {file} after config.g, so its M665 and M666 win: put these lines there in"
    " their place, or after M501 in config.g; or send them to the printer, then M500"
)
UNKNOWN_WORDS = (
    "B of M665 (printable radius) and A, B of M666 (bed tilt) are not written, as the study"
    " does not know them: keep those of the printer"
)
BED = "A and B of M666 are the rise of the bed along x and y, in percent"


def notes(compensation: Compensation) -> tuple[str, ...]:
    """Which version and file the lines are for, and what they do not hold."""
    single = len(set(_rods(delta_numbers(compensation, NAME)))) == 1
    firmware = firmware_of(compensation, NAME)
    file = None if firmware is None else firmware.file
    sentences = [
        f"for {file or USUAL_FILE} of RepRapFirmware 3"
        if single
        else f"for {file or USUAL_FILE}; several lengths after L need RepRapFirmware 3"
    ]
    if file is not None:
        sentences.append(STORED.format(file=file))
    if firmware is None:
        sentences.append(UNKNOWN_WORDS)
    elif has_slopes(compensation.machine):
        sentences.append(BED)
    sentences += home_notes(compensation, NAME)
    return (*sentences, *trim_notes(compensation, NAME))


def write(compensation: Compensation) -> Texts:
    """Homed height H, and M666 with adjustments of mean zero.

    The firmware homes carriage i to H + sqrt(L_i^2 - R^2) + its adjustment: H plus the
    adjustment is the height of an endstop.
    """
    numbers = delta_numbers(compensation, NAME)
    lean = numbers.angles - TOWER_ANGLES
    height = float(np.mean(numbers.endstops))
    adjust = numbers.endstops - height
    arms = _rods(numbers)
    rods = arms[0] if len(set(arms)) == 1 else ":".join(arms)
    delta = (
        f"M665 L{rods} R{numbers.radius:.4f}"
        f" H{height:.4f} X{lean[0]:.4f} Y{lean[1]:.4f} Z{lean[2]:.4f}"
    )
    stops = f"M666 X{adjust[0]:.4f} Y{adjust[1]:.4f} Z{adjust[2]:.4f}"
    if has_slopes(compensation.machine):
        rise = 100.0 * numbers.bed_slope
        stops += f" A{rise[0]:.4f} B{rise[1]:.4f}"
    lines = [
        f"{delta} {retained_words(compensation, NAME, 'M665')}".rstrip(),
        f"{stops} {retained_words(compensation, NAME, 'M666')}".rstrip(),
    ]
    return {".g": compensation.commented(";", lines)}


def _rods(numbers: DeltaGeometry) -> list[str]:
    """Lengths of the rods as they are written; one where they hardly differ."""
    is_common = np.ptp(numbers.arms) <= ACCEPTED_LOSS
    arms = np.full(3, numbers.arms.mean()) if is_common else numbers.arms
    return [f"{arm:.4f}" for arm in arms]


def joints(texts: Texts, compensation: Compensation) -> Array:
    """Travels of a printer with these commands.

    z of a study without slopes of the bed counts along the towers, as the firmware's does
    once it has raised it by M666 A and B.
    """
    lines = gcode.lines_of(texts[".g"])
    delta, stops = (gcode.merged(lines, name, "") for name in ("M665", "M666"))
    trims_mm = {"radius_trim_mm": tuple(trims(compensation, NAME, "radius_trim_mm"))}
    numbers = linear_geometry(delta, stops, trims_mm)
    if not has_slopes(compensation.machine):
        numbers = dataclasses.replace(numbers, bed_slope=np.zeros(2))
    return delta_joints(numbers, compensation)


linear_format = ControllerFormat(
    name=NAME,
    about="RepRapFirmware: M665, M666, M669 of deltas, rotary deltas, five-bars, Hangprinters",
    source="RepRapFirmware, src/Movement/Kinematics/LinearDeltaKinematics.cpp",
    write=write,
    joints=joints,
    unfit=not_a_delta,
    notes=notes,
)
controller = linear_format.with_others(
    {
        rotary_delta.MODEL: rotary_format,
        rrf_five_bar.MODEL: rrf_five_bar.five_bar_format,
        hangprinter.MODEL: hangprinter_format,
    }
)
