"""Probed points of a delta whose firmware gives the height that it believes in.

At contact the tool is at the trigger height over the bed, while the firmware, with the
geometry it has, believes in (x, y, z). A delta moves along z alike everywhere, so the
trigger height drops out: that command gives the joints, and the reading is 0. A firmware
that raises z with x and y, for a bed that leans, has its carriages at the raised z, and
its bed leans as much.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from pkm_studies.importers.base import ImportedSession, Row
from pkm_studies.importers.delta_study import (
    DeltaGeometry,
    DeltaStudy,
    Firmware,
    noise_table,
)

#: standard deviation of a probed height, the bed's flatness included, um
HEIGHT_UM = 100.0
NOISE = "standard deviation of one reading, the bed's flatness included"
PPM = 1e-6


class ProbedPoint(NamedTuple):
    """Where the nozzle was at contact, and the height that the firmware believed in; mm."""

    x: float
    y: float
    z: float


def delta_session(
    *,
    name: str,
    firmware: Firmware,
    files: str,
    geometry: DeltaGeometry,
    points: Sequence[ProbedPoint],
    accounts: Sequence[str],
    notes: Sequence[str],
    bed_slope_ppm: tuple[float, float] = (0.0, 0.0),
) -> ImportedSession:
    """Study, readings and statements of probed points.

    accounts       sentences on what became of the words of the files
    notes          further sentences, on places and heights
    bed_slope_ppm  what the firmware adds to z along x and y
    """
    study = DeltaStudy(
        name=name,
        firmware=firmware,
        files=files,
        geometry=geometry,
        fixed=("angle3", "arm1", "arm2", "arm3"),
        fixed_because="heights alone do not give the arms",
        noise=noise_table(NOISE, HEIGHT_UM),
        calliper=False,
        probed_radius=max(math.hypot(p.x, p.y) for p in points),
        heights=(0.0, 50.0),
        bed_slope_ppm=bed_slope_ppm,
        accounts=[*notes, *accounts],
    )
    statements = [
        geometry.sentence(),
        f"Readings: {len(points)} points of contact with the bed as set-up probe.",
        "The geometry must be the one that the printer had while it probed.",
    ]
    return ImportedSession(
        study=study.text(),
        rows=[
            contact_row(k, point, bed_slope_ppm)
            for k, point in enumerate(points, start=1)
        ],
        statements=[*statements, *notes, *accounts],
    )


def contact_row(
    order: int,
    point: ProbedPoint,
    slope_ppm: tuple[float, float],
    setup: str = "probe",
) -> Row:
    """A row of the readings file: the command at contact; its reading is 0."""
    label = {"setup": setup, "run": "1", "order": str(order)}
    raised = point.z + PPM * (slope_ppm[0] * point.x + slope_ppm[1] * point.y)
    pose = {"x_mm": repr(point.x), "y_mm": repr(point.y), "z_mm": repr(raised)}
    return label | pose
