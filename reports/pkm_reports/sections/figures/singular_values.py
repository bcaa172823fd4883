"""Singular values of the scaled identification matrix, and the tolerance of the rank."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from oed.result import IdentifiabilitySection
from pkm_reports import missing, style, text


def draw(section: IdentifiabilitySection) -> Figure:
    """Filled marks for determined directions, hollow ones for lost directions."""
    values = missing.array(section.singular_values)
    largest = float(np.nanmax(values, initial=0.0))
    if not largest > 0.0:
        return style.empty("No singular values are stored in this result.")
    rank, n = section.rank, max(section.n, len(values))
    limit = section.tolerance * largest
    determined = np.arange(1, len(values) + 1) <= rank
    # Round-off says nothing: all zeros stand on one line, a little below the tolerance.
    smallest = float(np.nanmin(values[determined], initial=np.inf))
    floor = min(limit, smallest) / 8.0
    figure = style.figure(2.6)
    axes = figure.subplots()
    line: Any = {"color": style.BLUE, "lw": 0.8, "label": f"determined: {rank}"}
    axes.plot(np.flatnonzero(determined) + 1, values[determined], "o-", **line)
    lost = np.arange(rank, n) + 1
    if len(lost):
        hollow: Any = {"mfc": "white", "mec": style.RED}
        label = f"lost (zero): {len(lost)}"
        axes.plot(
            lost,
            np.full(len(lost), floor),
            "v",
            label=label,
            **hollow,
        )
    label = f"tolerance {text.number(limit, 2)}"
    axes.axhline(
        limit,
        ls="--",
        lw=0.9,
        color=style.GREY,
        label=label,
    )
    axes.set_ylim(floor / 4.0, 6.0 * largest)
    style.log_axis(axes, "y")
    axes.set_xlabel("direction in parameter space, best determined first")
    axes.set_ylabel("singular value")
    axes.set_xlim(0.3, n + 0.7)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=14))
    axes.set_title(f"Rank {section.rank} of {section.n}")
    axes.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, -0.22),
        ncols=3,
    )
    return figure
