"""What a check finds, by how much harm it does, and its numbers and words."""

import dataclasses
import enum
import math
from collections.abc import Sequence

from oed.dataset import Row


class Severity(enum.IntEnum):
    """How much harm a finding does, the most harmful first."""

    #: a mistake explains the readings: nothing fitted to them is worth anything
    MISTAKE = 0
    BAD_FIT = 1  #: the readings do not fit, and nothing explains why
    COPIES = 2  #: readings that no instrument took
    ORDER = 3  #: times that contradict the order of the readings, or each other
    OUTLIER = 4  #: single rows that are set aside
    REMARK = 5  #: what a user should know


#: kinds that an effect of the machine can mimic: a diagnosis tells them apart
PHYSICAL_KINDS = ("offset", "run", "factor", "tool", "size", "change", "contradiction")


@dataclasses.dataclass(frozen=True)
class CheckFinding:
    """What is wrong with readings."""

    severity: Severity  #: how much harm it does
    kind: str  #: such as `unit`, `sign`, `outlier`, `doubled`
    sentence: str  #: for the user
    rows: tuple[Row, ...] = ()  #: rows of the files at fault; empty where all are

    @property
    def is_remark(self) -> bool:
        """Whether it is only what a user should know."""
        return self.severity >= Severity.REMARK

    @property
    def is_about_the_fit(self) -> bool:
        """Whether it spoils the fit, and an effect of the machine may be behind it."""
        kinds = ("fit", *PHYSICAL_KINDS)
        return self.severity <= Severity.BAD_FIT and self.kind in kinds

    @property
    def may_be_an_effect(self) -> bool:
        """Whether it spoils no fit, or an effect of the machine may be behind it."""
        return self.severity > Severity.BAD_FIT or self.is_about_the_fit


SIGNIFICANT_DIGITS = 4  #: digits of a number that a person reads
MAX_LISTED_ROWS = 6  #: rows that a sentence names, at most


def rounded(value: float, sd: float) -> str:
    """A number to the first digit of its sd, of SIGNIFICANT_DIGITS at most."""
    if not math.isfinite(sd) or sd <= 0.0 or value == 0.0:
        return f"{value:.{SIGNIFICANT_DIGITS}g}"
    by_sd = -math.floor(math.log10(sd))
    by_size = SIGNIFICANT_DIGITS - 1 - math.floor(math.log10(abs(value)))
    places = max(0, min(by_sd, by_size))
    text = f"{value:.{places}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def listing(rows: Sequence[Row]) -> str:
    """`rows 3, 7, ...`."""
    shown = ", ".join(str(k) for k in rows[:MAX_LISTED_ROWS])
    more = ", ..." if len(rows) > MAX_LISTED_ROWS else ""
    return f"row{'s' if len(rows) > 1 else ''} {shown}{more}"
