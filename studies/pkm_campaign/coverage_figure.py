"""Figures of campaigns: coverage by combination."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

from matplotlib.figure import Figure

from pkm_reports import style

#: what 95 % intervals should hold
NOMINAL = 0.95
#: inches of a row, of the axis below, and of the name beside
ROW, AXIS, NAME_LENGTH = 0.28, 0.8, 40


@dataclasses.dataclass(frozen=True, slots=True)
class Coverage:
    """Share of intervals that hold the truth, with its interval (NaN without one)."""

    share: float
    low: float
    high: float


def draw_coverage(rows: Mapping[str, Coverage]) -> Figure:
    """Coverage with its interval, a row each combination."""
    if not rows:
        return style.empty("no machine could be fitted")
    drawn = style.figure(AXIS + ROW * len(rows))
    axes = drawn.subplots()
    for k, row in enumerate(rows.values()):
        if not math.isnan(row.low):
            axes.plot([row.low, row.high], [k, k], color="C0", linewidth=1.5)
        axes.plot(row.share, k, "o", color="C0", markersize=4)
    axes.axvline(NOMINAL, color="0.5", linewidth=0.8)
    axes.set_yticks(range(len(rows)), [style.label(n, NAME_LENGTH) for n in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xlabel("share of 95 % intervals that hold the truth")
    return drawn
