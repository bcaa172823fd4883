"""What time buys: plans of which none is both shorter and more accurate, the plan, its
bound, sequences beside it.
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
#: sequences shown by name; more are in the table only
MOST: Final = 6
#: ranges of minutes wider than this factor are drawn on a log scale
WIDE: Final = 30.0
WANTED_LABEL: Final = "error of the worst component\nover what is wanted of it"
FREE_LABEL: Final = "error left, over that before\nany reading (rms of components)"


def draw(plan: Part) -> Figure:
    """Minutes against the value that plans are judged by, the smaller the better."""
    front = points(plan.get("front") or [])
    chosen = points([{"minutes": plan.get("cost"), "value": plan.get("value")}])
    named = [s for s in plan.get("compared") or [] if len(points([s["way"]]))]
    others = points(
        [way for way in plan.get("alternatives") or [] if isinstance(way, Mapping)]
    )
    every = np.vstack([front, chosen, others, points([s["way"] for s in named])])
    if not len(every):
        return style.empty("No plans of other times are stored in this result.")
    figure = style.figure(3.3)
    axes = figure.subplots()
    _scale(axes, every, plan)
    _limit(axes, plan)
    if len(others):
        axes.plot(*others.T, "x", color=style.GREY, ms=5, label="looked at, not taken")
    if len(front):
        axes.plot(
            *front.T,
            "o-",
            color=style.BLUE,
            drawstyle="steps-post",
            label="best plan found for the time",
        )
    _sequences(axes, named[:MOST])
    if len(chosen):
        axes.plot(
            *chosen.T,
            "*",
            color=style.ORANGE,
            mec=style.INK,
            mew=0.6,
            ms=12,
            label="the plan",
            zorder=5,
        )
    style.log_axis(axes, "y")
    axes.set(xlabel="minutes", ylabel=WANTED_LABEL if plan.get("goal") else FREE_LABEL)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside lower center",
        ncols=min(2, style.legend_columns(labels)),
    )
    return figure


def points(ways: Sequence[Part]) -> Array:
    """Minutes and value (n, 2) of the plans that have both, value positive."""
    told = [
        (words.number(way.get("minutes")), words.number(way.get("value")))
        for way in ways
    ]
    known = [pair for pair in told if np.isfinite(pair).all() and pair[1] > 0.0]
    return np.array(known, dtype=float).reshape(-1, 2)


def _scale(axes: Axes, every: Array, plan: Part) -> None:
    """Limits that hold all plans, the budget and the bound."""
    minutes = np.append(
        every[:, 0],
        [m for m in [words.number(plan.get("budget_min"))] if np.isfinite(m)],
    )
    limits = [
        plan.get("bound"),
        *[s.get("bound") for s in plan.get("compared") or []],
        1.0 if plan.get("goal") else None,
    ]
    values = np.append(every[:, 1], [v for v in map(words.number, limits) if v > 0.0])
    axes.set_yscale("log")
    axes.set_ylim(values.min() / 1.35, 1.35 * values.max())
    positive = minutes[minutes > 0.0]
    if len(positive) and positive.max() > WIDE * positive.min():
        axes.set_xscale("log")
        axes.set_xlim(positive.min() / 1.2, 1.12 * positive.max())
        style.log_axis(axes, "x")
    else:
        axes.set_xlim(0.0, 1.06 * max(minutes.max(), 1e-9))


def _limit(axes: Axes, plan: Part) -> None:
    """The region where no plan within the budget lies, the budget, and the value from
    which the goal is reached.
    """
    budget, bound = (
        words.number(plan.get("budget_min")),
        words.number(plan.get("bound")),
    )
    right = budget if np.isfinite(budget) else axes.get_xlim()[1]
    if bound > 0.0 and np.isfinite(bound):
        span = [axes.get_xlim()[0], right]
        label = "no plan within the budget is better"
        axes.fill_between(
            span,
            axes.get_ylim()[0],
            bound,
            color=style.LIGHT,
            lw=0,
            zorder=0,
            label=label,
        )
        axes.plot(span, [bound, bound], color=style.GREY, lw=0.8)
    if np.isfinite(budget):
        axes.axvline(
            budget,
            color=style.RED,
            ls="--",
            lw=1.0,
            label=f"budget: {words.plain(budget)} min",
        )
    if plan.get("goal"):
        axes.axhline(
            1.0,
            color=style.GREEN,
            ls=":",
            lw=1.3,
            label="all that is wanted is reached below",
        )


def _sequences(axes: Axes, compared: Sequence[Part]) -> None:
    """Sequences that were asked for, each with the bound of its time below it."""
    for k, sequence in enumerate(compared):
        place = points([sequence["way"]])
        look: Any = {
            "color": style.CYCLE[(k + 2) % len(style.CYCLE)],
            "marker": "DsP^vX"[k % 6],
            "ls": "",
            "ms": 6,
        }
        axes.plot(
            *place.T,
            **look,
            mec=style.INK,
            mew=0.5,
            label=style.safe(f"sequence {sequence['name']}", 48),
        )
        bound = words.number(sequence.get("bound"))
        if bound > 0.0 and np.isfinite(bound):
            label = "bound of a sequence's time" if k == len(compared) - 1 else None
            axes.plot(
                place[:, 0], [bound], "_", color=style.INK, ms=10, mew=1.4, label=label
            )
