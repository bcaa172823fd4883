"""Marlin: M665 and M666 of a delta, by what B of M665 is in the printer's version."""

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
    firmware_of,
    not_a_delta,
    trim_notes,
    trims,
)
from pkm_studies.errors import InputError
from pkm_studies.importers import marlin_version
from pkm_studies.importers.marlin_version import RADIUS, ROD_TRIM, MeaningOfB
from pkm_studies.study.tables import ControllerTable

NAME = "marlin"
#: mm by which rods may differ and count as one length: what four decimals hold
ALIKE = 5e-5
FOR = {
    ROD_TRIM: "for Marlin 2.0.6 or later: M665 A, B, C are trims of the rods",
    RADIUS: (
        "for Marlin 1.1.1 to 2.0.5: B of M665 is the radius of calibration there, and is"
        " not written"
    ),
    None: (
        "for Marlin 1.1.1 or later: M665 A, B, C are not written, and must be 0 in 2.0.6"
        " or later"
    ),
}
CHECK = (
    "the version of the printer is not known: on Marlin before 2.0.6, B of M665 is the"
    " radius of calibration, and this file would overwrite it; name the version with"
    " --firmware"
)


def write(compensation: Compensation) -> Texts:
    """Height H of the lowest endstop; M666 holds how far each other one is above it.

    Marlin homes a tower to its endstop, moves down by the adjustment (zero or less),
    and counts the carriage there as that of the tool at height H. Raises InputError for
    versions that lack the words, and for rods that a version cannot have.
    """
    numbers, rods = _numbers(compensation)
    b, is_sure = _meaning_of_b(compensation, rods)
    rod = float(rods.mean())
    lean = numbers.angles - ANGLES
    # the firmware's carriage height at home is H + sqrt(arm^2 - radius^2), tower by tower
    height = float(numbers.endstops.min())
    adjust = height - numbers.endstops
    words = [
        f"M665 L{rod:.4f} R{numbers.radius:.4f} H{height:.4f}"
        f" X{lean[0]:.4f} Y{lean[1]:.4f} Z{lean[2]:.4f}"
    ]
    if b == ROD_TRIM:
        trim = rods - rod
        words.append(f"A{trim[0]:.4f} B{trim[1]:.4f} C{trim[2]:.4f}")
    lines = [f"; {sentence}" for sentence in sentences_of(compensation)]
    lines += [
        " ".join(words),
        f"M666 X{adjust[0]:.4f} Y{adjust[1]:.4f} Z{adjust[2]:.4f}",
        "M500 ; store" if is_sure else "; M500 stores it, once the version is checked",
        "",
    ]
    return {".gcode": "\n".join(lines)}


def notes(compensation: Compensation) -> tuple[str, ...]:
    """Which version the file is for, and what it does not hold. Raises InputError."""
    rods = _numbers(compensation)[1]
    b, is_sure = _meaning_of_b(compensation, rods)
    sentences = [FOR[b]] if is_sure else [FOR[b], CHECK]
    return (*sentences, *trim_notes(compensation, NAME))


def _numbers(compensation: Compensation) -> tuple[DeltaNumbers, Array]:
    """The delta, and its rods (3,) without the trims that are compiled in, mm.

    Raises InputError, also for versions whose M665 has no H and no tower angles.
    """
    known = firmware_of(compensation, NAME)
    version = None if known is None else known.version
    if version is not None and not marlin_version.has_height(version):
        raise InputError(
            f"Marlin {version} has no M665 H (home height) and X, Y, Z (tower angles)",
            "update the firmware to 1.1.1 or later, or set its configuration from the"
            " parameters of --to csv",
            value=f"--to {NAME}",
        )
    numbers = delta_numbers(compensation, NAME)
    return numbers, numbers.arms - trims(compensation, NAME, "rod_trim_mm")


def _meaning_of_b(
    compensation: Compensation, rods: Array
) -> tuple[MeaningOfB | None, bool]:
    """What B of M665 is to be, None where it is not written, and whether that is known.

    Raises InputError for rods (3,) of several lengths where M665 has one.
    """
    known = firmware_of(compensation, NAME)
    b = None if known is None else _stated_meaning(known)
    alike = bool(np.ptp(rods) <= ALIKE)
    if b is None:
        return (None, True) if alike else (ROD_TRIM, False)
    if b == RADIUS and not alike:
        sizes = ", ".join(f"{rod - rods.mean():.4f}" for rod in rods)
        raise InputError(
            "M665 of Marlin before 2.0.6 has one rod length, and the arms differ",
            f"set DELTA_DIAGONAL_ROD_TRIM_TOWER {{ {sizes} }} in its configuration and add"
            " rod_trim_mm to [controller], or hold arm1, arm2, arm3 with fixed",
            value=f"--to {NAME}",
        )
    return b, True


def _stated_meaning(known: ControllerTable) -> MeaningOfB | None:
    """What B of M665 is: as the log had it, else by the version. Raises InputError."""
    if known.m665_b is not None or known.version is None:
        return known.m665_b
    if not marlin_version.numbers(known.version):
        raise InputError(
            "this is no version of Marlin",
            "give it as M115 prints it, such as 2.0.5",
            field="--firmware",
            value=known.version,
        )
    return marlin_version.meaning_of_b(known.version)


def words(text: str, code: str) -> dict[str, list[float]]:
    """Letters and numbers of the first line that starts with a code."""
    line = next(row for row in text.splitlines() if row.startswith(f"{code} "))
    pairs = re.findall(r"([A-Z])(-?[\d.]+(?::-?[\d.]+)*)", line.split(" ", 1)[1])
    return {letter: [float(v) for v in values.split(":")] for letter, values in pairs}


def joints(texts: Texts, compensation: Compensation) -> Array:
    """Travels of a printer with these commands."""
    geometry = words(texts[".gcode"], "M665")
    adjust = words(texts[".gcode"], "M666")
    written = np.array([geometry.get(k, [0.0])[0] for k in "ABC"])
    numbers = DeltaNumbers(
        radius=geometry["R"][0],
        arms=geometry["L"][0] + written + trims(compensation, NAME, "rod_trim_mm"),
        angles=np.array(ANGLES) + [geometry[k][0] for k in "XYZ"],
        endstops=geometry["H"][0] - np.array([adjust[k][0] for k in "XYZ"]),
        trim=trims(compensation, NAME, "radius_trim_mm"),
    )
    return delta_joints(numbers, numbers.carriages, compensation)


controller = ControllerFormat(
    name=NAME,
    about="M665 and M666 of a delta printer, by the version of Marlin, four decimals",
    source="Marlin, src/module/delta.cpp and gcode M665, M666",
    write=write,
    joints=joints,
    unfit=not_a_delta,
    notes=notes,
    versions=True,
)
