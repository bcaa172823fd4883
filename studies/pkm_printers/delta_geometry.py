"""A linear delta as its firmware knows it: tool heights and carriage travels, mm and degrees."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from oed import units
from oed.base import Array

MODEL = "delta_printer"
TOWERS = (1, 2, 3)
#: angles of the towers from which firmwares count corrections, degrees
TOWER_ANGLES = np.array([210.0, 330.0, 90.0])
WIDTH_SHARE = 0.8  #: half the workspace's width over the delta's radius, at least
#: parameters that a firmware frees with a number of factors: endstops, radius, angles of
#: two towers, length of the rods, slopes of the bed
ENDSTOPS = ("endstop1", "endstop2", "endstop3")
ANGLES = ("angle1", "angle2")
ARMS = ("arm1", "arm2", "arm3")
SLOPES = ("bed_slope_x", "bed_slope_y")
FACTORS: Mapping[int, tuple[str, ...]] = {
    3: ENDSTOPS,
    4: (*ENDSTOPS, "radius"),
    6: (*ENDSTOPS, "radius", *ANGLES),
    7: (*ENDSTOPS, "radius", *ANGLES, *ARMS),
    8: (*ENDSTOPS, "radius", *ANGLES, *SLOPES),
    9: (*ENDSTOPS, "radius", *ANGLES, *ARMS, *SLOPES),
}
#: what tilts the effector, which only a probe beside the nozzle reads: differences of the
#: rods of a pair, turns of the carriages
TILTING = ("pair1", "pair2", "pair3", "turn1", "turn2", "turn3")
#: all parameters of the model
PARAMETERS = (
    *("radius", *ARMS, *ANGLES, "angle3", *ENDSTOPS),
    *("trim1", "trim2", "trim3", *SLOPES, *TILTING),
)
#: standard deviations of an assembled printer's numbers about those of its firmware
TOLERANCES = """\
# How far the true numbers may be from those of the firmware (standard deviations).
[[prior.tolerance]]
parameters = ["radius*", "endstop*"]
sigma_mm = 5.0

[[prior.tolerance]]
parameters = ["arm*"]
sigma_mm = 5.0

