"""Klipper: the sections of a delta in printer.cfg."""

import dataclasses

import numpy as np

from oed.base import Array
from pkm_printers import klipper_config, rotary_delta
from pkm_printers.delta_numbers import (
    delta_joints,
    delta_numbers,
    home_notes,
    not_a_delta,
    trims,
)
from pkm_printers.klipper import RADIUS_OFFSET, linear_geometry
from pkm_printers.klipper_rotary import WHERE, rotary_format
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts

NAME, TOWERS = "klipper", "abc"
BED_TILT = (
    "[bed_tilt] raises z by the rise of the bed. Klipper takes either it or [bed_mesh]: with a"
    " mesh leave it out, and probe the mesh anew"
)


def write(compensation: Compensation) -> Texts:
    """The options that calibration changes, with Klipper's six decimals and trims."""
    by_tower = bool(trims(compensation, NAME, "radius_trim_mm").any())
    numbers = delta_numbers(compensation, NAME, by_tower=by_tower)
    lines = [f"# {WHERE}", "", "[printer]", f"delta_radius: {numbers.radius:.6f}"]
    rows = zip(TOWERS, numbers.endstops, numbers.arms, numbers.angles, strict=True)
    for k, (tower, endstop, arm, angle) in enumerate(rows):
        lines += ["", f"[stepper_{tower}]", f"position_endstop: {endstop:.6f}"]
        lines += [f"arm_length: {arm:.6f}", f"angle: {angle:.6f}"]
        if by_tower:
            lines.append(f"{RADIUS_OFFSET}: {numbers.radius_trim[k]:.6f}")
    if numbers.bed_slope.any():
        lines += ["", "[bed_tilt]"]
        rises = zip("xy", numbers.bed_slope, strict=True)
        lines += [f"{axis}_adjust: {rise:.8f}" for axis, rise in rises]
    return {".cfg": compensation.commented("#", lines)}


def notes(compensation: Compensation) -> tuple[str, ...]:
    """What the file does not hold, and what it goes together with."""
    sentences = home_notes(compensation, NAME)
    if delta_numbers(compensation, NAME, by_tower=True).bed_slope.any():
        sentences.append(BED_TILT)
    return tuple(sentences)


def joints(texts: Texts, compensation: Compensation) -> Array:
    """Travels of a printer with this file."""
    config = klipper_config.parse_options(texts[".cfg"])
    slope = [config.number("bed_tilt", f"{a}_adjust", 0.0) for a in "xy"]
    geometry = linear_geometry(config)
    numbers = dataclasses.replace(geometry, bed_slope=np.array(slope))
    return delta_joints(numbers, compensation)


linear_format = ControllerFormat(
    name=NAME,
    about="printer.cfg of a delta or rotary delta: radius, arms, angles, endstops",
    source="Klipper, klippy/kinematics/delta.py and rotary_delta.py",
    write=write,
    joints=joints,
    unfit=not_a_delta,
    notes=notes,
)
controller = linear_format.with_others({rotary_delta.MODEL: rotary_format})
