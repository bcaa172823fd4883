"""What no table of readings may have: labels, orders and signs that contradict."""

from __future__ import annotations

from typing import Final

import numpy as np

from oed.base import Mask
from oed.dataset.columns import (
    LABELS,
    SIGMA,
    TENSION,
)
from oed.dataset.readings_file import ReadingsFile

ORDER_REMEDY: Final = "count the readings of a run in time: 1, 2, 3"
#: least value of a covariate
LEAST_VALUES: Final = {"time": 0, "feed": 0, "repeat": 1}
#: least and largest standard deviation of a reading, SI
SIGMA_RANGE: Final = (1e-12, 1e3)
#: orders stay below this
MOST_ORDER: Final = 1e15


def check_rows(table: ReadingsFile) -> None:
    """Raises ReadingsError for the first row that contradicts itself."""
    _check_labels(table)
    _check_order(table)
    _check_direction(table)
    _check_not_negative(table)
    _check_sigma(table)


def _check_labels(table: ReadingsFile) -> None:
    for stem in LABELS:
        empty = (table.frame[stem] == "").to_numpy()
        remedy = f"name the {stem} of every row"
        _refuse_first(table, empty, "the cell is empty", remedy, stem)


def _check_order(table: ReadingsFile) -> None:
    order = table.frame["order"].to_numpy()
    whole = (order >= 0) & (order < MOST_ORDER) & (order == np.round(order))
    _refuse_first(
        table, ~whole, "order is no whole number from 0 on", ORDER_REMEDY, "order"
    )


def _check_direction(table: ReadingsFile) -> None:
    if "direction" not in table.frame:
        return
    direction = table.frame["direction"].to_numpy()
    known = np.isnan(direction) | (np.abs(direction) == 1.0)
    remedy = "write 1 or -1, or leave it empty"
    _refuse_first(table, ~known, "direction is +1 or -1", remedy, "direction")


def _check_not_negative(table: ReadingsFile) -> None:
    """Times count from the session's start, feeds are speeds, cables do not push."""
    least_values = dict(LEAST_VALUES)
    least_values |= {s: 0 for s in table.columns if s.startswith(TENSION)}
    for stem, least in least_values.items():
        if stem in table.frame:
            below = table.frame[stem].to_numpy() < least
            remedy = "correct it, or leave the cell empty where it is unknown"
            problem = f"{stem} is at least {least}"
            _refuse_first(table, below, problem, remedy, stem)


def _check_sigma(table: ReadingsFile) -> None:
    """Standard deviations of readings are above 0, and of a size that readings have."""
    least, most = SIGMA_RANGE
    for stem in table.columns:
        if stem.startswith(SIGMA):
            values = table.frame[stem].to_numpy(dtype=float)
            bad = np.isfinite(values) & ~((values >= least) & (values <= most))
            problem = "no reading has such a standard deviation"
            remedy = (
                "give a number above 0 in the column's unit, or leave the cell empty: then"
                " that of [noise] holds"
            )
            _refuse_first(table, bad, problem, remedy, stem)


def _refuse_first(
    table: ReadingsFile, bad: Mask, problem: str, remedy: str, stem: str
) -> None:
    """Raise ReadingsError for the first bad row, if there is one."""
    rows = np.flatnonzero(bad)
    if rows.size:
        raise table.error(problem, remedy, int(rows[0]), stem)
