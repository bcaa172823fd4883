"""Heights of a bed mesh: each is a contact with the bed that a calibration did not use.

The firmware, with the geometry that it has, believes in a height of the nozzle at each
contact. That command gives the joints, and the bed is flat: the reading is the same
everywhere. What the level of a mesh refers to is not the trigger height of the
calibration, so each mesh has an offset of its own.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Collection, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from oed.base import Array, Mask
from pkm_printers.delta_study import EXACT_TRIGGER, Offset, setup_table
from pkm_studies.importers import MeshUse, Row

# A contact of a delta with its bed, as its firmware has it, and its row of readings.

SETUP = "probe"
SUM_DECIMALS = 9  #: decimals of a sum of heights, mm


class ProbedPoint(NamedTuple):
    """Where the nozzle was at contact, and the height that the firmware believed in; mm."""

    x: float
    y: float
    z: float
    probe: Offset = (0.0, 0.0)  #: place of the probe from the nozzle


def probes_of(points: Iterable[ProbedPoint]) -> dict[str, Offset]:
    """The places of the probes by set-up: `probe`, then `probe_2` and so on."""
    offsets = dict.fromkeys(point.probe for point in points)
    names = [SETUP, *(f"{SETUP}_{k}" for k in range(2, len(offsets) + 1))]
    return dict(zip(names, offsets, strict=False))


def contact_rows(points: Sequence[ProbedPoint], height: float) -> list[Row]:
    """Rows of the readings file by set-up, for a probe that triggers at a height, mm."""
    setups = {offset: name for name, offset in probes_of(points).items()}
    return [
        contact_row(k, point, setups[point.probe], height)
        for k, point in enumerate(points, start=1)
    ]


def contact_row(order: int, point: ProbedPoint, setup: str, height: float) -> Row:
    """A row of the readings file: the command at contact, and the height read there, mm.

    Heights of a firmware count from the one at which the probe triggers. A linear delta
    moves along z alike everywhere, so that 0 serves as well.
    """
    label = {"setup": setup, "run": "1", "order": str(order)}
    z = round(point.z + height, SUM_DECIMALS)
    pose = {"x_mm": repr(point.x), "y_mm": repr(point.y), "z_mm": repr(z)}
    return label | pose | ({"height_mm": repr(height)} if height else {})


def offset_sentence(offset: Offset, source: str, places: str) -> str:
    """Where a probe is (2,), mm, from the nozzle by its source; no full stop.

    places  which ones the nozzle was off then
    """
    x, y = offset
    if not (x or y):
        return f"Places: those of the nozzle, where the probe is ({source})"
    return (
        f"Places: the probe is at x {x:+g}, y {y:+g} mm of the nozzle ({source}), so the"
        f" nozzle was at x {0.0 - x:+g}, y {0.0 - y:+g} mm of {places}"
    )


# Heights that a firmware probed at the nodes of a grid.

PLACE_TOLERANCE_MM = 0.1  #: mm; places of a mesh are rounded by as much
#: standard deviation, mm, of a mesh's level against that of the calibration
LEVEL_SD_MM = 1.0
USES = {
    "hold-out": "they are predicted, not fitted; --mesh readings fits them",
    "readings": "they are fitted with the other readings",
}


@dataclasses.dataclass(frozen=True)
class BedMesh:
    """Heights probed at the nodes of a grid.

    name     of the profile or file
    points   the probed nodes: place of the nozzle, and height that the firmware had
    left_out number of nodes that were not probed, and why
    """

    name: str
    points: tuple[ProbedPoint, ...]
    left_out: int = 0
    because: str = ""

    @classmethod
    def of_grid(
        cls, name: str, x: Array, y: Array, heights: Array, probe: Offset, because: str
    ) -> BedMesh:
        """A mesh of heights (ny, nx) at places (nx,), (ny,) of a probe, all mm.

        A height is NaN at a node that was not probed. The probe is at a place (2,) from
        the nozzle.
        """
        points = tuple(
            ProbedPoint(float(x[j] - probe[0]), float(y[i] - probe[1]), float(z), probe)
            for (i, j), z in np.ndenumerate(heights)
            if math.isfinite(z)
        )
        return cls(name, points, heights.size - len(points), because)

    @property
    def setup(self) -> str:
        """Name of the set-up of a study."""
        stem = re.sub(r"[^A-Za-z0-9_]+", "_", self.name).strip("_")
        return f"mesh_{stem}" if stem else "mesh"

    @property
    def radius(self) -> float:
        """Largest distance of a point from the middle, mm."""
        return max(math.hypot(p.x, p.y) for p in self.points)

    def rows_at(self, height: float) -> list[Row]:
        """Rows of the readings file, for a probe that triggers at a height, mm."""
        points = enumerate(self.points, start=1)
        return [contact_row(k, p, self.setup, height) for k, p in points]

    def setup_table(self, *, is_reference: bool = False) -> str:
        """The table [[setup]] of a study; a reference states where the bed is."""
        level = LEVEL_SD_MM
        why = "the level of a mesh is its own"
        if is_reference:
            level = 0.0
            why = EXACT_TRIGGER
        return setup_table(self.setup, self.points[0].probe, level, why)

    def sentence(self, use: MeshUse) -> str:
        """What was read, in words."""
        without = ""
        if self.left_out:
            without = f" {self.left_out} nodes are left out: {self.because}."
        return (
            f"Readings: {len(self.points)} heights of the mesh {self.name} as set-up"
            f" {self.setup}; {USES[use]}.{without}"
        )


def distinct(meshes: Sequence[BedMesh]) -> tuple[list[BedMesh], list[str]]:
    """Meshes without copies of others and without empty ones; sentences on those."""
    chosen: list[BedMesh] = []
    sentences = []
    for mesh in meshes:
        copied = [one for one in chosen if one.points == mesh.points]
        if not mesh.points:
            sentences.append(f"The mesh {mesh.name} has no probed height: not read.")
        elif copied:
            sentences.append(
                f"The mesh {mesh.name} is a copy of {copied[0].name}: not read."
            )
        else:
            chosen.append(_renamed(mesh, [one.setup for one in chosen]))
    return chosen, sentences


def _renamed(mesh: BedMesh, setups: Collection[str]) -> BedMesh:
    """The mesh, with a number behind its name where another set-up has that name."""
    number = 1
    renamed = mesh
    while renamed.setup in setups:
        number += 1
        renamed = dataclasses.replace(mesh, name=f"{mesh.name} {number}")
    return renamed


def explanations(meshes: Collection[BedMesh], geometry: str) -> list[str]:
    """When meshes count for a geometry: with words of the firmware, `M665 and M666`."""
    if not meshes:
        return []
    return [
        f"The heights of a mesh are turned into carriage positions with {geometry} as"
        " given. That is right for a mesh that was probed with them: after the last"
        " calibration was saved. One that was probed before it has the geometry of then,"
        " and says nothing of these numbers: remove it from a copy of the file, or probe"
        " it again."
    ]


def copied_margin(x: Array, y: Array, z: Array) -> Mask:
    """Which nodes (ny, nx) of a round bed's mesh are copies of probed ones.

    x  (nx,), y (ny,), z (ny, nx)

    Outside the circle through the middles of the sides nothing was probed; a node there
    has the height of the last probed one of its row. Where any has another height the
    mesh was probed on the whole rectangle, and no node is a copy.
    """
    across = x - (x[0] + x[-1]) / 2.0
    along = y - (y[0] + y[-1]) / 2.0
    reach = max(across[-1], along[-1]) + PLACE_TOLERANCE_MM
    outside = np.hypot(across[None, :], along[:, None]) > reach
    filled = np.array(
        [
            np.interp(across, across[~out], row[~out]) if (~out).any() else row
            for row, out in zip(z, outside, strict=True)
        ]
    )
    is_round = bool(outside.any()) and np.array_equal(filled[outside], z[outside])
    return outside if is_round else np.zeros_like(outside)
