"""The order of lines that carry times: many consoles put the newest line first."""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from pkm_studies import csv_table
from pkm_studies.base import InputError
from pkm_studies.csv_table import CsvTable, plain_number

DAY: Final = 86400.0
#: a time at the beginning of a line or cell, the date before it where there is one
TIME: Final = re.compile(
    r"\W{0,2}(?:(\d{1,4})([-./])(\d{1,2})\2(\d{1,4})[\sT,]+)?"
    r"(\d{1,2}):(\d\d)(?::(\d\d(?:[.,]\d+)?))?(?!\d)\s*(AM|PM)?",
    re.IGNORECASE,
)
#: columns of times
TIME_NAME: Final = re.compile(r"time|stamp|zeit|uhr|\bdate\b|datum", re.IGNORECASE)


class Stamp(NamedTuple):
    """A time, s: since the year 1, or since midnight where there is no date."""

    seconds: float
    is_dated: bool

    @classmethod
    def leading(cls, text: str) -> Stamp | None:
        """The time with which a text begins; None without one."""
        match = TIME.match(text)
        if match is None:
            return None
        first, sign, second, third, hour, minute, second_text, half = match.groups()
        hours = int(hour) % 12 + 12 * (half.upper() == "PM") if half else int(hour)
        clock = 60.0 * (60.0 * hours + int(minute))
        clock += float((second_text or "0").replace(",", "."))
        if first is None:
            return cls(clock, is_dated=False)
        # 2026-11-24, 24.11.2026, and 11/24/2026 unless no month is meant
        year, month, day = int(third), int(second), int(first)
        if len(first) == 4:
            year, day = day, year
        elif sign == "/" and day <= 12:
            month, day = day, month
        try:
            days = datetime.date(year + 2000 * (year < 100), month, day).toordinal()
        except ValueError:
            return None
        return cls(DAY * days + clock, is_dated=True)

    @staticmethod
    def steps(stamps: Sequence[Stamp]) -> np.ndarray:
        """Time (n - 1,), s, from each stamp to the next, over midnight where undated."""
        between = np.diff([one.seconds for one in stamps])
        if not all(one.is_dated for one in stamps):
            between = (between + DAY / 2.0) % DAY - DAY / 2.0
        return np.asarray(between)


def read_tables(paths: Sequence[Path]) -> list[CsvTable]:
    """CSV files, each with the oldest line first. Raises InputError where times fall.

    Lines of two files belong to each other by their place, so none is turned round.
    """
    tables = [csv_table.read(path) for path in paths]
    for table in tables:
        for name in filter(TIME_NAME.search, table.header):
            cells = [cell for cell in table.cells(name) if cell]
            stamps = [Stamp.leading(cell) or _number(cell) for cell in cells]
            between = Stamp.steps([one for one in stamps if one is not None])
            if (between < 0.0).any() and not (between > 0.0).any():
                raise InputError(
                    "the times fall from line to line: the newest stands first",
                    "sort the lines by time, and those of files that go with them; or"
                    " leave the column out where it is no time",
                    file=table.file,
                    field=f"column {name}",
                    value=f"{cells[0]} to {cells[-1]}",
                )
    return tables


def _number(cell: str) -> Stamp | None:
    value = plain_number(cell)
    return None if value is None else Stamp(value, is_dated=True)
