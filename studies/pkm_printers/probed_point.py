"""A contact of a delta with its bed, as its firmware has it, and its row of readings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from pkm_printers.delta_study import Offset
from pkm_studies.importers import Row

SETUP = "probe"
#: decimals of a sum of heights, mm
DIGITS = 9


class ProbedPoint(NamedTuple):
    """Where the nozzle was at contact, and the height that the firmware believed in; mm.

    probe  place of the probe from the nozzle
    """

    x: float
    y: float
    z: float
    probe: Offset = (0.0, 0.0)


def probes_of(points: Iterable[ProbedPoint]) -> dict[str, Offset]:
    """The places of the probes by set-up: `probe`, then `probe_2` and so on."""
    offsets = dict.fromkeys(point.probe for point in points)
    names = [SETUP, *(f"{SETUP}_{k}" for k in range(2, len(offsets) + 1))]
    return dict(zip(names, offsets, strict=False))


def contact_rows(points: Sequence[ProbedPoint], height: float) -> list[Row]:
    """Rows of the readings file, each with the set-up of its probe.

    height  mm, at which the probe triggers
    """
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
    z = round(point.z + height, DIGITS)
    pose = {"x_mm": repr(point.x), "y_mm": repr(point.y), "z_mm": repr(z)}
    return label | pose | ({"height_mm": repr(height)} if height else {})
