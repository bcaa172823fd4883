"""Which effects can be distinguished from which others: a matrix of sqrt(lambda)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from oed.base import Array
from oed.result import DetectabilityTable
from pkm_reports import missing, style, text
from pkm_reports.sections.figures.gap.effects import spoken

#: sqrt(lambda) below which two effects are not distinguished, and above which they clearly are
LIMIT, CLEAR = 5.0, 10.0
#: colours and legend of: not distinguished, barely, clearly
COLOURS: Final = ("#f3c4a5", "#f7ecc8", "#cfe6dd")
MEANINGS: Final = (
    f"below {LIMIT:g}: not distinguished",
    f"{LIMIT:g} to {CLEAR:g}: barely",
    f"above {CLEAR:g}: distinguished",
)
#: inches of one cell, at most, and from which its number has normal size
LARGEST_CELL, SMALL_CELL = 0.42, 0.34
#: size from which a number has no decimal
WHOLE: Final = 9.95


def draw(table: DetectabilityTable) -> Figure:
    """Rows are effects, columns the effects that could explain them instead.

    The diagonal shows how well each effect is detected where nothing else acts.
    """
    names = table.names
    if len(names) < 2:
        return style.empty("Fewer than two effects can be tested with these readings.")
    values = missing.table(table.separation)
    cell = min(LARGEST_CELL, (style.WIDTH - 1.5) / len(names))
    figure = style.figure(cell * len(names) + 1.75)
    axes = figure.subplots()
    shade: Any = {"cmap": ListedColormap(COLOURS)}
    shade["norm"] = BoundaryNorm([0.0, LIMIT, CLEAR, np.inf], len(COLOURS))
    finite = np.where(np.isfinite(values), values, 0.0)
    axes.imshow(finite, aspect="equal", **shade)
    _write_numbers(axes, values, 7.0 if cell > SMALL_CELL else 6.0)
    _set_labels(axes, [spoken(name) for name in names])
    patches = [
        Patch(color=colour, label=meaning)
        for colour, meaning in zip(COLOURS, MEANINGS, strict=True)
    ]
    figure.legend(handles=patches, loc="outside lower center", ncols=3)
    return figure


def short(value: float) -> str:
    """The number of a cell: one decimal below 10, none above."""
    if not np.isfinite(value):
        return text.MISSING
    return f"{value:.1f}" if value < WHOLE else f"{value:.0f}"


def _write_numbers(axes: Axes, values: Array, size: float) -> None:
    """Numbers in the cells; those of the diagonal bold, in a frame."""
    letters: Any = {"ha": "center", "va": "center", "fontsize": size}
    for (row, column), value in np.ndenumerate(values):
        weight = "bold" if row == column else "normal"
        number = short(value)
        axes.text(
            column,
            row,
            number,
            color=style.INK,
            fontweight=weight,
            **letters,
        )
    for k in range(len(values)):
        frame: Any = {"fill": False, "edgecolor": style.INK, "linewidth": 0.9}
        axes.add_patch(Rectangle((k - 0.5, k - 0.5), 1.0, 1.0, **frame))


def _set_labels(axes: Axes, names: Sequence[str]) -> None:
    places = list(range(len(names)))
    style.fixed_ticks(axes, "y", places, names)
    style.fixed_ticks(axes, "x", places, names)
    axes.xaxis.tick_top()
    axes.xaxis.set_label_position("top")
    for label in axes.get_xticklabels():
        label.set(rotation=55, ha="left", rotation_mode="anchor")
    axes.set_xlabel("what else could explain it")
    axes.set_ylabel("effect")
    axes.grid(False)
    axes.tick_params(length=0)
    between = np.arange(len(names) + 1) - 0.5
    axes.set_xticks(between, minor=True)
    axes.set_yticks(between, minor=True)
    axes.grid(True, which="minor", color="white", linewidth=1.2)
    axes.tick_params(which="minor", length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
