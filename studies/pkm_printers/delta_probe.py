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

from pkm_printers.bed_mesh import BedMesh, distinct, explanations
from pkm_printers.delta_study import DeltaGeometry, DeltaStudy, Firmware, noise_table
from pkm_printers.probed_point import ProbedPoint, contact_row
from pkm_studies.base import InputError
from pkm_studies.importers import ImportedSession, MeshUse

#: standard deviation of a probed height, the bed's flatness included, um
HEIGHT_UM = 100.0
NOISE = "standard deviation of one reading, the bed's flatness included"


#: mm; no point of a bed is farther away
LARGEST = 1e4


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
    meshes: Sequence[BedMesh] = (),
    mesh: MeshUse = "hold-out",
) -> ImportedSession:
    """Study, readings and statements of probed points.

    accounts       sentences on what became of the words of the files
    notes          further sentences, on places and heights
    bed_slope_ppm  what the firmware adds to z along x and y
    meshes         further heights of the same bed, for which use; without points, the
                   first one states where the bed is
    """
    _check_places([*points, *[point for one in meshes for point in one.points]], files)
    meshes, mesh_notes = distinct(meshes)
    mesh_notes += [one.sentence(mesh) for one in meshes]
    mesh_notes += explanations(meshes, "M665 and M666")
    notes = [*mesh_notes, *notes]
    radius = max((one.radius for one in meshes), default=0.0)
    study = DeltaStudy(
        name=name,
        firmware=firmware,
        files=files,
        geometry=geometry,
        fixed=("angle3", "arm1", "arm2", "arm3"),
        fixed_because="heights alone do not give the arms",
        noise=noise_table(NOISE, HEIGHT_UM),
        calliper=False,
        probed_radius=max((math.hypot(p.x, p.y) for p in points), default=radius),
        heights=(0.0, 50.0),
        bed_slope_ppm=bed_slope_ppm,
        accounts=[*notes, *accounts],
        mesh_setups="".join(
            one.setup_table(bed_slope_ppm, is_reference=not points and k == 0)
            for k, one in enumerate(meshes)
        ),
        mesh_radius=radius,
        has_probe=bool(points),
        predict=[one.setup for one in meshes] if mesh == "hold-out" else [],
    )
    rows = [
        contact_row(k, point, bed_slope_ppm) for k, point in enumerate(points, start=1)
    ]
    for one in meshes:
        rows += one.rows(bed_slope_ppm)
    probed = f"Readings: {len(points)} points of contact with the bed as set-up probe."
    statements = [
        geometry.sentence(),
        *([probed] if points else []),
        "The geometry must be the one that the printer had while it probed.",
    ]
    return ImportedSession(
        study=study.text(),
        rows=rows,
        statements=[*statements, *notes, *accounts],
    )


def _check_places(points: Sequence[ProbedPoint], files: str) -> None:
    """Raises InputError for a point that no machine has."""
    for point in points:
        if max(map(abs, point)) > LARGEST:
            listed = ", ".join(f"{v:g}" for v in point)
            raise InputError(
                f"a point at x, y, z = {listed} mm is on no bed",
                "correct it in a copy of the file",
                file=files,
            )
