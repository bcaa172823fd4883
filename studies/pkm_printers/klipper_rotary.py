"""Klipper: a rotary delta in printer.cfg, in and out.

`position_endstop` is the height of a tool on the middle axis whose upper arm is at its
switch, so that its angle there follows from the other numbers. Steps are those of the last
gear: `rotation_distance` is a full turn, which the file does not state. (`RotaryDelta` in
klippy/kinematics/rotary_delta.py, `parse_step_distance` in klippy/stepper.py.)
"""

import dataclasses
from typing import Final

import numpy as np

from oed.base import Array
from pkm_printers import klipper_config
from pkm_printers.klipper_account import PRINTER, STEPPER, WORDS
from pkm_printers.klipper_config import KlipperConfig
from pkm_printers.rotary_delta import RotaryGeometry, identified_geometry, rotary_joints
from pkm_printers.words import READ, Word, WordTable, refused, same
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts

KINEMATICS: Final = "rotary_delta"
LIMBS: Final = "abc"
STEPPERS: Final = tuple(f"stepper_{limb}" for limb in LIMBS)
#: angles of the limbs that a file leaves out, degrees
USUAL_ANGLES: Final = (30.0, 150.0, 270.0)
WITHOUT: Final = (
    *("rotation_distance", "step_distance"),
    *("arm_length", "delta_radius_offset"),
)
ROTARY_STEPPER: Final[dict[str, Word]] = {
    **{option: word for option, word in STEPPER.items() if option not in WITHOUT},
    **same(READ, ("upper_arm_length", "lower_arm_length")),
    **same(
        refused(
            "Klipper takes no such option for a rotary delta, and does not start with it",
            "state gear_ratio, and remove this one",
        ),
        ("rotation_distance", "step_distance"),
    ),
}
#: words of a rotary delta's file
ROTARY_WORDS: Final[WordTable] = {
    **WORDS,
    "[printer]": {
        **{k: word for k, word in PRINTER.items() if k != "delta_radius"},
        **same(READ, ("shoulder_radius", "shoulder_height")),
    },
    **{f"[{stepper}]": ROTARY_STEPPER for stepper in STEPPERS},
}
WHERE: Final = (
    "put these values into the sections of your printer.cfg, above the block of"
    " SAVE_CONFIG: there they win over it"
)


def rotary_geometry(config: KlipperConfig) -> RotaryGeometry:
    """The geometry in use; limbs b and c default to limb a. Raises InputError."""

    def lengths(option: str) -> Array:
        first = config.positive(STEPPERS[0], option)
        return np.array([config.positive(s, option, first) for s in STEPPERS])

    stop = config.number(STEPPERS[0], "position_endstop")
    heights = [config.number(s, "position_endstop", stop) for s in STEPPERS]
    pairs = zip(STEPPERS, USUAL_ANGLES, strict=True)
    geometry = RotaryGeometry(
        radius=config.positive("printer", "shoulder_radius"),
        height=config.positive("printer", "shoulder_height"),
        upper=lengths("upper_arm_length"),
        lower=lengths("lower_arm_length"),
        angles=np.array([config.number(s, "angle", angle) for s, angle in pairs]),
        endstops=np.zeros(3),
    )
    ends = geometry.arm_angles(np.column_stack([np.zeros((3, 2)), heights]))
    if not np.isfinite(np.diagonal(ends)).all():
        raise config.entries[STEPPERS[0], "position_endstop"].error(
            f"[{STEPPERS[0]}] position_endstop",
            "the arms do not reach this height over the middle of the bed",
            "correct it, shoulder_height or the lengths of the arms",
        )
    return dataclasses.replace(geometry, endstops=np.diagonal(ends))


def _write(compensation: Compensation) -> Texts:
    """The options that calibration changes, with Klipper's own six decimals."""
    geometry = identified_geometry(compensation)
    lines = [f"# {WHERE}", "", "[printer]", f"shoulder_radius: {geometry.radius:.6f}"]
    lines.append(f"shoulder_height: {geometry.height:.6f}")
    for k, stepper in enumerate(STEPPERS):
        options = {
            "angle": geometry.angles[k],
            "upper_arm_length": geometry.upper[k],
            "lower_arm_length": geometry.lower[k],
            "position_endstop": geometry.stop_heights[k],
        }
        lines += ["", f"[{stepper}]", *(f"{o}: {v:.6f}" for o, v in options.items())]
    return {".cfg": compensation.commented("#", lines)}


def _joints(texts: Texts, compensation: Compensation) -> Array:
    geometry = rotary_geometry(klipper_config.parse_options(texts[".cfg"]))
    return rotary_joints(geometry, compensation)


rotary_format = ControllerFormat(
    name="klipper",
    about="printer.cfg of a rotary delta printer",
    source="Klipper, klippy/kinematics/rotary_delta.py",
    write=_write,
    joints=_joints,
)
