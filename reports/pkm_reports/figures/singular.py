"""Singular values of the scaled identification matrix, with the tolerance that decides
the rank.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pkm_reports import style, words


def draw(part: Mapping[str, Any]) -> Figure:
    """Filled marks: seen directions. Hollow marks below the dashed line: lost ones,
    whatever their round-off.
    """
    values = style.array(part.get("singular_values") or [])
    if not np.nanmax(values, initial=0.0) > 0.0:
        return style.empty("No singular values are stored in this result.")
    rank, n = int(part["rank"]), int(part["n"])
    limit = float(part["tolerance"]) * float(np.nanmax(values))
    seen = np.arange(1, len(values) + 1) <= rank
    # Round-off says nothing: all zeros stand on one line, a little below the tolerance.
    floor = min(limit, float(np.nanmin(values[seen], initial=np.inf))) / 8.0
    figure = style.figure(2.6)
    axes = figure.subplots()
    axes.plot(
        np.flatnonzero(seen) + 1,
        values[seen],
        "o-",
        color=style.BLUE,
        lw=0.8,
        label=f"seen: {rank}",
    )
    lost = np.arange(rank, max(n, len(values))) + 1
    if len(lost):
        axes.plot(
            lost,
            np.full(len(lost), floor),
            "v",
            mfc="white",
            mec=style.RED,
            label=f"lost (zero): {len(lost)}",
        )
    axes.axhline(
        limit,
        ls="--",
        lw=0.9,
        color=style.GREY,
        label=f"tolerance {words.num(limit, 2)}",
    )
    axes.set_ylim(floor / 4.0, 6.0 * float(np.nanmax(values)))
    style.log_axis(axes, "y")
    axes.set(
        xlabel="direction in parameter space, best seen first", ylabel="singular value"
    )
    axes.set_xlim(0.3, max(n, len(values)) + 0.7)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=14))
    axes.set_title(f"Rank {rank} of {n}")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.22), ncols=3)
    return figure
