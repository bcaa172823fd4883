"""Heights of a delta's tool over carriage travels, for numbers in mm and degrees."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array
from pkm_printers.delta_study import DeltaGeometry


def changed(geometry: DeltaGeometry, change: Array) -> DeltaGeometry:
    """A delta with other radius, angles of two towers and endstops (6,), mm and deg."""
    radius, first, second, *endstops = map(float, change)
    angles = geometry.angles
    return dataclasses.replace(
        geometry,
        radius=geometry.radius + radius,
        angles=(angles[0] + first, angles[1] + second, angles[2]),
        endstops=tuple(
            stop + more for stop, more in zip(geometry.endstops, endstops, strict=True)
        ),
    )


def travels_to_bed(places: Array, geometry: DeltaGeometry) -> Array:
    """Travels (n, 3) down from the endstops to z = 0 along the towers at places (n, 2), mm."""
    feet, top = _towers(geometry)
    across = ((places[:, None] - feet) ** 2).sum(axis=2)
    return np.asarray(top - np.sqrt(np.asarray(geometry.arms) ** 2 - across))


def travels(commands: Array, geometry: DeltaGeometry) -> Array:
    """Travels (n, 3) at commands (n, 3), whose z counts from the firmware's bed, mm."""
    raised = commands[:, 2] + commands[:, :2] @ np.asarray(geometry.bed_slope)
    return np.asarray(travels_to_bed(commands[:, :2], geometry) - raised[:, None])


@np.errstate(all="ignore")
def tool_heights(travels: Array, geometry: DeltaGeometry) -> Array:
    """Heights (n,) of the tool, mm: the lower point at the arms' lengths of the carriages.

    travels  (n, 3) down from the endstops, mm

    NaN where the arms cannot reach it.
    """
    feet, top = _towers(geometry)
    arms = np.asarray(geometry.arms)
    height = top - travels
    # |t - c_i|^2 = a_i^2: differences are linear in t, which leaves a line along z
    # towers at one angle, or numbers beyond all sizes, give no tool
    across = 2.0 * (feet[1:] - feet[0])
    size = (feet**2).sum(axis=1) + height**2 - arms**2
    determinant = np.linalg.det(across)
    if not np.isfinite(determinant) or abs(determinant) < 1e-9:
        return np.full(len(travels), np.nan)
    inverse = np.linalg.inv(across)
    base = (size[:, 1:] - size[:, :1]) @ inverse.T
    slope = -2.0 * (height[:, 1:] - height[:, :1]) @ inverse.T
    # t = (base + slope z, z) on the sphere of the first carriage
    offset = base - feet[0]
    a = (slope**2).sum(axis=1) + 1.0
    b = (slope * offset).sum(axis=1) - height[:, 0]
    c = (offset**2).sum(axis=1) + height[:, 0] ** 2 - arms[0] ** 2
    # the square root of what is below zero is not a number: out of reach
    return np.asarray((-b - np.sqrt(b * b - a * c)) / a)


def _towers(geometry: DeltaGeometry) -> tuple[Array, Array]:
    """Places (3, 2) of the towers, and heights (3,) of the carriages at the endstops."""
    angle = np.radians(geometry.angles)
    arms, radii = np.asarray(geometry.arms), np.asarray(geometry.radii)
    feet = radii[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    top = np.asarray(geometry.endstops) + np.sqrt(arms**2 - radii**2)
    return feet, top
