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
        angles=angles + np.array([first, second, 0.0]),
        endstops=geometry.endstops + endstops,
    )


def travels(commands: Array, geometry: DeltaGeometry) -> Array:
    """Travels (n, 3) down from the endstops at commands (n, 3), z from the bed, mm."""
    feet, top = _towers(geometry)
    places = commands[:, :2]
    across = ((places[:, None] - feet) ** 2).sum(axis=2)
    raised = commands[:, 2] + places @ geometry.bed_slope
    return np.asarray(top - np.sqrt(geometry.arms**2 - across) - raised[:, None])


@np.errstate(all="ignore")
def tool_heights(travels: Array, geometry: DeltaGeometry) -> Array:
    """Heights (n,) of the tool, mm: the lower point at the arms' lengths of the carriages.

    travels  (n, 3) down from the endstops, mm

    NaN where the arms cannot reach it.
    """
    feet, top = _towers(geometry)
    arms = geometry.arms
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
    arms, radii = geometry.arms, np.asarray(geometry.radii)
    feet = radii[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    top = geometry.endstops + np.sqrt(arms**2 - radii**2)
    return feet, top
