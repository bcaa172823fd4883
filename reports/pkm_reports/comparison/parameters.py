"""Parameters of one machine as several results have them."""

from __future__ import annotations

from collections.abc import Mapping

from oed.result import ParameterEstimate, StudyResult
from pkm_reports import text
from pkm_reports.blocks import Block, Table, TableColumn, number_columns

Estimates = Mapping[str, ParameterEstimate]


def blocks(results: Mapping[str, StudyResult]) -> list[Block]:
    """Value and standard deviation side by side; nothing where the machines differ."""
    if len({result.machine.name for result in results.values()}) > 1:
        return []
    estimates: dict[str, Estimates] = {
        name: result.final_estimate.parameters
        for name, result in results.items()
        if result.final_estimate is not None
    }
    if len(estimates) < 2:
        return []
    names = list(dict.fromkeys(n for of in estimates.values() for n in of))
    titles = [title for name in estimates for title in (name, "sd")]
    columns = [TableColumn("Parameter"), *number_columns(*titles, "Tolerance")]
    rows = [_row(name, list(estimates.values())) for name in names]
    caption = (
        "Identified values with their standard deviations. Values of directions that"
        " the readings do not determine rest on the tolerances: compare only what has"
        " a standard deviation far below its tolerance."
    )
    return [Table(columns, rows, caption)]


def _row(name: str, estimates: list[Estimates]) -> list[str]:
    records = [of[name] for of in estimates if name in of]
    cells = [f"{name} [{text.unit_symbol(records[0].unit)}]"]
    for of in estimates:
        if name not in of:
            cells += [text.MISSING, text.MISSING]
            continue
        decimals = text.decimals_for(of[name].sd)
        cells += [
            text.fixed(of[name].value, decimals),
            text.fixed(of[name].sd, decimals),
        ]
    return [*cells, text.trimmed(records[0].prior_sd, 3)]
