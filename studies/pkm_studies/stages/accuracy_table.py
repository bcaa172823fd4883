"""Writes the predicted accuracy as one table: before, after, what would change it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

from oed.base.text import format_number
from pkm_studies import console
from pkm_studies.earlier_result import corrects_effects
from pkm_studies.results import improvements
from pkm_studies.stages.headline import REFERENCES, without_drive

if TYPE_CHECKING:
    from oed.result import PredictionSection, StudyResult, UsualEffects


class AccuracyRow(NamedTuple):
    """A line of the table: what it is, and the rms error by component."""

    words: str
    errors: Mapping[str, float]


def accuracy_lines(result: StudyResult) -> list[str]:
    """The table as lines, and what its rows mean; empty without accuracy."""
    prediction = result.judged_prediction
    if prediction is None or not prediction.components:
        return []
    from rich import box
    from rich.table import Table

    units = shown_components(prediction)
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 1))
    table.add_column("")
    for name, unit in units.items():
        table.add_column(f"{name} [{unit}]", justify="right")
    for row in rows(result, prediction):
        cells = [_cell(row.errors, name) for name in units]
        table.add_row(row.words, *cells)
    reference = REFERENCES[prediction.reference]
    return [
        f"Predicted rms error over the workspace, {reference}:",
        *console.table_lines(table),
        *remarks(result, prediction),
    ]


def shown_components(prediction: PredictionSection) -> dict[str, str]:
    """{component: unit} of those that the controller corrects; all where it does none."""
    components = prediction.components
    driven = {n: c.after.unit for n, c in components.items() if c.compensatable}
    return driven or {n: c.after.unit for n, c in components.items()}


def rows(result: StudyResult, prediction: PredictionSection) -> list[AccuracyRow]:
    """The lines of the table."""
    components = prediction.components
    lines = [AccuracyRow("before", {n: c.before.rms for n, c in components.items()})]
    corrected = result.corrected
    if corrected is not None:
        alone = {n: s.rms for n, s in corrected.parameters_only.items()}
        lines.append(AccuracyRow("parameters compensated alone", alone))
    after = "after compensation"
    if corrects_effects(result):
        after = "effects compensated too"
    lines.append(AccuracyRow(after, {n: c.after.rms for n, c in components.items()}))
    budget = prediction.budget
    if budget is None and corrected is None and result.prediction is not None:
        budget = result.prediction.budget
    if budget is None:
        return lines
    for worst in budget.unmodelled[:1]:
        words = f"+ {worst.effect} of {worst.expected}, not in the model"
        lines.append(AccuracyRow(words, worst.with_it))
    if budget.usual is not None:
        lines += _usual_rows(budget.usual)
    units = shown_components(prediction)
    for words, better in improvements(budget.lines, budget.predicted, units):
        lines.append(AccuracyRow(f"with {words}", better))
    return lines


def _usual_rows(usual: UsualEffects) -> list[AccuracyRow]:
    """The machine with all usual effects, without and with them in the fit."""
    count = len(usual.effects)
    if count == 1:
        return [AccuracyRow("the same, in the fit and corrected", usual.fitted)]
    return [
        AccuracyRow(f"+ all {count} usual effects, not in the model", usual.unmodelled),
        AccuracyRow("the same, in the fit and corrected", usual.fitted),
    ]


def remarks(result: StudyResult, prediction: PredictionSection) -> list[str]:
    """What the lines rest on, and the remedy for an effect that the model lacks."""
    others = without_drive(prediction).strip()
    sentences = [others] if others else []
    if result.corrected is not None:
        conditions = "; ".join(result.corrected.conditions)
        sentences.append(f"This rests on these conditions: {conditions}.")
    budget = prediction.budget
    if budget is not None and budget.unmodelled:
        worst = budget.unmodelled[0]
        sentences.append(
            f"The prediction is geometry alone, without {worst.effect}: calibration takes"
            f" some of it for geometry, and sizes vary by decades. Remedy:"
            f" {worst.remedy}. Readings of the machine are asked which effects act."
        )
    return sentences


def _cell(errors: Mapping[str, float], name: str) -> str:
    return format_number(errors[name]) if name in errors else ""
