"""How accurate the machine is afterwards, with what is wanted beside it."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

from oed.result import (
    ComponentAccuracy,
    PlanSection,
    PredictionSection,
    SpreadRecord,
    StudyResult,
)
from pkm_reports.page import missing, text
from pkm_reports.page.blocks import (
    Block,
    Notice,
    Paragraph,
    Table,
    TableColumn,
    number_columns,
)
from pkm_reports.sections import acceptance, accuracy_ranges, forecast
from pkm_reports.sections.stages import wording

REFERENCES: Final = {
    "absolute": "in the base frame",
    "home": "zeroed at the home pose",
    "best_fit": "after the best alignment of the workpiece",
}
#: share of an error from which its unknown part is worth a sentence of its own
CLEARLY_LESS: Final = 0.8


LIMIT_COLUMNS: Final = (TableColumn("Wanted", number=True), TableColumn("Reached"))


@dataclasses.dataclass(frozen=True, slots=True)
class AgainstGoal:
    """Rms of one component against what is wanted of it, in one unit."""

    reached: float
    wanted: float

    @property
    def words(self) -> str:
        """Whether the wanted accuracy is reached; a dash where none is stated."""
        if math.isnan(self.wanted):
            return text.MISSING
        return "✓ yes" if self.is_reached else "✗ no"

    @property
    def is_reached(self) -> bool:
        """Whether the rms error is at most what is wanted."""
        return self.reached <= self.wanted

    @property
    def mark(self) -> str:
        """Mark of the component's row."""
        if math.isnan(self.wanted):
            return ""
        return "good" if self.is_reached else "bad"


def title(result: StudyResult) -> str:
    """The question that the part answers."""
    return "How accurate it is afterwards"


def blocks(result: StudyResult) -> list[Block]:
    """Acceptance test and held-out readings, then the predicted components."""
    content: list[Block] = []
    if result.verification is not None:
        content.append(Notice(acceptance.verdict(result.verification)))
    content += _held_out(result)
    prediction = final_prediction(result)
    if prediction is not None and prediction.components:
        content += _predicted(result, prediction)
    elif result.plan is not None and result.plan.accuracy:
        content.append(_planned(result.plan))
    if result.forecast is not None:
        content.append(forecast.answer(result.forecast))
    return content


def _held_out(result: StudyResult) -> list[Block]:
    """What readings that the fit did not use say of it."""
    sentences = [
        (s.verdict, text.sentence(s.words)) for s in result.held_out if s.words
    ]
    return [
        Notice(words) if verdict == "contradicts" else Paragraph(words)
        for verdict, words in sentences
    ]


def final_prediction(result: StudyResult) -> PredictionSection | None:
    """The prediction with effects compensated where there is one."""
    corrected = result.corrected
    if corrected is not None and corrected.prediction is not None:
        return corrected.prediction
    return result.prediction


# -- what is wanted --------------------------------------------------------------------


def wanted(result: StudyResult) -> dict[str, float]:
    """Accuracy that the study asks for, by component and unit (`z_um`)."""
    accuracies: dict[str, float] = {}
    if result.design is not None and result.design.how_many is not None:
        accuracies |= result.design.how_many.wanted
    if result.plan is not None:
        accuracies |= result.plan.goal
    prediction = final_prediction(result)
    if prediction is not None:
        unit = prediction.unit
        accuracies |= {f"{n}_{unit[n]}": v for n, v in prediction.wanted.items()}
    return accuracies


def verdict(
    name: str, component: ComponentAccuracy, limits: dict[str, float]
) -> AgainstGoal:
    """The rms that matters of a component against its limit; NaN where none is stated."""
    key = f"{name}_{component.after.unit}"
    return AgainstGoal(component.judged.rms, missing.entry(limits, key))


# -- the components --------------------------------------------------------------------


def _predicted(result: StudyResult, prediction: PredictionSection) -> list[Block]:
    limits = wanted(result)
    components = prediction.components
    judged = {name: verdict(name, c, limits) for name, c in components.items()}
    with_limits = any(math.isfinite(v.wanted) for v in judged.values())
    columns = [
        TableColumn("Component"),
        *number_columns("Afterwards", "Unknown part"),
        *(LIMIT_COLUMNS if with_limits else []),
        *number_columns("Before"),
    ]
    rows, marks = [], []
    for name in _ordered(components, judged):
        rows.append(_row(name, components[name], judged[name], with_limits))
        marks.append(judged[name].mark)
    table = Table(columns, rows, _caption(prediction, judged), marks)
    return [
        table,
        *_unmodelled(prediction),
        *_unknown_part(components),
        *_worst_case(prediction),
    ]


