"""Numbers that the firmwares of delta printers share, in mm and degrees."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed import units
from oed.arrays import Array
from oed.machine import Machine
from pkm_studies.compensation.content import Compensation

TOWERS = (1, 2, 3)
#: angles of the towers from which firmwares count corrections, degrees
ANGLES = (210.0, 330.0, 90.0)


@dataclasses.dataclass(frozen=True)
class DeltaNumbers:
    """Radius, arms (3,), tower angles (3,) and heights of the endstops (3,), mm, deg.

    The height of an endstop is the tool's where all carriages stand as this one does.
    """

    radius: float
    arms: Array
    angles: Array
    endstops: Array

    @property
    def carriages(self) -> Array:
        """Heights (3,) of the carriages at their endstops."""
        return np.asarray(self.endstops + np.sqrt(self.arms**2 - self.radius**2))


def delta_numbers(compensation: Compensation) -> DeltaNumbers:
    """The identified delta."""

    def read(name: str, unit: str) -> Array:
        values = [compensation.parameter(f"{name}{i}") for i in TOWERS]
        return units.from_si(values, unit)

    return DeltaNumbers(
        radius=units.number(compensation.parameter("radius"), "mm"),
        arms=read("arm", "mm"),
        angles=read("angle", "deg"),
        endstops=read("endstop", "mm"),
    )


def delta_joints(
    numbers: DeltaNumbers, carriages: Array, compensation: Compensation
) -> Array:
    """Travels (n, 3) down from the endstops, m, by the formula of delta firmwares.

    carriages  (3,) heights of the carriages at their endstops, mm
    """
    point = units.from_si(compensation.command, "mm")
    angle = units.to_si(numbers.angles, "deg")
    tower = numbers.radius * np.column_stack([np.cos(angle), np.sin(angle)])
    across = ((point[:, None, :2] - tower) ** 2).sum(axis=2)
    height = point[:, 2:] + np.sqrt(numbers.arms**2 - across)
    return units.to_si(carriages - height, "mm")


def not_a_delta(machine: Machine) -> str | None:
    """Why a machine is no linear delta with a parameter for each tower."""
    wanted = {"radius"}
    wanted |= {f"{name}{i}" for name in ("arm", "angle", "endstop") for i in TOWERS}
    if {p.name for p in machine.parameters} == wanted:
        return None
    return "it writes linear deltas (radius, arms, tower angles, endstops)"
