"""What to adjust at the machine, and what it brings: `adjustment` of result.json."""

from __future__ import annotations

from oed.result.record import Record


class AdjustmentLine(Record, frozen=True):
    """A parameter to move, in `unit`.

    by       what moves it
    steps    amount in steps of what moves it; None where it is turned continuously
    sd       standard deviation of the fitter's error
    without  total error of the list without this line, with the others chosen anew, in
             the unit of the total
    """

    parameter: str
    about: str
    by: str
    amount: float
    unit: str
    sd: float
    without: float
    steps: int | None = None


class AdjustedRecord(Record, frozen=True):
    """Rms errors over the workspace after some lines.

    total      after software compensates all identified parameters
    corrected  the same by component
    plain      by component, with a controller that keeps its nominal parameters
    """

    total: float
    corrected: dict[str, float]
    plain: dict[str, float]


class AdjustmentSection(Record, frozen=True):
    """The shortest list of adjustments that is worth its work.

    reference   against which errors are stated
    poses       of the workspace
    unit        of each component
    about       what the total error is, and what does not count in it
    total_unit  of the total error: um, or 1 where it is over what is wanted
    lines       in order
    accuracy    before the first line, and after each
    conditions  what the figures rest on
    """

    reference: str
    poses: int
    unit: dict[str, str]
    about: str
    lines: list[AdjustmentLine]
    accuracy: list[AdjustedRecord]
    conditions: list[str] = []
    total_unit: str = "1"
