"""Part of the chapter on the fit: chi-square, and the noise law as estimated."""

from __future__ import annotations

from typing import Final

from oed.result import GoodnessSection, NoiseRecord
from pkm_reports import text
from pkm_reports.blocks import Block, Notice, Table, TableColumn, number_columns
from pkm_reports.missing import or_nan

#: probability of a tail below which residuals disagree with the stated noise
ALARM: Final = 1e-3
MEANING: Final = {
    "reading": "Scatter of single readings",
    "run": "Error that a run shares",
    "seat": "What a run seats anew",
    "carried": "Share of the variance carried along",
    "reach": "Reach of what is carried along",
}


def goodness(checked: GoodnessSection) -> str:
    """Chi-square against the stated noise, with the probability of either tail."""
    chi2, dof = text.number(checked.chi2), text.number(checked.dof)
    high, low = or_nan(checked.p_high), or_nan(checked.p_low)
    chance = (
        f"a larger value has probability {_probability(high)}, a smaller one"
        f" {_probability(low)}"
    )
    verdict = "as the stated noise predicts"
    if high < ALARM:
        verdict = (
            "far more than the stated noise explains: the model lacks something, or the"
            " noise is larger"
        )
    elif low < ALARM:
        verdict = "less than the stated noise would leave: the noise is overstated"
    return f"χ² is {chi2} for {dof} degrees of freedom ({chance}): {verdict}."


def _probability(p: float) -> str:
    return "below 10⁻⁹" if p < 1e-9 else text.number(p, 2)


def blocks(checked: GoodnessSection | None) -> list[Block]:
    """The noise law as a table, and how it departs; nothing where it is as stated."""
    if checked is None or not checked.noise:
        return []
    columns = [
        TableColumn("Noise"),
        TableColumn("Of"),
        *number_columns("Estimate", "sd", "Stated"),
        TableColumn("Unit"),
    ]
    rows = [_row(record) for record in checked.noise.values()]
    marks = ["chosen" if r.departs else "" for r in checked.noise.values()]
    caption = (
        "The noise law as estimated from the readings. Fit and intervals are means over"
        " all laws that the readings allow."
    )
    departures: list[Block] = [Notice(text.sentence(w)) for w in checked.noise_words]
    return [*departures, Table(columns, rows, caption, marks)]


def _row(record: NoiseRecord) -> list[str]:
    decimals = text.decimals_for(record.sd)
    return [
        text.meaning(record.kind, MEANING),
        record.of,
        text.fixed(record.value, decimals),
        text.fixed(record.sd, decimals),
        text.MISSING if record.stated is None else text.trimmed(record.stated),
        text.unit_symbol(record.unit),
    ]
