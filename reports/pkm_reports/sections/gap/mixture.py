"""Chapter: parameters and accuracy over all answers of a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from oed.result import CompensationName, MixtureSection, PredictionSection, StudyResult
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Paragraph,
    Table,
    TableColumn,
    number_columns,
)
from pkm_reports.sections.accuracy_ranges import figures

#: compensations that a controller can be sent, as a reader knows them
COMPENSATIONS: Final = {
    CompensationName.MIXTURE: "Geometry, over all answers",
    CompensationName.BEST: "Geometry, best answer alone",
    CompensationName.PLAIN: "Geometry, fit without effects",
    CompensationName.BEST_WITH_EFFECTS: "Best answer with its effects corrected",
    CompensationName.NOTHING: "Nothing corrected",
}


def blocks(result: StudyResult) -> list[Block]:
    """Answers, expected errors of each compensation, parameters with their intervals."""
    section = None if result.gap is None else result.gap.mixture
    if section is None:
        return []
    chapter: list[Block] = [Paragraph(" ".join(text.sentences(section.words)))]
    if section.prediction is not None:
        chapter.append(_choices(section, section.prediction))
        chapter += _accuracy(section)
    chapter.append(_parameters(section))
    return chapter


def printed(result: StudyResult) -> list[Block]:
    """The parameters that are delivered."""
    section = None if result.gap is None else result.gap.mixture
    return [] if section is None else [_parameters(section)]


def _choices(section: MixtureSection, prediction: PredictionSection) -> Table:
    """A row for each compensation."""
    names = list(prediction.components)
    units = [text.unit_symbol(prediction.unit[name]) for name in names]
    heads = [f"{name} [{unit}]" for name, unit in zip(names, units, strict=True)]
    rows = [
        [COMPENSATIONS[choice.name], *(text.number(choice.rms[n]) for n in names)]
        for choice in section.choices
    ]
    caption = (
        "Rms error over the workspace that is expected after each compensation, as the"
        " mean over the answers by their probabilities."
    )
    return Table([TableColumn("Compensation"), *number_columns(*heads)], rows, caption)


def _accuracy(section: MixtureSection) -> list[Block]:
    """Figures with intervals of what is sent: geometry, and with effects if any."""
    tables: list[Block] = []
    for name, prediction in (
        (section.sent or CompensationName.MIXTURE, section.prediction),
        (CompensationName.BEST_WITH_EFFECTS, section.with_effects),
    ):
        if prediction is None:
            continue
        columns = [TableColumn("Component")]
        columns += number_columns("rms", "p95", "max", "rms of 95 % of machines")
        rows = []
        for component, accuracy in prediction.components.items():
            unit = text.unit_symbol(accuracy.after.unit)
            rows.append(
                [
                    f"{component} [{unit}]",
                    *figures(accuracy.after),
                    _span(accuracy.after.rms_interval),
                ]
            )
        about = COMPENSATIONS[name].lower()
        caption = f"Predicted errors with this compensation: {about}."
        tables.append(Table(columns, rows, caption))
    return tables


def _span(ends: Sequence[float] | None) -> str:
    if ends is None:
        return ""
    low, high = (text.number(end, 2) for end in ends)
    return f"{low} to {high}"


def _parameters(section: MixtureSection) -> Table:
    columns = [
        TableColumn("Parameter"),
        *number_columns("Value", "sd", "Within the answers", "95 % interval"),
        *number_columns("For the controller"),
    ]
    rows = []
    for name, p in section.parameters.items():
        decimals = text.decimals_for(p.sd)
        sent = section.controller.get(name)
        rows.append(
            [
                f"{name} [{text.unit_symbol(p.unit)}]",
                text.fixed(p.value, decimals),
                text.number(p.sd, 2),
                text.number(p.within, 2),
                f"{text.fixed(p.low, decimals)} to {text.fixed(p.high, decimals)}",
                "" if sent is None else text.fixed(sent, decimals),
            ]
        )
    caption = (
        "Parameters over all answers. What the standard deviation has beyond that within"
        " the answers is between them. A controller that corrects geometry alone takes"
        " the last column: those of the least expected error."
    )
    return Table(columns, rows, caption)


CHAPTER: Final = Chapter("mixture", "Over all hypotheses", blocks, printed)
