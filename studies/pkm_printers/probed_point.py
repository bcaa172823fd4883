"""A contact of a delta with its bed, as its firmware has it, and its row of readings."""

from __future__ import annotations

from typing import NamedTuple

from pkm_studies.importers import Row

PPM = 1e-6


class ProbedPoint(NamedTuple):
    """Where the nozzle was at contact, and the height that the firmware believed in; mm."""

    x: float
    y: float
    z: float


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
