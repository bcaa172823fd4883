"""Probed points of a delta whose firmware gives the height that it believes in.

At contact the tool is at the trigger height over the bed, while the firmware, with the
geometry it has, believes in (x, y, z): that command gives the joints, and the reading is
the trigger height, 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from pkm_studies.importers.base import ImportedSession, Row
from pkm_studies.importers.delta_study import DeltaGeometry, delta_study

#: standard deviation of a probed height, the bed's flatness included, um
HEIGHT_UM = 100.0


class ProbedPoint(NamedTuple):
    """Where the bed was touched, and the height that the firmware believed in; mm."""

    x: float
    y: float
    z: float


def delta_session(
    *,
    name: str,
    firmware: str,
    files: str,
    geometry: DeltaGeometry,
    points: Sequence[ProbedPoint],
) -> ImportedSession:
    """Study, readings and statements of probed points."""
    study = delta_study(
        name=name,
        firmware=firmware,
        files=files,
        geometry=geometry,
        fixed=("angle3", "arm1", "arm2", "arm3"),
        fixed_because="heights alone do not give the arms",
        noise="[noise]  # standard deviation of one reading, the bed's flatness"
        f" included\nheight_um = {HEIGHT_UM}\n",
        calliper=False,
        probed_radius=max(math.hypot(p.x, p.y) for p in points),
        heights=(0.0, 50.0),
    )
    arms = ", ".join(f"{arm:g}" for arm in geometry.arms)
    angles = ", ".join(f"{angle:g}" for angle in geometry.angles)
    stops = ", ".join(f"{stop:g}" for stop in geometry.endstops)
    return ImportedSession(
        study=study,
        rows=[_row(k, point) for k, point in enumerate(points, start=1)],
        statements=[
            f"Machine: delta, radius {geometry.radius:g} mm, arms {arms} mm, towers at"
            f" {angles} deg, endstops at {stops} mm.",
            f"Readings: {len(points)} points of contact with the bed as set-up probe.",
            "The geometry must be the one that the printer had while it probed.",
        ],
    )


def _row(order: int, point: ProbedPoint) -> Row:
    label = {"setup": "probe", "run": "1", "order": str(order)}
    pose = {f"{axis}_mm": repr(v) for axis, v in zip("xyz", point, strict=True)}
    return label | pose | {"height_mm": "0.0"}
