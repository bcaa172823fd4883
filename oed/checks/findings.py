"""What a check finds, by how much harm it does."""

from __future__ import annotations

import dataclasses
import enum

from oed.dataset.file_rows import Row


class Severity(enum.IntEnum):
    """How much harm a finding does, the most harmful first.

    MISTAKE  a mistake explains the readings: nothing fitted to them is worth anything
    BAD_FIT  the readings do not fit, and nothing explains why
    COPIES   readings that no instrument took
    ORDER    times that contradict the order of the readings, or each other
    OUTLIER  single rows that are set aside
    REMARK   what a user should know
    """

    MISTAKE = 0
    BAD_FIT = 1
    COPIES = 2
    ORDER = 3
    OUTLIER = 4
    REMARK = 5


@dataclasses.dataclass(frozen=True)
class CheckFinding:
    """What is wrong with readings.

    severity  how much harm it does
    kind      such as `unit`, `sign`, `outlier`, `doubled`
    sentence  for the user
    rows      rows of the files at fault; empty where all are
    """

    severity: Severity
    kind: str
    sentence: str
    rows: tuple[Row, ...] = ()
