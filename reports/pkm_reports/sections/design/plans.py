"""The chosen plan against reference plans: by the criterion, and by accuracy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.result import DesignSection, PlanScore
from pkm_reports import missing, style, text
from pkm_reports.blocks import (
    Block,
    Picture,
    Table,
    number_columns,
    transposed,
    wide_column,
)
from pkm_reports.sections.design.certificate import criterion_value

# Predicted accuracy of each component, plan by plan, as marks on a log scale.

MAX_COMPONENTS: Final = 8


def draw_predicted(plans: Sequence[PlanScore]) -> Figure:
    """A line for each component, a mark for each plan; lengths and angles apart."""
    shown = [plan for plan in plans if plan.predicted][:MAX_COMPONENTS]
    if not shown:
        return style.empty(
            "No predicted accuracy of the plans is stored in this result."
        )
    groups: dict[str, list[str]] = {}
    for key in shown_components(shown):
        groups.setdefault(text.split_unit(key)[1], []).append(key)
    labels = [style.label(plan.name, 40) for plan in shown]
    columns = style.legend_columns(labels)
    rows = max(map(len, groups.values()))
    legend_rows = math.ceil(len(labels) / columns)
    figure = style.figure(0.75 + 0.27 * rows + 0.17 * legend_rows)
    panels = figure.subplots(1, len(groups), squeeze=False)[0]
    for axes, (unit, keys) in zip(panels, groups.items(), strict=True):
        _panel(axes, keys, shown, labels)
        of_unit = f" [{text.unit_symbol(unit)}]" if unit else ""
        axes.set_xlabel(f"predicted rms error{of_unit}")
    handles, names = panels[0].get_legend_handles_labels()
    legend: Any = {"loc": "outside lower center", "ncols": columns}
    figure.legend(handles[::-1], names[::-1], **legend)
    return figure


def shown_components(plans: Sequence[PlanScore]) -> list[str]:
    """Components that any of the plans predicts, in order of appearance."""
    return list(dict.fromkeys(key for plan in plans for key in plan.predicted))


def _panel(
    axes: Axes, keys: Sequence[str], plans: Sequence[PlanScore], labels: Sequence[str]
) -> None:
    tables = [plan.predicted for plan in plans]
    rms = np.column_stack([missing.column(tables, key) for key in keys])
    rms[~(rms > 0.0)] = np.nan
    rows = np.arange(len(keys))
    finite = np.isfinite(rms).any(axis=0)
    least = np.nanmin(rms[:, finite], axis=0)
    most = np.nanmax(rms[:, finite], axis=0)
    axes.hlines(
        rows[finite],
        least,
        most,
        color=style.LIGHT,
        lw=1.0,
    )
    # The chosen plan is the first: drawn last, it lies on top.
    for k in reversed(range(len(plans))):
        look: Any = {"color": style.CYCLE[k % len(style.CYCLE)], "ls": ""}
        look |= {"marker": style.marker(k), "ms": 6 if k == 0 else 5}
        look |= {"mec": "white", "mew": 0.4, "zorder": 4.0 - 0.1 * k}
        axes.plot(
            rms[k],
            rows,
            label=labels[k],
            **look,
        )
    if finite.any():
        axes.set_xlim(float(least.min()) / 1.35, 1.35 * float(most.max()))
    style.log_axis(axes, "x")
    stems = [text.split_unit(key)[0] for key in keys]
    style.fixed_ticks(axes, "y", rows.tolist(), stems)
    axes.set_ylim(len(keys) - 0.5, -0.5)


def blocks(design: DesignSection) -> list[Block]:
    """Scores, then predicted accuracy as figure and table."""
    plans = design.plans
    if not plans:
        return []
    content: list[Block] = [_scores(design)]
    if any(plan.predicted for plan in plans):
        caption = _figure_caption(plans)
        content.append(Picture("predicted", lambda: draw_predicted(plans), caption))
        content.append(_accuracies(design))
    return content


def is_chosen(plan: PlanScore, design: DesignSection) -> bool:
    """Whether a plan is the chosen one, by its name or by all its numbers."""
    if plan.name == "chosen":
        return True
    of_plan = (plan.n, plan.value, plan.kappa)
    return of_plan == (design.n, design.value, design.kappa)


def _marks(design: DesignSection) -> list[str]:
    return ["chosen" if is_chosen(plan, design) else "" for plan in design.plans]


# -- by the criterion ------------------------------------------------------------------


def _scores(design: DesignSection) -> Table:
    plans = design.plans
    criterion = plans[0].criterion
    indices = list(dict.fromkeys(key for plan in plans for key in plan.observability))
    columns = {
        "Readings": [str(plan.n) for plan in plans],
        criterion: [criterion_value(criterion, plan.value) for plan in plans],
        "log det": [text.fixed(plan.logdet, 2) for plan in plans],
        f"{criterion}-efficiency": [text.percent(plan.efficiency) for plan in plans],
    }
    if criterion == "D":  # its value is the column log det
        del columns["D"]
    if criterion != "kappa":
        columns["κ"] = [text.number(plan.kappa, 4) for plan in plans]
    for index in indices:
        if index != criterion:
            values = missing.column([plan.observability for plan in plans], index)
            columns[index] = [text.number(value) for value in values]
    titles = [wide_column("Plan"), *number_columns(*columns)]
    cells = [[plan.name for plan in plans], *columns.values()]
    return Table(titles, transposed(cells), _scores_caption(design), _marks(design))


def _scores_caption(design: DesignSection) -> str:
    """The chosen plan against the best of the others."""
    caption = (
        "The chosen plan (marked) and reference plans. Higher log det and lower κ are"
        " better."
    )
    if design.effects is not None:
        caption += " All are judged on a machine without effects."
    plans = [plan for plan in design.plans if plan.efficiency > 0.0]
    chosen = [plan for plan in plans if is_chosen(plan, design)]
    others = [plan for plan in plans if not is_chosen(plan, design)]
    if not chosen or not others:
        return caption
    rival = max(others, key=lambda plan: plan.efficiency)
    share = rival.efficiency / chosen[0].efficiency
    if share > 1.0:
        return f"{caption} The plan “{rival.name}” is better than the chosen one."
    caption += (
        f" The next best, “{rival.name}”, has {text.percent(share)} of the efficiency of"
        " the chosen one"
    )
    if rival.criterion != "D" or rival.n != chosen[0].n:
        return f"{caption}."
    # D-efficiency grows in proportion to the number of readings.
    more = math.ceil(rival.n / share - rival.n)
    return f"{caption}: it needs about {text.count(more, 'more reading')} to match it."


# -- by predicted accuracy -------------------------------------------------------------


def _figure_caption(plans: Sequence[PlanScore]) -> str:
    """What the chosen plan leaves of each component."""
    sentences = [
        "Predicted rms error of each component over the workspace after all known"
        " errors are corrected, on a log scale.",
        "Each plan has a mark; left is better.",
    ]
    first = plans[0]
    errors = [_error(key, rms) for key, rms in first.predicted.items()]
    if errors:
        sentences.append(f"The plan “{first.name}” leaves {text.listing(errors)}.")
    with_prediction = [plan for plan in plans if plan.predicted]
    more = len(with_prediction) - MAX_COMPONENTS
    if more > 0:
        sentences.append(f"{more} more are in the table only.")
    return " ".join(sentences)


def _error(key: str, rms: float) -> str:
    stem, unit = text.split_unit(key)
    return f"{stem} {text.quantity(rms, unit)}"


def _accuracies(design: DesignSection) -> Table:
    """Two rows for each plan: rms errors, and the gain over the reference plan."""
    keys = shown_components(design.plans)
    reference = _reference(design.plans)
    rows, marks = [], []
    for plan, mark in zip(design.plans, _marks(design), strict=True):
        errors = [text.number(missing.entry(plan.predicted, key)) for key in keys]
        rows.append([plan.name, *errors])
        marks.append(mark)
        if reference is not None and plan is not reference and plan.gain:
            gains = [text.times(missing.entry(plan.gain, key)) for key in keys]
            rows.append(["… times as accurate", *gains])
            marks.append(mark)
    titles = [text.heading(key) for key in keys]
    columns = [wide_column("Plan"), *number_columns(*titles)]
    caption = _accuracies_caption(design.plans[0], reference)
    return Table(columns, rows, caption, marks)


def _accuracies_caption(chosen: PlanScore, reference: PlanScore | None) -> str:
    caption = "Predicted rms errors, plan by plan"
    if reference is None:
        return f"{caption}."
    caption += f", and how many times as accurate as with “{reference.name}”."
    if not chosen.gain:
        return caption
    least = text.times(min(chosen.gain.values()))
    most = text.times(max(chosen.gain.values()))
    gain = least if least == most else f"{least} to {most}"
    return f"{caption} The chosen plan is {gain} as accurate."


def _reference(plans: Sequence[PlanScore]) -> PlanScore | None:
    """The plan that gains refer to: the first after the chosen one."""
    has_gains = any(plan.gain for plan in plans)
    return plans[1] if len(plans) > 1 and has_gains else None
