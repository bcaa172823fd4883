"""Marlin: M665 and M666 of a delta."""

from __future__ import annotations

import re

import numpy as np

from oed.arrays import Array
from pkm_studies.compensation.build import sentences_of
from pkm_studies.compensation.content import Compensation, ControllerFormat, Texts
from pkm_studies.compensation.formats.delta import (
    ANGLES,
    DeltaNumbers,
    delta_joints,
    delta_numbers,
    not_a_delta,
)


def write(compensation: Compensation) -> Texts:
    """Height H of the lowest endstop; M666 holds how far each other one is above it.

    Marlin homes a tower to its endstop, moves down by the adjustment (zero or less),
    and counts the carriage there as that of the tool at height H.
    """
    numbers = delta_numbers(compensation)
    rod = float(numbers.arms.mean())
    trim = numbers.arms - rod
    lean = numbers.angles - ANGLES
    # the firmware's carriage height at home is H + sqrt(arm^2 - radius^2), tower by tower
    height = float(numbers.endstops.min())
    adjust = height - numbers.endstops
    lines = [f"; {sentence}" for sentence in sentences_of(compensation)]
    lines += [
        f"M665 L{rod:.4f} R{numbers.radius:.4f} H{height:.4f}"
        f" X{lean[0]:.4f} Y{lean[1]:.4f} Z{lean[2]:.4f}"
        f" A{trim[0]:.4f} B{trim[1]:.4f} C{trim[2]:.4f}",
        f"M666 X{adjust[0]:.4f} Y{adjust[1]:.4f} Z{adjust[2]:.4f}",
        "M500 ; store",
        "",
    ]
    return {".gcode": "\n".join(lines)}


def words(text: str, code: str) -> dict[str, list[float]]:
    """Letters and numbers of the first line that starts with a code."""
    line = next(row for row in text.splitlines() if row.startswith(f"{code} "))
    pairs = re.findall(r"([A-Z])(-?[\d.]+(?::-?[\d.]+)*)", line.split(" ", 1)[1])
    return {letter: [float(v) for v in values.split(":")] for letter, values in pairs}


def joints(texts: Texts, compensation: Compensation) -> Array:
    """Travels of a printer with these commands."""
    geometry = words(texts[".gcode"], "M665")
    adjust = words(texts[".gcode"], "M666")
    rod, radius = geometry["L"][0], geometry["R"][0]
    numbers = DeltaNumbers(
        radius=radius,
        arms=rod + np.array([geometry[k][0] for k in "ABC"]),
        angles=np.array(ANGLES) + [geometry[k][0] for k in "XYZ"],
        endstops=geometry["H"][0] - np.array([adjust[k][0] for k in "XYZ"]),
    )
    return delta_joints(numbers, numbers.carriages, compensation)


controller = ControllerFormat(
    name="marlin",
    about="M665 and M666 of a delta printer, four decimals",
    source="Marlin, src/module/delta.cpp and gcode M665, M666",
    write=write,
    joints=joints,
    unfit=not_a_delta,
)
