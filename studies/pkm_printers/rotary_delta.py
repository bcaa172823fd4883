"""Rotary deltas as their firmwares know them, and what a study identifies of them.

Limb i, at angle a_i, has its shoulder at radius R and height H, its upper arm u_i at t_i
over the horizontal, and the tool (x, y, z) at the end of its lower arm l_i. With d = x cos
a_i + y sin a_i - R outward, s = y cos a_i - x sin a_i across and h = z - H up,

    (d - u cos t)^2 + s^2 + (h - u sin t)^2 = l^2,   the knee outward.
"""

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from oed import units
from oed.base import Array
from pkm_printers.delta_geometry import (
    ANGLES,
    ENDSTOPS,
    TOWERS,
    listed,
    lower_heights,
    nominal_table,
)
from pkm_studies.catalogue import Compensation

MODEL = "rotary_delta_printer"
LENGTHS = tuple(f"{stem}{i}" for stem in ("upper", "lower") for i in TOWERS)
#: parameters that a firmware frees with a number of factors
FACTORS: Mapping[int, tuple[str, ...]] = {
    3: ENDSTOPS,
    4: (*ENDSTOPS, "height"),
    5: (*ENDSTOPS, "height", "radius"),
    7: (*ENDSTOPS, "height", "radius", *ANGLES),
}
MAX_ARM_TURN_DEG = 180.0  #: largest turn of an upper arm from its switch, degrees
#: standard deviations of an assembled printer's numbers about those of its firmware
TOLERANCES = """\
# How far the true numbers may be from those of the firmware (standard deviations).
[[prior.tolerance]]
parameters = ["height"]
sigma_mm = 5.0

[[prior.tolerance]]
parameters = ["radius", "upper*", "lower*"]
sigma_mm = 1.0

[[prior.tolerance]]
parameters = ["angle*", "endstop*"]
sigma_deg = 2.0
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RotaryGeometry:
    """A rotary delta; mm and deg, as in the firmware's files.

    radius, height  of the shoulders, less the effector's
    upper, lower    lengths (3,) of the arms
    angles          of the limbs (3,), counter-clockwise from x
    endstops        (3,) angles over the horizontal of the upper arms at the switches
    """

    model: ClassVar[str] = MODEL
    about: ClassVar[str] = "rotary delta printer"
    parameters: ClassVar[tuple[str, ...]] = (
        *("radius", "height", *ANGLES, "angle3"),
        *(*LENGTHS, *ENDSTOPS),
    )
    of_heights: ClassVar[tuple[str, ...]] = FACTORS[7]
    lengths: ClassVar[tuple[str, ...]] = LENGTHS
    tilting: ClassVar[tuple[str, ...]] = ()
    tolerances: ClassVar[str] = TOLERANCES
    unit: ClassVar[str] = "deg"
    half_width: ClassVar[float] = 0.0
    travel: ClassVar[float] = MAX_ARM_TURN_DEG

    radius: float
    height: float
    upper: Array
    lower: Array
    angles: Array
    endstops: Array

    @property
    def stop_heights(self) -> Array:
        """Heights (3,) of a tool on the middle axis whose upper arm is at its switch, mm."""
        angle = np.radians(self.endstops)
        outward = self.radius + self.upper * np.cos(angle)
        knee = self.height + self.upper * np.sin(angle)
        return np.asarray(knee - np.sqrt(self.lower**2 - outward**2))

    @property
    def stop(self) -> float:
        """Height, mm, of the tool at the lowest switch."""
        return float(self.stop_heights.min())

    @np.errstate(invalid="ignore")
    def arm_angles(self, commands: Array) -> Array:
        """Angles (n, 3) of the upper arms at commands (n, 3), deg; NaN out of reach."""
        angle = np.radians(self.angles)
        cos, sin = np.cos(angle), np.sin(angle)
        x, y = commands[:, :1], commands[:, 1:2]
        outward, across = x * cos + y * sin - self.radius, y * cos - x * sin
        up = commands[:, 2:] - self.height
        reach = np.hypot(outward, up)
        square = reach**2 + across**2 + self.upper**2 - self.lower**2
        turn = np.arccos(square / (2.0 * self.upper * reach))
        return np.asarray(np.degrees(np.arctan2(up, outward) + turn))

    def tool_heights(self, joints: Array) -> Array:
        """Heights (n,) of the tool, mm, at turns (n, 3) down, deg; NaN out of reach."""
        turns = np.where(np.abs(joints) < MAX_ARM_TURN_DEG, joints, np.nan)
        angle = np.radians(self.endstops - turns)
        outward = self.radius + self.upper * np.cos(angle)
        limb = np.radians(self.angles)
        knees = np.dstack(
            [
                outward * np.cos(limb),
                outward * np.sin(limb),
                self.height + self.upper * np.sin(angle),
            ]
        )
        return lower_heights(knees, self.lower)

    def table(self) -> str:
        """The table [machine.nominal] of a study."""
        return nominal_table(
            {
                "radius_mm": self.radius,
                "height_mm": self.height,
                "angle_deg": self.angles,
                "upper_mm": self.upper,
                "lower_mm": self.lower,
                "endstop_deg": self.endstops,
            }
        )

    def sentence(self) -> str:
        """The geometry in words."""
        return (
            f"Machine: rotary delta, shoulders at radius {self.radius:g} mm and height"
            f" {self.height:g} mm, upper arms {listed(self.upper)} mm,"
            f" lower arms {listed(self.lower)} mm, limbs at {listed(self.angles)} deg,"
            f" switches at {listed(self.endstops)} deg over the horizontal."
        )


def identified_geometry(compensation: Compensation) -> RotaryGeometry:
    """The identified rotary delta."""

    def read(stem: str, unit: str) -> Array:
        values = [compensation.parameter(f"{stem}{i}") for i in TOWERS]
        return units.from_si(values, unit)

    return RotaryGeometry(
        radius=units.number(compensation.parameter("radius"), "mm"),
        height=units.number(compensation.parameter("height"), "mm"),
        angles=read("angle", "deg"),
        upper=read("upper", "mm"),
        lower=read("lower", "mm"),
        endstops=read("endstop", "deg"),
    )


def rotary_joints(geometry: RotaryGeometry, compensation: Compensation) -> Array:
    """Turns (n, 3) down from the switches, rad, by the formula of the firmwares."""
    commands = units.from_si(compensation.command, "mm")
    return np.radians(geometry.endstops - geometry.arm_angles(commands))
