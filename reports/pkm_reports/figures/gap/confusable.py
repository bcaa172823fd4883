"""Which effects could be told from which others: a matrix of sqrt(lambda)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from pkm_reports import style, words
from pkm_reports.figures.gap.causes import spoken

#: sqrt(lambda) below which two effects are not told apart, and far above which they are
LIMIT, CLEAR = 5.0, 10.0
#: not told apart, barely, clearly
COLOURS: Final = ("#f3c4a5", "#f7ecc8", "#cfe6dd")
WORDS: Final = (
    f"below {LIMIT:g}: not told apart",
    f"{LIMIT:g} to {CLEAR:g}: barely",
    f"above {CLEAR:g}: told apart",
)
#: inches of one cell, at the most
CELL: Final = 0.42


def draw(table: Mapping[str, Any]) -> Figure:
    """Rows are effects, columns what else could explain them; on the diagonal how well
    each is seen at all.
    """
    names = [str(n) for n in table["names"]]
    if len(names) < 2:
        return style.empty("Fewer than two effects can be tested with these readings.")
    values = np.array([style.array(row) for row in table["apart"]])
    cell = min(CELL, (style.WIDTH - 1.5) / len(names))
    figure = style.figure(cell * len(names) + 1.75)
    axes = figure.subplots()
    norm = BoundaryNorm([0.0, LIMIT, CLEAR, np.inf], 3)
    axes.imshow(
        np.where(np.isfinite(values), values, 0.0),
        cmap=ListedColormap(COLOURS),
        norm=norm,
        aspect="equal",
    )
    _cells(axes, values, 7.0 if cell > 0.34 else 6.0)
    _labels(axes, names)
    figure.legend(
        handles=[Patch(color=c, label=w) for c, w in zip(COLOURS, WORDS, strict=True)],
        loc="outside lower center",
        ncols=3,
    )
    return figure


def _cells(axes: Axes, values: np.ndarray, size: float) -> None:
    for k, row in enumerate(values):
        for j, value in enumerate(row):
            bold = "bold" if k == j else "normal"
            axes.text(
                j,
                k,
                short(value),
                ha="center",
                va="center",
                fontsize=size,
                color=style.INK,
                fontweight=bold,
            )
    for k in range(len(values)):
        axes.add_patch(_frame(k))


def _frame(k: int) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle(
        (k - 0.5, k - 0.5), 1.0, 1.0, fill=False, edgecolor=style.INK, linewidth=0.9
    )


def short(value: float) -> str:
    """A cell's number: one decimal below 10, whole ones above."""
    if not np.isfinite(value):
        return words.MISSING
    return f"{value:.1f}" if value < 9.95 else f"{value:.0f}"


def _labels(axes: Axes, names: list[str]) -> None:
    places = list(range(len(names)))
    style.fixed_ticks(axes, "y", places, [spoken(n) for n in names])
    style.fixed_ticks(axes, "x", places, [spoken(n) for n in names])
    axes.xaxis.tick_top()
    axes.xaxis.set_label_position("top")
    for label in axes.get_xticklabels():
        label.set(rotation=55, ha="left", rotation_mode="anchor")
    axes.set_xlabel("what else could explain it")
    axes.set_ylabel("effect")
    axes.grid(False)
    axes.tick_params(length=0)
    axes.set_xticks(np.arange(len(names) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(names) + 1) - 0.5, minor=True)
    axes.grid(True, which="minor", color="white", linewidth=1.2)
    axes.tick_params(which="minor", length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
