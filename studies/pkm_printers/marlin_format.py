"""Marlin: M665 and M666 of a delta, by what the printer's version does with them."""

import dataclasses
import re

import numpy as np

from oed.base import Array
from pkm_printers import marlin_version
from pkm_printers.delta_geometry import TOWER_ANGLES, DeltaGeometry
from pkm_printers.delta_numbers import (
    NOT_KNOWN,
    check_level,
    delta_joints,
    delta_numbers,
    firmware_of,
    not_a_delta,
    trim_notes,
    trims,
)
from pkm_printers.marlin_version import (
    MIN_STEPS,
    NOT_READ,
    RADIUS,
    ROD_TRIM,
    TENTH_MM,
    VERSIONS,
    MeaningOfB,
    PossibleRules,
)
from pkm_studies.base import InputError
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts
from pkm_studies.tables import ControllerTable

NAME = "marlin"
#: mm by which rods may differ and count as one length: what four decimals hold
ROD_LENGTH_TOLERANCE_MM = 5e-5
#: mm that each tower goes down from its switch at least: versions make no move for a
#: value of up to six steps
MIN_DOWN = 0.2
FOR: dict[MeaningOfB | None, str] = {
    ROD_TRIM: (
        f"for Marlin {VERSIONS[ROD_TRIM]}: M665 A, B, C are trims of the rods there"
    ),
    RADIUS: (
        f"for Marlin {VERSIONS[RADIUS]}: B of M665 is the radius of calibration there, and"
        " is not written"
    ),
    NOT_READ: f"for Marlin {VERSIONS[NOT_READ]}: its M665 has no A, B, C",
    None: (
        "for Marlin 1.1.0 or later: M665 A, B, C are not written, and must be 0 in"
        f" {VERSIONS[ROD_TRIM]}"
    ),
}
CHECK = (
    "the version of the printer is not known: on Marlin 1.1.0 to 1.1.9, B of M665 is the"
    " radius of calibration, and this file would overwrite it; name the version with"
    " --firmware"
)
HOME = (
    "M665 H is the height of the nozzle at home. With a probe, Marlin 1.1.9.1, 2.0.0 and"
    " later need M851 Z added to it, so Z-2.5 makes H less by 2.5"
)
STEPS = (
    f"Marlin goes {MIN_STEPS + 1} steps of the motor further from the switches: take"
    " them off H"
)


@dataclasses.dataclass(frozen=True)
class _Target:
    """The firmware that is written for."""

    b: MeaningOfB | None  #: what M665 B is to be; None where it is not written
    is_sure: bool  #: whether that is known
    home_offset: float  #: height of the nozzle at home over M665 H, mm
    home_notes: tuple[str, ...]  #: what is not known of it
    down: float  #: mm that each tower goes down from its switch at least


def write(compensation: Compensation) -> Texts:
    """Height H, and M666 with what each tower goes down from its switch.

    Marlin homes a tower to its endstop, moves down by the adjustment (below zero), and
    counts the carriage there as that of the tool at home. Raises InputError for versions
    that lack the words, and for rods that a version cannot have.
    """
    numbers, rods = _numbers(compensation)
    check_level(compensation, numbers, "Marlin")
    target = _target(compensation, rods)
    rod = float(rods.mean())
    lean = numbers.angles - TOWER_ANGLES
    # the firmware's carriage height at home is that of the tool there, tower by tower
    height = float(numbers.endstops.min()) - target.down
    adjust = height - numbers.endstops
    phrases = [
        f"M665 L{rod:.4f} R{numbers.radius:.4f} H{height - target.home_offset:.4f}"
        f" X{lean[0]:.4f} Y{lean[1]:.4f} Z{lean[2]:.4f}"
    ]
    if target.b == ROD_TRIM:
        trim = rods - rod
        phrases.append(f"A{trim[0]:.4f} B{trim[1]:.4f} C{trim[2]:.4f}")
    store = "M500 ; store" if target.is_sure else "; M500 stores it, once it is checked"
    stops = f"M666 X{adjust[0]:.4f} Y{adjust[1]:.4f} Z{adjust[2]:.4f}"
    lines = [" ".join(phrases), stops, store]
    return {".gcode": compensation.commented(";", lines)}


def notes(compensation: Compensation) -> tuple[str, ...]:
    """Which version the file is for, and what it does not hold. Raises InputError."""
    target = _target(compensation, _numbers(compensation)[1])
    sentences = [FOR[target.b]] if target.is_sure else [FOR[target.b], CHECK]
    return (*sentences, *target.home_notes, *trim_notes(compensation, NAME))


