"""Klipper: the sections of a delta in printer.cfg."""

from __future__ import annotations

import configparser

import numpy as np

from oed.base import Array
from pkm_printers.delta_numbers import (
    delta_joints,
    delta_numbers,
    home_notes,
    not_a_delta,
)
from pkm_printers.delta_study import DeltaGeometry
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts

NAME, TOWERS = "klipper", "abc"
WHERE = (
    "put these values into the sections of your printer.cfg, above the block of"
    " SAVE_CONFIG: there they win over it"
)
BED_TILT = (
    "[bed_tilt] raises z by the rise of the bed. Klipper takes either it or [bed_mesh]: with a"
    " mesh leave it out, and probe the mesh anew"
)


def write(compensation: Compensation) -> Texts:
    """The options that calibration changes, with Klipper's own six decimals."""
    numbers = delta_numbers(compensation, NAME)
    lines = [f"# {sentence}" for sentence in compensation.comments]
    lines.append(f"# {WHERE}")
    lines += ["", "[printer]", f"delta_radius: {numbers.radius:.6f}"]
    rows = zip(TOWERS, numbers.endstops, numbers.arms, numbers.angles, strict=True)
    for tower, endstop, arm, angle in rows:
        lines += ["", f"[stepper_{tower}]", f"position_endstop: {endstop:.6f}"]
        lines += [f"arm_length: {arm:.6f}", f"angle: {angle:.6f}"]
    if numbers.bed_slope.any():
        lines += ["", "[bed_tilt]"]
        rises = zip("xy", numbers.bed_slope, strict=True)
        lines += [f"{axis}_adjust: {rise:.8f}" for axis, rise in rises]
    return {".cfg": "\n".join([*lines, ""])}


def notes(compensation: Compensation) -> tuple[str, ...]:
    """What the file does not hold, and what it goes together with."""
    sentences = home_notes(compensation, NAME)
    if delta_numbers(compensation, NAME).bed_slope.any():
        sentences.append(BED_TILT)
    return tuple(sentences)


def joints(texts: Texts, compensation: Compensation) -> Array:
    """Travels of a printer with this file."""
    parser = configparser.ConfigParser()
    parser.read_string(texts[".cfg"])

    def read(option: str) -> Array:
        return np.array([parser.getfloat(f"stepper_{t}", option) for t in TOWERS])

    numbers = DeltaGeometry(
        radius=parser.getfloat("printer", "delta_radius"),
        arms=read("arm_length"),
        angles=read("angle"),
        endstops=read("position_endstop"),
        bed_slope=np.array(
            [parser.getfloat("bed_tilt", f"{a}_adjust", fallback=0.0) for a in "xy"]
        ),
    )
    return delta_joints(numbers, compensation)


controller = ControllerFormat(
    name=NAME,
    about="printer.cfg of a delta printer: radius, arms, tower angles, endstops",
    source="Klipper, klippy/kinematics/delta.py",
    write=write,
    joints=joints,
    unfit=not_a_delta,
    notes=notes,
)
