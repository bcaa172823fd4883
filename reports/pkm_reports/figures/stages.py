"""Accuracy of each pose component after each stage of a plan, on a log scale, lengths
and angles apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.arrays import Array
from pkm_reports import style, words

Part = Mapping[str, Any]
REALISED: Final = "realised, virtual machines"
WANTED: Final = "wanted"


def draw(plan: Part) -> Figure:
    """A line for each component from before any reading to the last stage, diamonds
    where virtual machines came out.
    """
    keys = components(plan)
    if not keys:
        return style.empty("No accuracy after the stages is stored in this result.")
    units = list(dict.fromkeys(words.parted(key)[1] for key in keys))
    figure = style.figure(2.9)
    panels = figure.subplots(1, len(units), squeeze=False)[0]
    looks = {
        key: (style.CYCLE[k % len(style.CYCLE)], style.marker(k))
        for k, key in enumerate(keys)
    }
    for axes, unit in zip(panels, units, strict=True):
        for key in [key for key in keys if words.parted(key)[1] == unit]:
            _component(axes, key, plan, *looks[key])
        axes.set(
            xlabel="after stage",
            ylabel=f"rms error [{words.unit(unit)}]" if unit else "rms error",
        )
        _ticks(axes, len(plan["stages"]))
        style.log_axis(axes, "y")
    named = {
        label: handle
        for axes in panels
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    last = [label for label in (WANTED, REALISED) if label in named]
    labels = [label for label in named if label not in last] + last
    figure.legend(
        [named[n] for n in labels],
        labels,
        loc="outside lower center",
        ncols=style.legend_columns(labels),
    )
    return figure


def components(plan: Part) -> list[str]:
    """Names with units (`z_um`) of the components that have at least one positive
    accuracy.
    """
    told = [
        plan.get("start_accuracy") or {},
        *[stage.get("accuracy") or {} for stage in plan.get("stages") or []],
    ]
    return list(
        dict.fromkeys(
            key
            for entry in told
            for key, value in entry.items()
            if words.number(value) > 0.0
        )
    )


def realised(stage: Part) -> dict[str, float]:
    """What virtual machines showed, in the unit of each component: the prediction times
    realised over predicted.
    """
    ratios, told = stage.get("realised") or {}, stage.get("accuracy") or {}
    made = {
        key: (
            words.number(ratios.get(key, ratios.get(stem(key))))
            * words.number(told[key])
        )
        for key in told
    }
    return {key: value for key, value in made.items() if np.isfinite(value)}


def stem(key: str) -> str:
    """The component's name without its unit: z_um -> z."""
    return key.rpartition("_")[0] if words.parted(key)[1] else key


def _component(axes: Axes, key: str, plan: Part, colour: str, mark: str) -> None:
    stages: Sequence[Part] = plan["stages"]
    at = np.arange(len(stages) + 1)
    start = (plan.get("start_accuracy") or {}).get(key)
    values = _positive(
        [start, *[(stage.get("accuracy") or {}).get(key) for stage in stages]]
    )
    axes.plot(
        at, values, color=colour, marker=mark, label=style.safe(words.parted(key)[0])
    )
    true = _positive([None, *[realised(stage).get(key) for stage in stages]])
    if np.isfinite(true).any():
        look: Any = {"color": style.ORANGE, "mec": style.INK, "mew": 0.6, "ms": 5}
        # Beside the line's own marks, which they would hide.
        axes.plot(at + 0.09, true, "D", label=REALISED, **look)
    wanted = words.number((plan.get("goal") or {}).get(key))
    if wanted > 0.0:
        axes.axhline(wanted, color=colour, ls=":", lw=1.0)
        axes.plot([], [], color=style.GREY, ls=":", lw=1.0, label=WANTED)


def _positive(values: Sequence[Any]) -> Array:
    """Numbers; NaN for what a log axis cannot show."""
    found = np.array([words.number(v) for v in values])
    return np.asarray(np.where(found > 0.0, found, np.nan))


def _ticks(axes: Axes, count: int) -> None:
    """`before`, then the stages by number; of many, some."""
    step = 1 + (count - 1) // 12
    places = [0, *range(step, count + 1, step)]
    style.fixed_ticks(axes, "x", places, ["before", *[str(k) for k in places[1:]]])
    axes.set_xlim(-0.25, count + 0.3)
