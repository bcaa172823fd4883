"""Saved positions of a Klipper delta against where its printer can be.

Positions are steps. Where the steps of the configuration were changed since, they are
those of another travel, and the tool would be far off the bed, or nowhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import brentq

from oed.base.arrays import Array
from pkm_studies.importers.delta_contact import tool_heights
from pkm_studies.importers.delta_study import DeltaGeometry
from pkm_studies.importers.klipper_config import Entry

#: distance from the bed, over the height of the lowest endstop, of a position that is wrong
FAR = 0.2
#: factors of the steps between which one that fits is sought
FACTORS = (0.05, 20.0)
REMEDY = (
    "these steps were saved with other microsteps, rotation_distance or gear_ratio: give"
    " those of then, or remove these positions and measure them again"
)


def check_positions(
    positions: Mapping[str, tuple[Entry, Sequence[float], float]],
    geometry: DeltaGeometry,
) -> None:
    """Refuse positions from which the tool is far from where it was. Raises InputError.

    positions  by option: its entry, travels (3,) in mm, and the height of the tool, mm
    """
    limit = FAR * min(geometry.endstops)
    for option, (entry, travels, height) in positions.items():
        miss = _tool_height(np.asarray(travels), geometry) - height
        if abs(miss) <= limit:
            continue
        place = f"[delta_calibrate] {option}"
        raise entry.error(place, _problem(travels, height, miss, geometry), REMEDY)


def _problem(
    travels: Sequence[float], height: float, miss: float, geometry: DeltaGeometry
) -> str:
    if np.isnan(miss):
        where = "the arms cannot reach this position"
    else:
        side = "below" if miss < 0.0 else "above"
        where = f"the tool would be {abs(miss):.0f} mm {side} the bed there"
    factor = _factor(np.asarray(travels), height, geometry)
    if factor is None:
        return where
    return f"{where}; its steps are {1.0 / factor:.3g} times those that reach the bed"


def _factor(travels: Array, height: float, geometry: DeltaGeometry) -> float | None:
    """Factor of the travels that brings the tool to a height; None where none does."""

    def miss(factor: float) -> float:
        z = _tool_height(factor * travels, geometry)
        # travels too far apart to assemble are too long
        return -1e3 if np.isnan(z) else z - height

    low, high = FACTORS
    if miss(low) <= 0.0 or miss(high) >= 0.0:
        return None
    return float(brentq(miss, low, high, xtol=1e-6))


def _tool_height(travels: Array, geometry: DeltaGeometry) -> float:
    """Height, mm, of the tool at travels (3,); NaN where the arms cannot reach it."""
    return float(tool_heights(travels[None], geometry)[0])