def _ordered(
    components: dict[str, ComponentAccuracy], judged: dict[str, AgainstGoal]
) -> list[str]:
    """Components with a limit first, then those that the controller corrects."""

    def rank(name: str) -> tuple[bool, bool]:
        no_limit = math.isnan(judged[name].wanted)
        return no_limit, not components[name].compensatable

    return sorted(components, key=rank)


def _row(
    name: str, component: ComponentAccuracy, judged: AgainstGoal, with_limits: bool
) -> list[str]:
    unit = text.unit_symbol(component.after.unit)
    before, after = text.number(component.before.rms), text.number(component.after.rms)
    cells = [f"{name} [{unit}]", after, text.number(component.known.rms)]
    limits = [text.number(judged.wanted), judged.words] if with_limits else []
    return [*cells, *limits, before]


def _caption(prediction: PredictionSection, judged: dict[str, AgainstGoal]) -> str:
    reference = text.meaning(prediction.reference, REFERENCES)
    caption = f"Predicted rms error over the workspace, {reference} (1 sigma)."
    stated = [v for v in judged.values() if math.isfinite(v.wanted)]
    if not stated:
        return f"{caption} The study states no wanted accuracy."
    reached = sum(v.is_reached for v in stated)
    return (
        f"{caption} {reached} of {len(stated)} wanted accuracies are reached; what no"
        " drive corrects is judged by its unknown part."
    )


def _unknown_part(components: dict[str, ComponentAccuracy]) -> list[Block]:
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
    axes = text.listing(remaining)
    return [
        Paragraph(
            f"No drive of this machine corrects {axes}. So {name} keeps an error of"
            f" {after}, although the calibrated model knows most of it: {unknown} of it"
            " is unknown. A further axis, or a part program, that takes the known error"
            " back leaves only the unknown part: the table of `oed compensate` has it in"
            " columns with `offset`."
        )
    ]


def _unmodelled(prediction: PredictionSection) -> list[Block]:
    """What the effect outside the model that adds most would make of the accuracy."""
    if prediction.budget is None or not prediction.budget.unmodelled:
        return []
    worst = prediction.budget.unmodelled[0]
    components = prediction.components
    driven = [name for name, c in components.items() if c.compensatable]
    changes = []
    for name in driven or list(components):
        after = components[name].after
        larger = text.quantity(worst.with_it[name], after.unit)
        changes.append(f"{name} from {text.number(after.rms)} to {larger}")
    effect = worst.effect.replace("_", " ")
    far = ""
    if worst.far:
        largest = [
            text.quantity(worst.far[n], components[n].after.unit)
            for n in driven or list(components)
        ]
        far = (
            f" Sizes vary by decades: a very large one brings {text.listing(largest)}."
        )
    return [
        Notice(
            f"This is geometry alone. {effect.capitalize()} of its expected size"
            f" ({text.with_symbols(worst.expected)}), which the model lacks, brings"
            f" {text.listing(changes)}: calibration takes a part of it for geometry."
            f"{far} Remedy: {worst.remedy.rstrip('.')}."
        )
    ]


def _worst_case(prediction: PredictionSection) -> list[Block]:
    """The largest error of what the controller corrects, which rms hides."""
    worst = [
        f"{name} {text.with_unit(_largest(c.after), c.after.unit)}"
        for name, c in prediction.components.items()
        if c.compensatable
    ]
    if not worst:
        return []
    words = "Largest error over the workspace, which 95 % of such machines stay below"
    return [Paragraph(f"{words}: {text.listing(worst)}.")]


def _largest(spread: SpreadRecord) -> str:
    return accuracy_ranges.figures(spread)[-1]


def _planned(plan: PlanSection) -> Table:
    """Accuracy of a plan of stages, which has no prediction of its own."""
    columns = [
        TableColumn("Component"),
        *number_columns("Afterwards"),
        *(LIMIT_COLUMNS if plan.goal else []),
        *number_columns("Before"),
    ]
    rows, marks = [], []
    for key, value in plan.accuracy.items():
        judged = AgainstGoal(value, missing.entry(plan.goal, key))
        limits = [text.number(judged.wanted), judged.words] if plan.goal else []
        before = text.number(missing.entry(plan.start_accuracy, key))
        rows.append([text.heading(key), text.number(value), *limits, before])
        marks.append(judged.mark)
    within = wording.within_budget(plan)
    caption = f"Predicted rms error over the workspace after the plan{within}."
    return Table(columns, rows, caption, marks)
