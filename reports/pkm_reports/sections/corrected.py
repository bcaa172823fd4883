"""Chapter: parameters and effects estimated together, and the accuracy that follows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from oed.result import CorrectedSection, EffectEstimate, PredictionSection, StudyResult
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Notice,
    Paragraph,
    Table,
    TableColumn,
    headed_list,
    number_columns,
)
from pkm_reports.sections import budget
from pkm_reports.sections.accuracy_ranges import figures

#: coefficients in standard deviations from which on they are listed
CLEAR: Final = 2.0


def blocks(result: StudyResult) -> list[Block]:
    """Conditions, parameters beside those of the fit without effects, effects, accuracy."""
    corrected = result.corrected
    if corrected is None:
        return []
    chapter: list[Block] = [Notice(text.sentence(w)) for w in corrected.warnings]
    chapter.append(Paragraph(_introduction(corrected)))
    chapter += headed_list("The corrected accuracy rests on:", corrected.conditions)
    chapter.append(_parameters(result, corrected))
    chapter.append(_effects(corrected.effects))
    if corrected.prediction is not None:
        section = corrected.prediction
        chapter.append(_accuracy(corrected, section))
        if section.budget is not None:
            chapter += budget.blocks(section.budget, section.components)
    return chapter


def _introduction(corrected: CorrectedSection) -> str:
    source = (
        "that the diagnosis selected"
        if corrected.origin == "diagnosis"
        else "that were named"
    )
    return (
        f"Parameters and the effects {source} ({text.listing(corrected.constants)}) are"
        " estimated together, so that the effects do not bend the parameters."
        " Compensation, verification and comparison take these values."
    )


def _parameters(result: StudyResult, corrected: CorrectedSection) -> Table:
    columns = [
        TableColumn("Parameter"),
        *number_columns("Nominal", "Without effects", "Corrected", "sd", "Change / sd"),
    ]
    without = {} if result.estimate is None else result.estimate.parameters
    rows = []
    for name, p in corrected.parameters.items():
        before = without.get(name)
        decimals = text.decimals_for(p.sd)
        cells = [
            f"{name} [{text.unit_symbol(p.unit)}]",
            text.fixed(p.nominal, decimals),
        ]
        if before is None:
            cells += ["", text.fixed(p.value, decimals), text.number(p.sd, 2), ""]
        else:
            change = (p.value - before.value) / p.sd if p.sd > 0.0 else 0.0
            cells += [
                text.fixed(before.value, decimals),
                text.fixed(p.value, decimals),
                text.number(p.sd, 2),
                text.fixed(change, 1),
            ]
        rows.append(cells)
    caption = (
        "Parameters by the fit without effects and with them. The change is in standard"
        " deviations of the corrected value."
    )
    return Table(columns, rows, caption)


def _effects(effects: Mapping[str, EffectEstimate]) -> Table:
    clear = {
        name: e
        for name, e in effects.items()
        if not e.shape or abs(e.value) > CLEAR * e.sd
    }
    columns = [TableColumn("Coefficient"), *number_columns("Value", "sd", "Expected")]
    rows = [
        [
            f"{name} [{text.unit_symbol(e.unit)}]",
            text.number(e.value),
            text.number(e.sd, 2),
            text.number(e.prior_sd, 2),
        ]
        for name, e in clear.items()
    ]
    caption = (
        "Coefficients of the effects: those of the textbook's form, and others beyond"
        f" {CLEAR:.0f} standard deviations. Expected: prior standard deviation."
    )
    return Table(columns, rows, caption)


def _accuracy(corrected: CorrectedSection, prediction: PredictionSection) -> Table:
    columns = [
        TableColumn("Component"),
        *number_columns("Before", "Parameters alone", "With effects", "p95", "max"),
    ]
    rows = []
    for name, c in prediction.components.items():
        alone = corrected.parameters_only[name]
        cells = [text.number(c.before.rms), text.number(alone.rms)]
        unit = text.unit_symbol(c.after.unit)
        rows.append([f"{name} [{unit}]", *cells, *figures(c.after)])
    caption = (
        "Predicted errors over the workspace in the states of these readings: rms"
        " uncompensated, with the parameters alone compensated, and with the effects"
        " compensated as well, which needs the conditions above."
    )
    return Table(columns, rows, caption)


CHAPTER: Final = Chapter("corrected", "Corrected model", blocks)
