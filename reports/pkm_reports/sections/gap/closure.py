"""How far the gap closes on held-out readings."""

from __future__ import annotations

from typing import Final

from oed.result import ClosureRecord, GapSection
from oed.result.record import Number
from pkm_reports.page import text
from pkm_reports.page.blocks import Block, Table, number_columns, wide_column
from pkm_reports.page.missing import or_nan

SPLITS: Final = {"within": "stretches of runs", "whole": "whole runs"}
#: shares beyond which an end of an interval is not written in figures
HIGHEST, LOWEST = 1.0, -1.0
#: a gap of which no more than the noise is left
ALL: Final = "all of it"
#: share from which percent are rounded down, never up to the whole
NEARLY_WHOLE: Final = 0.99


def blocks(gap: GapSection) -> list[Block]:
    """One row for each way of holding readings out; none where no effect is reported."""
    if not gap.closure or not gap.effect_reported:
        return []
    columns = [
        wide_column("Held out"),
        *number_columns("Readings", "Gap closed", "95 % interval", "Chance of harm"),
        *number_columns("Before", "After", "Noise alone"),
    ]
    rows = [
        [
            text.meaning(closure.split, SPLITS),
            str(closure.n),
            _closed(closure.value),
            _interval(closure),
            text.percent(closure.p_worse),
            text.number(closure.s0),
            text.number(closure.s1),
            text.number(closure.s_noise),
        ]
        for closure in gap.closure
    ]
    caption = (
        "How far what calibration leaves shrinks, beyond the noise and in its mean"
        " square, on readings that were held out of the fit. Before,"
        " after and noise alone are mean squared residuals in units of their expected"
        " value; the gap closed is (before − after) / (before − noise alone), all of it"
        " where no more than the noise is left. Whole"
        " held-out runs also show what the geometry cannot learn from the other runs."
    )
    return [Table(columns, rows, caption)]


def _closed(value: Number) -> str:
    """The share that is closed; beyond the whole, less than the noise expects is left."""
    return ALL if or_nan(value) >= 1.0 else _share(value)


def _interval(closure: ClosureRecord) -> str:
    if closure.low is None or closure.high is None:
        return text.MISSING
    return f"{_end(closure.low)} to {_end(closure.high)}"


def _end(value: float) -> str:
    """An end of an interval; far off what a share can be, it says no more than that."""
    if value > HIGHEST:
        return f"over 100{text.NO_BREAK}%"
    if value < LOWEST:
        return f"under {text.MINUS}100{text.NO_BREAK}%"
    return _share(value)


def _share(value: Number) -> str:
    """A share in percent, never rounded up to the whole."""
    nearly_whole = NEARLY_WHOLE < or_nan(value) < 1.0
    return text.percent_at_least(value) if nearly_whole else text.percent(value)
