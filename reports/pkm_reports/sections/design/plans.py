"""The chosen plan against reference plans: by the criterion, and by accuracy."""

from __future__ import annotations

import math
from collections.abc import Sequence

from oed.result import DesignSection, PlanScore
from pkm_reports import missing, text
from pkm_reports.blocks import (
    Block,
    Picture,
    Table,
    number_columns,
    transposed,
    wide_column,
)
from pkm_reports.sections.design.certificate import criterion_value
from pkm_reports.sections.figures import predicted


def blocks(design: DesignSection) -> list[Block]:
    """Scores, then predicted accuracy as figure and table."""
    plans = design.plans
    if not plans:
        return []
    content: list[Block] = [_scores(design)]
    if any(plan.predicted for plan in plans):
        caption = _figure_caption(plans)
        content.append(Picture("predicted", lambda: predicted.draw(plans), caption))
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
    more = len(with_prediction) - predicted.MOST
    if more > 0:
        sentences.append(f"{more} more are in the table only.")
    return " ".join(sentences)


def _error(key: str, rms: float) -> str:
    stem, unit = text.split_unit(key)
    return f"{stem} {text.quantity(rms, unit)}"


def _accuracies(design: DesignSection) -> Table:
    """Two rows for each plan: rms errors, and the gain over the reference plan."""
    keys = predicted.components(design.plans)
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
