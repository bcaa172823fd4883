"""Smoothieware: M665 and M666 of a delta, with radii, angles and rods by tower."""

import numpy as np

from oed.base import Array
from pkm_printers.delta_geometry import TOWER_ANGLES, DeltaGeometry
from pkm_printers.delta_numbers import (
    check_level,
    delta_joints,
    delta_numbers,
    firmware_of,
    home_notes,
    not_a_delta,
)
from pkm_printers.marlin_format import words
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts

NAME = "smoothie"
#: letters of M665 for the trims of radii, angles and rods by tower
RADII, TURNS, RODS = "ABC", "DEH", "IJK"


def write(compensation: Compensation) -> Texts:
    """Z at home, and M666 trims below 0. Raises InputError for a bed that leans."""
    numbers = delta_numbers(compensation, NAME, by_tower=True)
    check_level(compensation, numbers, "Smoothieware")
    rod, height = float(numbers.arms.mean()), float(numbers.endstops.min())
    values = {
        "L": rod,
        "R": numbers.radius,
        "Z": height - _home_offset(compensation),
        **dict(zip(RADII, numbers.radius_trim, strict=True)),
        **dict(zip(TURNS, numbers.angles - TOWER_ANGLES, strict=True)),
        **dict(zip(RODS, numbers.arms - rod, strict=True)),
    }
    trims = dict(zip("XYZ", height - numbers.endstops, strict=True))
    lines = [
        " ".join([name, *(f"{k}{v:.4f}" for k, v in setting.items())])
        for name, setting in (("M665", values), ("M666", trims))
    ]
    return {".g": compensation.commented(";", [*lines, "M500 ; store"])}


def _home_offset(compensation: Compensation) -> float:
    """M206 Z, which stays, mm."""
    firmware = firmware_of(compensation, NAME)
    offset = None if firmware is None else firmware.home_offset_mm
    return offset if isinstance(offset, float) else 0.0


def notes(compensation: Compensation) -> tuple[str, ...]:
    """What the file does not hold."""
    is_recognised = firmware_of(compensation, NAME) is not None
    sentence = "M206 Z must be 0: it adds to the height at home"
    return (*([] if is_recognised else [sentence]), *home_notes(compensation, NAME))


def joints(texts: Texts, compensation: Compensation) -> Array:
    """Travels of a printer with these commands."""
    geometry, trims = (words(texts[".g"], name) for name in ("M665", "M666"))

    def read(letters: str) -> Array:
        return np.array([geometry[letter][0] for letter in letters])

    height = geometry["Z"][0] + _home_offset(compensation)
    numbers = DeltaGeometry(
        radius=geometry["R"][0],
        arms=geometry["L"][0] + read(RODS),
        angles=TOWER_ANGLES + read(TURNS),
        endstops=height - np.array([trims[axis][0] for axis in "XYZ"]),
        radius_trim=read(RADII),
    )
    return delta_joints(numbers, compensation)


controller = ControllerFormat(
    name=NAME,
    about="Smoothieware's M665 and M666 of a delta printer, radii and rods by tower",
    source="Smoothieware, LinearDeltaSolution.cpp and Endstops.cpp",
    write=write,
    joints=joints,
    unfit=not_a_delta,
    notes=notes,
)
