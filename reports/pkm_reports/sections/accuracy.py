"""Chapter: the accuracy before and after, by component and over the workspace."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from oed.result import (
    ComponentAccuracy,
    MapPoint,
    PredictionSection,
    SpreadRecord,
    StudyResult,
)
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    number_columns,
)
from pkm_reports.sections import accuracy_ranges
from pkm_reports.sections import budget as budget_lines
from pkm_reports.sections.figures import accuracy, budget, map_layout, workspace

Components = Mapping[str, ComponentAccuracy]
REFERENCES: Final = {
    "absolute": "absolute: position and orientation in the base frame",
    "home": "relative to home: the machine is zeroed at its home pose",
    "best_fit": "after the best rigid fit: the workpiece is aligned to the machine",
}
MODES: Final = {
    "plan": "predicted before any reading is taken, from tolerances, plan and noise",
    "identified": "predicted with the identified parameters",
}


def blocks(result: StudyResult) -> list[Block]:
    """Bars, table, virtual machine, budget, map."""
    prediction = result.prediction
    if prediction is None:
        return []
    components = prediction.components
    chapter: list[Block] = [
        Paragraph(_introduction(prediction)),
        Paragraph(_verdict(components)),
        Picture(
            "accuracy", lambda: accuracy.draw(prediction), _bars_caption(components)
        ),
        _table(components),
        *accuracy_ranges.blocks(prediction),
    ]
    if prediction.realised:
        chapter.append(_realised(prediction, prediction.realised))
    if any(component.budget for component in components.values()):
        caption = _budget_caption(components)
        chapter.append(Picture("budget", lambda: budget.draw(components), caption))
    if prediction.budget is not None:
        chapter += budget_lines.blocks(prediction.budget, components)
    if prediction.map:
        caption = _map_caption(prediction)
        chapter.append(
            Picture("workspace", lambda: workspace.draw(prediction), caption)
        )
    return chapter


def printed(result: StudyResult) -> list[Block]:
    """The bars."""
    prediction = result.prediction
    if prediction is None:
        return []
    caption = _bars_caption(prediction.components)
    if prediction.budget is not None and prediction.budget.unmodelled:
        caption += " Geometry alone; the first page counts usual effects as well."
    return [Picture("accuracy", lambda: accuracy.draw(prediction), caption)]


# -- what the controller can correct ---------------------------------------------------


def _introduction(prediction: PredictionSection) -> str:
    reference = text.meaning(prediction.reference, REFERENCES)
    mode = text.meaning(prediction.mode, MODES)
    poses = text.count(prediction.poses, "workspace pose")
    return (
        f"Errors of the pose over {poses}, {mode}. Reference: {reference}. Numbers are"
        f" 1-sigma errors, pooled over the workspace.{_states(prediction)}"
    )


def _states(prediction: PredictionSection) -> str:
    """At which states effects act, and where these come from."""
    if not prediction.states:
        return ""
    source = "as the study states"
    if prediction.states_from == "readings":
        source = "as the readings recorded, for the study states none"
    parts = [
        f"{column} {', '.join(f'{value:g}' for value in values)}"
        for column, values in prediction.states.items()
    ]
    return f" The machine is used at {'; '.join(parts)}: {source}."


def _verdict(components: Components) -> str:
    """What the controller can correct, by how much, and what it cannot."""
    corrected, others = [], []
    for name, component in components.items():
        if component.compensatable:
            corrected.append(_improvement(name, component))
        else:
            others.append(_remainder(name, component))
    if corrected:
        sentences = [f"The controller can correct {text.listing(corrected)}."]
    else:
        sentences = ["The controller can correct none of them."]
    if others:
        sentences += [
            f"No axis corrects the others alone: {text.listing(others)}.",
            "A additional axis could correct them, or software that uses the known error.",
        ]
    return " ".join(sentences)


def _improvement(name: str, component: ComponentAccuracy) -> str:
    unit = component.after.unit
    before = text.quantity(component.before.rms, unit)
    after = text.quantity(component.after.rms, unit)
    if before == after:
        return f"{name}, which stays at {after}"
    return f"{name} from {before} to {after}"


def _remainder(name: str, component: ComponentAccuracy) -> str:
    unit = component.after.unit
    after = text.quantity(component.after.rms, unit)
    remaining = text.quantity(component.known.rms, unit)
    return f"{name} stays at {after} (known to {remaining})"


def _bars_caption(components: Components) -> str:
    caption = (
        "Rms error of each component over the workspace, before and after, on a log"
        " scale."
    )
    if not all(component.compensatable for component in components.values()):
        caption += " A star marks components that the controller cannot correct."
    gains = {
        name: component.before.rms / component.after.rms
        for name, component in components.items()
        if component.compensatable and component.after.rms > 0.0
    }
    if not gains:
        return caption
    best = max(gains, key=lambda name: gains[name])
    worst = min(gains, key=lambda name: gains[name])
    high, low = text.number(gains[best], 2), text.number(gains[worst], 2)
    caption += f" Calibration divides the error of {best} by {high}"
    return f"{caption}." if high == low else f"{caption} and of {worst} by {low}."


def _table(components: Components) -> Table:
    states: Sequence[accuracy.State] = ("before", "after", "known")
    if accuracy.all_correctable(components):
        states = states[:2]
    columns = [TableColumn("Component"), TableColumn("Correctable")]
    for state in states:
        columns += number_columns(f"{state}: rms", "p95", "max")
    rows = [_row(name, component, states) for name, component in components.items()]
    caption = (
        "Errors before and after compensation: rms, 95th percentile and largest over"
        " the workspace. Percentiles and largest errors are of drawn machines, with the"
        " digits that their number allows."
    )
    if "known" in states:
        caption += (
            " Known: the error that remains if an additional axis, or software, corrects"
            " the component as well."
        )
    return Table(columns, rows, caption)


def _row(
    name: str, component: ComponentAccuracy, states: Sequence[accuracy.State]
) -> list[str]:
    cells = [
        f"{name} [{text.unit_symbol(component.after.unit)}]",
        "yes" if component.compensatable else "no",
    ]
    for state in states:
        cells += _sizes(accuracy.spread(component, state))
    return cells


def _sizes(spread: SpreadRecord) -> list[str]:
    return accuracy_ranges.figures(spread)


# -- virtual machine, budget, map ------------------------------------------------------


def _realised(
    prediction: PredictionSection, realised: Mapping[str, SpreadRecord]
) -> Table:
    rows, ratios = [], []
    for name, spread in realised.items():
        predicted = math.nan
        if name in prediction.components:
            predicted = prediction.components[name].after.rms
        ratio = spread.rms / predicted if predicted > 0.0 else math.nan
        ratios.append(ratio)
        cells = [f"{name} [{text.unit_symbol(spread.unit)}]", *_sizes(spread)]
        rows.append([*cells, text.number(predicted), text.fixed(ratio, 2)])
    columns = [
        TableColumn("Component"),
        *number_columns("Rms", "p95", "max", "Predicted rms", "Realised / predicted"),
    ]
    caption = (
        "Errors of a virtual machine after compensation; its true parameters are known."
    )
    finite = [ratio for ratio in ratios if math.isfinite(ratio)]
    if finite:
        low, high = text.fixed(min(finite), 2), text.fixed(max(finite), 2)
        caption += f" Realised over predicted: {low} to {high}."
    return Table(columns, rows, caption)


def _budget_caption(components: Components) -> str:
    """The largest source of each component."""
    shares: dict[str, dict[str, float]] = {}
    for name, component in components.items():
        budget_of = component.budget
        if budget_of:
            source = max(budget_of, key=lambda key: budget_of[key])
            shares.setdefault(source, {})[name] = budget_of[source]
    largest = [_source(source, of) for source, of in shares.items()]
    verdict = (
        f"The largest source is {largest[0]}: reduce it first."
        if len(largest) == 1
        else f"The largest sources are {text.listing(largest)}: reduce them first."
    )
    return f"Sources of the variance that remains. {verdict}"


def _source(source: str, shares: Mapping[str, float]) -> str:
    most = text.percent(max(shares.values()))
    return f"{source} for {text.listing(shares)} (up to {most})"


def _map_caption(prediction: PredictionSection) -> str:
    """Where each component is worst and best."""
    sentences = ["1-sigma error after compensation over the workspace."]
    if set(map_layout.POLAR) <= set(prediction.map[0].command):
        sentences.append("The angle in the figure is psi, the radius theta.")
    for name in workspace.shown_components(prediction):
        errors = workspace.errors(prediction, name)
        if np.isfinite(errors).any():
            worst = prediction.map[int(np.nanargmax(errors))]
            best = prediction.map[int(np.nanargmin(errors))]
            unit = prediction.components[name].after.unit
            most, least = _error_at(worst, name, unit), _error_at(best, name, unit)
            sentences.append(f"{name} is largest, {most}, and smallest, {least}.")
    return " ".join(sentences)


def _error_at(point: MapPoint, name: str, unit: str) -> str:
    error = text.quantity(point.after[name], unit)
    return f"{error}, at {text.named_quantities(point.command, 4)}"


CHAPTER: Final = Chapter("accuracy", "Residual accuracy", blocks, printed)
