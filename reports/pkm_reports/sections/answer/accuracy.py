"""How accurate the machine is afterwards, with what is wanted beside it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

from oed.result import (
    ComponentAccuracy,
    HeldOutSection,
    PlanSection,
    PredictionSection,
    SpreadRecord,
    StudyResult,
    WantedVerdict,
)
from oed.text import format_probability
from oed.verdict import SURE_PROBABILITY, accuracy_verdicts
from pkm_reports import missing, text
from pkm_reports.blocks import (
    Block,
    Notice,
    Paragraph,
    Table,
    TableColumn,
    number_columns,
)
from pkm_reports.sections import acceptance, forecast
from pkm_reports.sections.stages import chapter

REFERENCES: Final = {
    "absolute": "in the base frame",
    "home": "zeroed at the home pose",
    "best_fit": "after the best alignment of the workpiece",
}
#: effects that a caption names
MOST_EFFECTS: Final = 4
#: share of an error from which its unknown part is worth a sentence of its own
CLEARLY_LESS: Final = 0.8


LIMIT_COLUMNS: Final = (
    TableColumn("Wanted", number=True),
    TableColumn("Within", number=True),
    TableColumn("Verdict"),
)


def title(result: StudyResult) -> str:
    """The question that the part answers."""
    return "How accurate it is afterwards"


def blocks(result: StudyResult) -> list[Block]:
    """Acceptance test, the predicted components, and held-out readings."""
    content: list[Block] = []
    if result.verification is not None:
        content.append(Notice(acceptance.verdict(result.verification)))
    prediction = result.judged_prediction
    if prediction is not None and prediction.components:
        content += _predicted(result, prediction)
    elif result.plan is not None and result.plan.accuracy:
        content.append(_planned(result.plan))
    if result.forecast is not None:
        content.append(forecast.answer(result.forecast))
    return content + _held_out(result)


def _held_out(result: StudyResult) -> list[Block]:
    """What readings that the fit did not use say of it: a table where all fit."""
    judged = [s for s in result.held_out if s.words]
    fitting = [s for s in judged if s.verdict != "contradicts"]
    if len(fitting) < 2:
        fitting = []
    content: list[Block] = [
        Notice(text.sentence(s.words))
        if s.verdict == "contradicts"
        else Paragraph(text.sentence(s.words))
        for s in judged
        if s not in fitting
    ]
    return [*content, _held_out_table(fitting)] if fitting else content


def _held_out_table(sections: Sequence[HeldOutSection]) -> Table:
    verdicts = [s.verdict or text.MISSING for s in sections]
    differ = len(set(verdicts)) > 1
    columns = [
        TableColumn("Channel"),
        *number_columns("Predicted", "Seen", "Nominal", "Inside"),
        *([TableColumn("Verdict")] if differ else []),
    ]
    several = len({s.name for s in sections}) > 1
    rows = []
    for s, judgement in zip(sections, verdicts, strict=True):
        where = f"{s.name}, " if several else ""
        errors = [missing.or_nan(v) for v in (s.predicted, s.rms, s.rms_before)]
        rows.append(
            [
                f"{where}{s.channel} [{text.unit_symbol(s.unit)}]",
                *map(text.number, errors),
                text.percent(s.coverage),
                *([judgement] if differ else []),
            ]
        )
    names = text.listing(dict.fromkeys(f"{s.name} ({s.n})" for s in sections))
    caption = (
        f"Held-out readings of {names}, rms: predicted, seen, and with the nominal"
        " numbers; the share inside the predicted 95 %."
    )
    if not differ and verdicts[0] == "confirms":
        caption += " All channels confirm the fit."
    elif not differ and verdicts[0] == "agrees":
        caption += " All channels agree with the fit, none confirms it."
    return Table(columns, rows, caption)


# -- what is wanted --------------------------------------------------------------------


def wanted_accuracy(result: StudyResult) -> dict[str, float]:
    """Accuracy that the study asks for, by component and unit (`z_um`)."""
    accuracies: dict[str, float] = {}
    if result.design is not None and result.design.how_many is not None:
        accuracies |= result.design.how_many.wanted
    if result.plan is not None:
        accuracies |= result.plan.goal
    prediction = result.judged_prediction
    if prediction is not None:
        unit = prediction.unit
        accuracies |= {f"{n}_{unit[n]}": v for n, v in prediction.wanted.items()}
    return accuracies


def verdicts(
    result: StudyResult, components: Mapping[str, ComponentAccuracy]
) -> dict[str, WantedVerdict]:
    """The verdict on all that the study asks for, by predicted component."""
    goals = wanted_accuracy(result)
    limits = {
        name: missing.entry(goals, f"{name}_{c.after.unit}")
        for name, c in components.items()
    }
    stated = {name: limit for name, limit in limits.items() if math.isfinite(limit)}
    return accuracy_verdicts(result, stated)


# -- the components --------------------------------------------------------------------


def remaining_errors(
    result: StudyResult, components: Mapping[str, ComponentAccuracy]
) -> dict[str, WantedVerdict]:
    """The error of each component that verdicts rest on, effects counted.

    Of components that the controller corrects or the study wants something of; all
    where there are none.
    """
    goals = verdicts(result, components)
    shown = [n for n, c in components.items() if n in goals or c.compensatable]
    names = sorted(shown or components, key=lambda name: name not in goals)
    return accuracy_verdicts(result, dict.fromkeys(names, math.inf))


def _predicted(result: StudyResult, prediction: PredictionSection) -> list[Block]:
    components = prediction.components
    judged = verdicts(result, components)
    errors = remaining_errors(result, components)
    columns = [
        TableColumn("Component"),
        *number_columns("Before", "Afterwards", "95 % of machines"),
        *(LIMIT_COLUMNS if judged else []),
    ]
    rows, marks = [], []
    for name, error in errors.items():
        before, unit = components[name].before.rms, text.unit_symbol(error.unit)
        cells = [f"{name} [{unit}]", text.number(before), text.number(error.rms)]
        cells.append(_span(components[name].judged, error.rms))
        rows.append([*cells, *_limit_cells(name, judged)])
        marks.append(text.MARKS[judged[name].judgement] if name in judged else "")
    table = Table(columns, rows, _caption(prediction, errors, judged), marks)
    return [table, *_undriven(components)]


def _span(spread: SpreadRecord, rms: float) -> str:
    """Ends of the interval of one machine's rms error, in proportion to a larger error."""
    if spread.rms_interval is None or not spread.rms > 0.0:
        return ""
    low, high = (text.number(end * rms / spread.rms, 2) for end in spread.rms_interval)
    return f"{low} to {high}"


