"""Part of the chapter on the fit: chi-square, and the noise law as estimated."""

from __future__ import annotations

from typing import Final

from oed.fit_limits import ALARM_PROBABILITY, MIN_DOF
from oed.result import GoodnessSection, NoiseRecord
from pkm_reports import text
from pkm_reports.blocks import Block, Notice, Table, TableColumn, number_columns
from pkm_reports.missing import or_nan

#: runs that the table shows
SHOWN: Final = 8
#: probability below which a sum of squares is not what the noise predicts
UNLIKELY: Final = 0.01
MEANING: Final = {
    "reading": "Scatter of single readings",
    "run": "Error that a run shares",
    "seat": "What a run seats anew",
    "course": "Course through the session, at its end",
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
    verdict = judgement(
        or_nan(checked.dof), is_large=high < UNLIKELY, is_small=low < ALARM_PROBABILITY
    )
    return (
        f"χ² is {chi2} for {dof} degrees of freedom{checked.chi2_words} by the stated"
        f" noise ({chance}): {verdict}.{_law_judgement(checked)}"
    )


def _law_judgement(checked: GoodnessSection) -> str:
    """How the same readings agree with the estimated law; empty without one."""
    if checked.law_p_high is None:
        return ""
    return (
        " By the noise law as estimated, with a scatter within a factor 1.5 of the"
        f" stated one, a larger misfit has probability {_probability(checked.law_p_high)}."
    )


def judgement(dof: float, *, is_large: bool, is_small: bool = False) -> str:
    """Whether chi-square agrees with the stated noise, where any freedom judges it."""
    if not dof >= MIN_DOF:
        return (
            "no machine within its tolerances gives these readings"
            if is_large
            else "the readings leave no freedom to judge the noise by"
        )
    if is_large:
        return (
            "more than the stated noise explains: the model lacks something, or the"
            " noise is larger"
        )
    if is_small:
        return "less than the stated noise would leave: the noise is overstated"
    return "as the stated noise predicts"


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


def left_out(checked: GoodnessSection | None) -> list[Block]:
    """Runs as predicted from all others, the worst first; nothing for a single run."""
    if checked is None or not checked.left_out:
        return []
    columns = [
        TableColumn("Set-up"),
        TableColumn("Run"),
        *number_columns("Values", "Errors / predicted", "p", "Log score"),
    ]
    worst = sorted(checked.left_out, key=lambda run: run.p_high)[:SHOWN]
    rows = [
        [
            run.setup,
            run.run,
            str(run.values),
            text.number(run.ratio, 2),
            _probability(run.p_high),
            text.fixed(run.log_score, 1),
        ]
        for run in worst
    ]
    score = text.fixed(checked.left_out_score, 1)
    sd = text.fixed(checked.left_out_sd, 1)
    count = text.count(len(checked.left_out), "run")
    caption = (
        f"Each of {count} predicted from all others, the most surprising first. Their"
        f" log score, which compares models of the same readings, is {score} ± {sd}."
    )
    return [Table(columns, rows, caption)]


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
