"""What the design for each criterion is worth by the others: a table of efficiencies,
shaded.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.arrays import Array
from pkm_reports import style, words

Part = Mapping[str, Any]
#: phi is this power of the number told: O1 and O5 are told as square roots
POWER: Final = {"E": 1, "O1": 2, "O2": 1, "O3": 1, "O4": 1, "O5": 2}
#: told as a logarithm of phi, times a number of directions
LOGARITHMIC: Final = ("D", "Ds", "compound")
#: share of the colour scale above which letters are white
DARK: Final = 0.55


def draw(design: Part) -> Figure:
    """A row for each criterion, a column for the design made for it."""
    compared = design.get("compared") or []
    table = efficiencies(compared, design.get("directions"))
    if not np.isfinite(table).any():
        return style.empty("No designs for further criteria are stored in this result.")
    names = [str(entry["name"]) for entry in compared]
    figure = style.figure(
        0.75 + 0.3 * len(names), min(style.WIDTH, 2.6 + 0.62 * len(names))
    )
    axes = figure.subplots()
    low = min(0.5, math.floor(10.0 * float(np.nanmin(table))) / 10.0)
    shade: Any = {"cmap": style.AMOUNT, "vmin": low, "vmax": 1.0, "aspect": "auto"}
    drawn = axes.imshow(np.ma.masked_invalid(np.minimum(table, 1.0)), **shade)
    _write(axes, table, low)
    style.fixed_ticks(axes, "x", range(len(names)), names)
    style.fixed_ticks(axes, "y", range(len(names)), names)
    axes.grid(False)
    axes.set(xlabel="the plan made for …", ylabel="… judged by")
    bar: Any = figure.colorbar(drawn, ax=axes, label="efficiency", pad=0.02)
    bar.outline.set_visible(False)
    return figure


def efficiencies(compared: Sequence[Part], directions: Any = None) -> Array:
    """phi by criterion i of the design for criterion j over that of the design for i
    itself (criteria, designs).

    NaN where a plan leaves a direction unseen, or phi cannot be told from the numbers
    stored. Plans are taken to have the same number of readings.
    """
    names = [str(entry["name"]) for entry in compared]
    main = names[0] if names else ""
    made = np.full((len(names), len(names)), np.nan)
    for i, entry in enumerate(compared):
        values = {n: words.number((entry.get("values") or {}).get(n)) for n in names}
        size = _size(entry, values, main, words.number(directions))
        for j, name in enumerate(names):
            made[i, j] = (
                1.0
                if i == j
                else _share(names[i], values[name], values[names[i]], size)
            )
    return made


def _share(criterion: str, value: float, own: float, size: float) -> float:
    """phi over phi of the design for this criterion, from the numbers as told."""
    if criterion in LOGARITHMIC:
        return math.exp((value - own) / size)
    # kappa, and the variances told with a minus sign, are the reciprocals of phi
    upper, lower = (value, own) if criterion in POWER else (own, value)
    return float((upper / lower) ** POWER.get(criterion, 1)) if lower else math.nan


def _size(
    entry: Part, values: Mapping[str, float], main: str, directions: float
) -> float:
    """By what log det is to be divided: the directions that count, from the bound or
    the gain where they tell.
    """
    if entry["name"] == "compound":
        return 1.0
    own = values[str(entry["name"])]
    told = [
        (
            words.number(entry.get("value")) - words.number(entry.get("bound")),
            words.number(entry.get("efficiency")),
        ),
        (own - values[main], words.number(entry.get("gain"))),
    ]
    sizes = [
        gap / math.log(share)
        for gap, share in told
        if share > 0.0 and abs(math.log(share)) > 1e-4
    ]
    known = [size for size in sizes if math.isfinite(size) and size > 0.0]
    return (
        known[0]
        if known
        else (directions if entry["name"] == "D" and directions > 0.0 else math.nan)
    )


def _write(axes: Axes, table: Array, low: float) -> None:
    """Percentages into the cells; a dash where there is none."""
    for (i, j), share in np.ndenumerate(table):
        dark = (share - low) / (1.0 - low) > DARK
        ink = "white" if dark else style.INK if np.isfinite(share) else style.GREY
        weight = "bold" if i == j else "normal"
        axes.text(
            j,
            i,
            words.percent(share),
            ha="center",
            va="center",
            color=ink,
            fontsize=7.5,
            fontweight=weight,
        )