def _limit_cells(name: str, judged: Mapping[str, WantedVerdict]) -> list[str]:
    """What is wanted, the probability that it is met, and the verdict."""
    if not judged:
        return []
    if name not in judged:
        return [text.MISSING] * len(LIMIT_COLUMNS)
    stated = judged[name]
    phrase = text.VERDICTS[stated.judgement]
    if stated.judgement == "pass":
        phrase += ", confirmed" if stated.confirmed else ", predicted"
    return [text.number(stated.wanted), format_probability(stated.probability), phrase]


def _caption(
    prediction: PredictionSection,
    errors: Mapping[str, WantedVerdict],
    judged: Mapping[str, WantedVerdict],
) -> str:
    reference = text.meaning(prediction.reference, REFERENCES)
    scopes = text.listing(dict.fromkeys(error.scope for error in errors.values()))
    caption = f"Predicted rms error over the workspace, {reference}: {scopes}."
    caption += _usual_effects(prediction)
    if not judged:
        return f"{caption} The study states no wanted accuracy."
    decide = dict.fromkeys(v.decide for v in judged.values() if v.decide)
    sentences = [
        caption,
        "Within: probability that the machine keeps what is wanted; it passes from"
        f" {text.percent(SURE_PROBABILITY)} on. What no drive corrects is judged by its"
        " unknown part.",
        *(f"To decide: {text.sentence(phrase)}" for phrase in decide),
    ]
    return " ".join(sentences)


def _usual_effects(prediction: PredictionSection) -> str:
    """Which effects a planned accuracy counts."""
    budget = prediction.budget
    if prediction.mode != "plan" or budget is None or budget.usual is None:
        return ""
    largest = [line.effect.replace("_", " ") for line in budget.unmodelled]
    return f" Effects, the largest first: {text.listing(largest, MOST_EFFECTS)}."


def _undriven(components: Mapping[str, ComponentAccuracy]) -> list[Block]:
    """Why an error can stay large although it is known: with this machine's numbers."""
    remaining = [
        name
        for name, c in components.items()
        if not c.compensatable and c.known.rms < CLEARLY_LESS * c.after.rms
    ]
    if not remaining:
        return []
    name = max(remaining, key=lambda n: components[n].after.rms)
    component = components[name]
    after = text.quantity(component.after.rms, component.after.unit)
    unknown = text.quantity(component.known.rms, component.after.unit)
    return [
        Paragraph(
            f"No drive of this machine corrects {text.listing(remaining)}: {name} keeps"
            f" {after}. All of it but {unknown} is known, and the compensation table has it"
            " for an additional axis or the part program."
        )
    ]


def _planned(plan: PlanSection) -> Table:
    """Accuracy of a plan of stages, which has no prediction of its own, and no verdict."""
    columns = [
        TableColumn("Component"),
        *number_columns("Afterwards"),
        *(number_columns("Wanted") if plan.goal else []),
        *number_columns("Before"),
    ]
    rows = []
    for key, value in plan.accuracy.items():
        limits = [text.number(missing.entry(plan.goal, key))] if plan.goal else []
        before = text.number(missing.entry(plan.start_accuracy, key))
        rows.append([text.heading(key), text.number(value), *limits, before])
    within = chapter.budget_phrase(plan)
    caption = f"Predicted rms error over the workspace after the plan{within}."
    return Table(columns, rows, caption)
