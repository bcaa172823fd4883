"""Tables for the machine, its set-ups, the noise and the prior."""

from __future__ import annotations

from pkm_studies.study.tables.base import (
    Count,
    Name,
    StudyTable,
    Triple,
)


class MachineTable(StudyTable, frozen=True, kw_only=True):
    """[machine]: which model, with which numbers. `fixed` replaces the model's list of
    parameters held.
    """

    model: str
    nominal: dict[str, float] = {}
    fixed: list[str] | None = None


class SetupTable(StudyTable, frozen=True, kw_only=True):
    """[[setup]]: an instrument as mounted. `tolerance` are the standard deviations of
    its unknowns.

    Each planned reading is taken `repeats` times, in one direction or both; `average`
    keeps their mean.
    """

    rest = "settings"
    name: Name
    instrument: str
    tool_mm: Triple = (0.0, 0.0, 0.0)
    repeats: Count = 1
    both_directions: bool = False
    average: bool = True
    teach: dict[str, float] | None = None
    tolerance: dict[str, float] = {}
    settings: dict[str, float] = {}


class NoiseTable(StudyTable, frozen=True, kw_only=True):
    """[noise]: standard deviation of each channel, for all set-ups or in a table named
    as the set-up.
    """

    rest = "sigma"
    estimate: bool = False
    sigma: dict[str, float | dict[str, float]] = {}


class ToleranceTable(StudyTable, frozen=True, kw_only=True):
    """[[prior.tolerance]]: a standard deviation for the parameters whose names match;
    later tables win.
    """

    rest = "sigma"
    parameters: list[str]
    sigma: dict[str, float] = {}


class PriorTable(StudyTable, frozen=True, kw_only=True):
    """[prior]."""

    tolerance: list[ToleranceTable] = []
