"""Where the remaining uncertainty of each component comes from, as shares of its
variance.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.arrays import Array
from pkm_reports import style, words

Shares = Array
Parts = Mapping[str, Mapping[str, Any]]


def draw(parts: Parts) -> Figure:
    """One stacked bar for each component; shares above 7 % are written into the bar."""
    sources = list(
        dict.fromkeys(
            name for part in parts.values() for name in part.get("budget") or {}
        )
    )
    if not sources:
        return style.empty("No uncertainty budget is stored in this result.")
    figure = style.figure(0.95 + 0.26 * len(parts) + 0.16 * np.ceil(len(sources) / 4))
    axes = figure.subplots()
    start = np.zeros(len(parts))
    for k, source in enumerate(sources):
        share = np.nan_to_num(
            [
                100 * words.number((p.get("budget") or {}).get(source))
                for p in parts.values()
            ]
        )
        _stack(axes, k, source, start, share)
        start = start + share
    style.fixed_ticks(axes, "y", range(len(parts)), list(parts))
    axes.set(
        xlim=(0.0, max(100.0, start.max())),
        xlabel="share of the variance that remains [%]",
    )
    axes.set_ylim(len(parts) - 0.5, -0.5)
    axes.grid(False)
    figure.legend(
        loc="outside lower center", ncols=5 if sum(map(len, sources)) < 60 else 4
    )
    return figure


def _stack(axes: Axes, k: int, source: str, start: Shares, share: Shares) -> None:
    """The k-th source, on top of those before it; hatched where the colours begin anew."""
    colour, hatch = (
        style.CYCLE[k % len(style.CYCLE)],
        "///" if k >= len(style.CYCLE) else None,
    )
    look: Any = {
        "height": 0.7,
        "color": colour,
        "hatch": hatch,
        "ec": "white",
        "label": style.safe(source),
    }
    bars = axes.barh(range(len(share)), share, left=start, **look)
    texts = [f"{s:.0f}" if s >= 7 else "" for s in share]
    ink = style.INK if colour in style.PALE else "white"
    axes.bar_label(
        bars, texts, label_type="center", color=ink, fontsize=7, fontweight="bold"
    )