[[prior.tolerance]]
parameters = ["angle*"]
sigma_deg = 2.0
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class DeltaGeometry:
    """A delta as its firmware knows it; mm and deg, as in the firmware's files."""

    model: ClassVar[str] = MODEL
    about: ClassVar[str] = "delta printer"
    parameters: ClassVar[tuple[str, ...]] = PARAMETERS
    of_heights: ClassVar[tuple[str, ...]] = FACTORS[6]
    lengths: ClassVar[tuple[str, ...]] = ARMS
    tilting: ClassVar[tuple[str, ...]] = TILTING
    tolerances: ClassVar[str] = TOLERANCES
    unit: ClassVar[str] = "mm"

    radius: float  #: from the middle to a carriage, less the platform's radius
    arms: Array  #: arm lengths (3,)
    angles: Array  #: of the towers (3,), counter-clockwise from x
    endstops: Array  #: height (3,) of the tool over the bed at each endstop
    #: (3,) what each tower adds to the radius
    radius_trim: Array = dataclasses.field(default_factory=lambda: np.zeros(3))
    #: (2,) what the firmware adds to z along x and y, mm/mm
    bed_slope: Array = dataclasses.field(default_factory=lambda: np.zeros(2))

    @property
    def radii(self) -> Array:
        """Radius (3,) of each tower."""
        return self.radius + self.radius_trim

    @property
    def half_width(self) -> float:
        """Half the width, mm, that the workspace has at least."""
        return WIDTH_SHARE * self.radius

    @property
    def stop(self) -> float:
        """Height, mm, of the tool at the lowest switch."""
        return float(min(self.endstops))

    @property
    def travel(self) -> float:
        """Largest travel of a carriage, mm."""
        return round(float(max(self.endstops) + max(self.arms)), 1)

    def towers(self) -> tuple[Array, Array]:
        """Places (3, 2) of the towers, and heights (3,) of the carriages at the endstops."""
        angle = np.radians(self.angles)
        radii = np.asarray(self.radii)
        feet = radii[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        return feet, self.endstops + np.sqrt(self.arms**2 - radii**2)

    def tool_heights(self, joints: Array) -> Array:
        """Heights (n,) of the tool, mm, at travels (n, 3) down; NaN out of reach."""
        feet, top = self.towers()
        places = np.broadcast_to(feet, (len(joints), 3, 2))
        return lower_heights(np.dstack([places, top - joints]), self.arms)

    def table(self) -> str:
        """The table [machine.nominal] of a study."""
        numbers: dict[str, float | Array] = {
            "radius_mm": self.radius,
            "arm_mm": self.arms,
            "angle_deg": self.angles,
            "endstop_mm": self.endstops,
        }
        if any(self.radius_trim):
            numbers["trim_mm"] = self.radius_trim
        for name, slope in zip(SLOPES, self.bed_slope.tolist(), strict=True):
            if slope:
                numbers[f"{name}_ppm"] = slope / units.PPM
        return nominal_table(numbers)

    def sentence(self) -> str:
        """The geometry in words."""
        radius = f"radius {self.radius:g} mm"
        if any(self.radius_trim):
            radius = f"radii {listed(self.radii)} mm"
        return (
            f"Machine: delta, {radius}, arms {listed(self.arms)} mm, towers at"
            f" {listed(self.angles)} deg, endstops at {listed(self.endstops)} mm."
        )

    def changed(self, change: Array) -> DeltaGeometry:
        """A delta with other radius, angles of two towers and endstops (6,), mm and deg."""
        radius, first, second, *endstops = map(float, change)
        return dataclasses.replace(
            self,
            radius=self.radius + radius,
            angles=self.angles + np.array([first, second, 0.0]),
            endstops=self.endstops + endstops,
        )

    def travels(self, commands: Array) -> Array:
        """Travels (n, 3) down from the endstops at commands (n, 3), z from the bed, mm."""
        feet, top = self.towers()
        places = commands[:, :2]
        across = ((places[:, None] - feet) ** 2).sum(axis=2)
        raised = commands[:, 2] + places @ self.bed_slope
        return np.asarray(top - np.sqrt(self.arms**2 - across) - raised[:, None])


def nominal_table(numbers: Mapping[str, float | Array]) -> str:
    """The table [machine.nominal] of numbers, and of arrays (3,), one a tower."""
    lines = ["[machine.nominal]"]
    for name, value in numbers.items():
        if isinstance(value, float):
            lines.append(f"{name} = {value!r}")
            continue
        stem, unit = name.rsplit("_", 1)
        pairs = zip(TOWERS, value.tolist(), strict=True)
        lines += [f"{stem}{i}_{unit} = {v!r}" for i, v in pairs]
    return "\n".join([*lines, ""])


def listed(values: Array) -> str:
    """Numbers in words."""
    return ", ".join(f"{value:g}" for value in values)


@np.errstate(all="ignore")
def lower_heights(centres: Array, lengths: Array) -> Array:
    """Heights (n,) of lower points, lengths (3,) from centres (n, 3, 3); NaN for none."""
    # |t - c_i|^2 = a_i^2: differences are linear in t, which leaves a line
    steps = 2.0 * (centres[:, 1:] - centres[:, :1])
    size = (centres**2).sum(axis=2) - lengths**2
    across = steps[:, :, :2]
    determinant = np.linalg.det(across)
    # centres at one angle, or numbers beyond all sizes, give no tool
    is_usable = np.isfinite(determinant) & (np.abs(determinant) >= 1e-9)
    across = np.where(is_usable[:, None, None], across, np.nan)
    inverse = np.linalg.inv(across)
    base = np.einsum("nij,nj->ni", inverse, size[:, 1:] - size[:, :1])
    slope = -np.einsum("nij,nj->ni", inverse, steps[:, :, 2])
    # t = (base + slope z, z) on the sphere of the first centre
    offset = base - centres[:, 0, :2]
    height = centres[:, 0, 2]
    a = (slope**2).sum(axis=1) + 1.0
    b = (slope * offset).sum(axis=1) - height
    c = (offset**2).sum(axis=1) + height**2 - lengths[0] ** 2
    # the square root of what is below zero is not a number: out of reach
    return np.asarray((-b - np.sqrt(b * b - a * c)) / a)
