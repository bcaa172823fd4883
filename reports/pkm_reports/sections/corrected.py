"""Chapter: parameters and effects estimated together, and the accuracy that follows."""

from collections.abc import Mapping
from typing import Final

from oed.result import (
    AdjustmentLine,
    AdjustmentSection,
    CorrectedSection,
    EffectEstimate,
    PredictionSection,
    StudyResult,
)
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Notice,
    Paragraph,
    Table,
    TableColumn,
    headed_list,
)
from pkm_reports.sections import accuracy
from pkm_reports.sections.accuracy import spread_figures
from pkm_reports.sections.gap_figures import spoken

#: coefficients in standard deviations from which on they are listed
MIN_COEFFICIENT_DEVIATIONS: Final = 2.0


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
            chapter += accuracy.budget_blocks(section.budget, section.components)
    return chapter


def _introduction(corrected: CorrectedSection) -> str:
    source = (
        "that the diagnosis selected"
        if corrected.origin == "diagnosis"
        else "that were named"
    )
    return (
        f"Parameters and the effects {source} ({text.listing(map(spoken, corrected.constants))}) are"
        " estimated together, so that the effects do not bend the parameters."
        " Verification, comparison and tables of effects take these values."
    )


def _parameters(result: StudyResult, corrected: CorrectedSection) -> Table:
    columns = [
        TableColumn("Parameter"),
        *TableColumn.numbers(
            "Nominal", "Without effects", "Corrected", "sd", "Change / sd"
        ),
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
        if not e.shape or abs(e.value) > MIN_COEFFICIENT_DEVIATIONS * e.sd
    }
    columns = [
        TableColumn("Coefficient"),
        *TableColumn.numbers("Value", "sd", "Expected"),
    ]
    rows = [
        [
            f"{name.replace(e.effect, spoken(e.effect))} [{text.unit_symbol(e.unit)}]",
            text.number(e.value),
            text.number(e.sd, 2),
            text.number(e.prior_sd, 2),
        ]
        for name, e in clear.items()
    ]
    caption = (
        "Coefficients of the effects: those of the textbook's form, and others beyond"
        f" {MIN_COEFFICIENT_DEVIATIONS:.0f} standard deviations. Expected: prior standard deviation."
    )
    return Table(columns, rows, caption)


def _accuracy(corrected: CorrectedSection, prediction: PredictionSection) -> Table:
    columns = [
        TableColumn("Component"),
        *TableColumn.numbers(
            "Before", "Parameters alone", "With effects", "p95", "max"
        ),
    ]
    rows = []
    for name, c in prediction.components.items():
        alone = corrected.parameters_only[name]
        cells = [text.number(c.before.rms), text.number(alone.rms)]
        unit = text.unit_symbol(c.after.unit)
        rows.append([f"{name} [{unit}]", *cells, *spread_figures(c.after)])
    caption = (
        "Predicted errors over the workspace in the states of these readings: rms"
        " uncompensated, with the parameters alone compensated, and with the effects"
        " compensated as well, which needs the conditions above."
    )
    return Table(columns, rows, caption)


CHAPTER: Final = Chapter("corrected", "Corrected model", blocks)

# Chapter: what to adjust at the machine, and the page for the fitter.

TO_FILL_IN: Final = ("Done", "Measured")  #: columns of the fitter's page to write in
NOTHING: Final = (
    "No adjustment is worth its work: software corrects what the adjustments would."
)


def adjustment_chapter_blocks(result: StudyResult) -> list[Block]:
    """The lines, and the accuracy after each."""
    section = result.adjustment
    if section is None:
        return []
    if not section.lines:
        return [
            Paragraph(f"{NOTHING} Total: {section.about}."),
            _adjusted_accuracy(section),
        ]
    return [
        Paragraph(_adjustment_introduction(section)),
        _lines(section),
        _adjusted_accuracy(section),
        *headed_list("The figures rest on:", section.conditions),
    ]


def adjustment_blocks(section: AdjustmentSection) -> list[Block]:
    """What the fitter's page has, with room to write."""
    return [
        Paragraph(_adjustment_introduction(section)),
        _lines(section, TO_FILL_IN),
        _adjusted_accuracy(section),
    ]


def _adjustment_introduction(section: AdjustmentSection) -> str:
    ends = [section.accuracy[k].total for k in (0, -1)]
    first, last = (text.quantity(total, section.total_unit) for total in ends)
    return (
        f"{text.count(len(section.lines), 'adjustment')} bring the total error after"
        f" compensation by software from {first} to {last}."
        f" Total: {section.about}. Without any one of the lines it is more than 5 %"
        " larger. Give the controller the parameters after the adjustment (oed compensate"
        " --adjusted), then measure again."
    )


def _lines(section: AdjustmentSection, further: tuple[str, ...] = ()) -> Table:
    columns = [
        TableColumn("No."),
        TableColumn("Adjustment"),
        *TableColumn.numbers("Amount", "Steps"),
        TableColumn("Moves", wide=True),
        *TableColumn.numbers("Without it"),
        *(TableColumn(title) for title in further),
    ]
    rows = [
        [str(k), *_line(line, section.total_unit), *[""] * len(further)]
        for k, line in enumerate(section.lines, start=1)
    ]
    caption = (
        "Adjustments in working order. “Without it”: total error of the list without this"
        " line, with the others chosen anew."
    )
    return Table(columns, rows, caption)


def _line(line: AdjustmentLine, total_unit: str) -> list[str]:
    return [
        line.by,
        signed(line),
        "" if line.steps is None else f"{line.steps:+d}".replace("-", "−"),
        f"{line.about} ({line.parameter})",
        text.quantity(line.without, total_unit),
    ]


def signed(line: AdjustmentLine) -> str:
    """The amount with its sign and unit: `+0.34 mm`."""
    sign = "+" if line.amount > 0.0 else ""
    return sign + text.append_unit(text.trimmed(line.amount, 6), line.unit)


def _adjusted_accuracy(section: AdjustmentSection) -> Table:
    units = section.unit.items()
    titles = [f"{name} [{text.unit_symbol(unit)}]" for name, unit in units]
    columns = [
        TableColumn("After"),
        TableColumn("Controller"),
        *TableColumn.numbers("Total", *titles),
    ]
    rows = []
    for k, record in enumerate(section.accuracy):
        after = f"line {k}" if k else "nothing"
        plain = [text.number(v) for v in record.plain.values()]
        corrected = [text.number(v) for v in record.corrected.values()]
        rows.append([after, "as it is", "", *plain])
        total = text.quantity(record.total, section.total_unit)
        rows.append(["", "compensated", total, *corrected])
    caption = (
        f"Predicted rms errors over {section.poses} poses, reference"
        f" {section.reference}, after each line: with the nominal numbers in the"
        " controller, and once software compensates all that is known."
    )
    return Table(columns, rows, caption)


ADJUSTMENT_CHAPTER: Final = Chapter(
    "adjustment",
    "Adjustments at the machine",
    adjustment_chapter_blocks,
    adjustment_chapter_blocks,
)