def _numbers(compensation: Compensation) -> tuple[DeltaGeometry, Array]:
    """The delta, and its rods (3,) less compiled-in trims, mm. Raises InputError."""
    firmware = firmware_of(compensation, NAME)
    version = None if firmware is None else firmware.version
    if marlin_version.possible_rules(version).agreed("has_height") is False:
        raise InputError(
            f"Marlin {version} has no M665 H (home height) and X, Y, Z (tower angles)",
            "update the firmware to 1.1.0 or later, or set its configuration from the"
            " parameters of --to csv",
            value=f"--to {NAME}",
        )
    numbers = delta_numbers(compensation, NAME)
    return numbers, numbers.arms - trims(compensation, NAME, "rod_trim_mm")


def _target(compensation: Compensation, rods: Array) -> _Target:
    """The firmware that is written for. Raises InputError for several rods (3,) on one L."""
    firmware = firmware_of(compensation, NAME)
    rules = _rules(firmware)
    b: MeaningOfB | None = None if firmware is None else rules.agreed("b")
    offset, home_notes = _home(firmware, rules)
    steps = None if firmware is None else firmware.steps_per_mm
    down = max(MIN_DOWN, 2.0 * marlin_version.dead_band(steps)) if steps else MIN_DOWN
    alike = bool(np.ptp(rods) <= ROD_LENGTH_TOLERANCE_MM)
    if b in (RADIUS, NOT_READ) and not alike:
        sizes = ", ".join(f"{rod - rods.mean():.4f}" for rod in rods)
        raise InputError(
            "M665 of Marlin before 2.0.6 has one rod length, and the arms differ",
            f"set DELTA_DIAGONAL_ROD_TRIM_TOWER {{ {sizes} }} in its configuration and add"
            " rod_trim_mm to [controller], or hold arm1, arm2, arm3 with fixed",
            value=f"--to {NAME}",
        )
    is_sure = b is not None or alike
    written = b if b is not None or alike else ROD_TRIM
    return _Target(written, is_sure, offset, home_notes, down)


def _rules(firmware: ControllerTable | None) -> PossibleRules:
    """What the version does, and M665 B as the log had it. Raises InputError."""
    if firmware is None or firmware.version is None:
        rules = marlin_version.EVERY
    elif not marlin_version.numbers(firmware.version):
        raise InputError(
            "this is no version of Marlin",
            "give it as M115 prints it, such as 2.0.5",
            field="--firmware",
            value=firmware.version,
        )
    else:
        rules = marlin_version.possible_rules(firmware.version)
    rules = rules.where(has_height=True)
    if firmware is None or firmware.m665_b is None:
        return rules
    stated = rules.where(b=firmware.m665_b)
    if stated.agreed("b") == firmware.m665_b:
        return stated
    return marlin_version.EVERY.where(b=firmware.m665_b, has_height=True)


def _home(
    firmware: ControllerTable | None, rules: PossibleRules
) -> tuple[float, tuple[str, ...]]:
    """Height of the nozzle at home over M665 H, mm, and what is not known of it."""
    stated = None if firmware is None else firmware.home_offset_mm
    if stated == NOT_KNOWN:
        # the study has the height of M665 H, whatever that is in the version
        return 0.0, ()
    if firmware is not None and stated is not None:
        offset = marlin_version.home_offset(
            rules, firmware.probe_z_mm, firmware.steps_per_mm
        )
        return (stated if offset is None else offset), ()
    sentences = [HOME] if rules.agreed("counts_to_probe") is not False else []
    retreat = rules.agreed("retreat")
    if retreat == "steps":
        sentences.append(STEPS)
    return (TENTH_MM if retreat == "tenth" else 0.0), tuple(sentences)


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
    firmware = firmware_of(compensation, NAME)
    home = geometry["H"][0] + _home(firmware, _rules(firmware))[0]
    numbers = DeltaGeometry(
        radius=geometry["R"][0],
        arms=geometry["L"][0] + written + trims(compensation, NAME, "rod_trim_mm"),
        angles=TOWER_ANGLES + [geometry[k][0] for k in "XYZ"],
        endstops=home - np.array([adjust[k][0] for k in "XYZ"]),
        radius_trim=trims(compensation, NAME, "radius_trim_mm"),
    )
    return delta_joints(numbers, compensation)


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
