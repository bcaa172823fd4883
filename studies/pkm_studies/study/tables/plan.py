"""Tables for [plan]: measurements to choose from, and the time for them."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pkm_studies.study.tables.base import (
    Count,
    NotNegative,
    Positive,
    StudyTable,
    Triple,
    Whole,
)
from pkm_studies.study.tables.grids import Axis


class MeasuredTable(StudyTable, frozen=True, kw_only=True):
    """[[plan.measurement]]: a measurement as it can be ordered; the grid's fields are
    those of [[design.candidates]].

    setup, setups  set-ups to mount, each of one measurement; the grid goes for each of
                   them
    counts         numbers of readings (or whole runs) worth trying; no plan takes more
                   than the highest
    setup_min      time to mount, all its set-ups together, by default the instruments';
                   reading_s: of one pass
    travel_mm      a reading farther from the expected one is lost (a ball bar's
                   travel); by default none is
    price          of doing it, besides the time;  operator: who can do it
    """

    rest = "coordinates"
    name: Annotated[str, msgspec.Meta(min_length=1, max_length=80)]
    setup: str | None = None
    setups: list[str] = []
    counts: Annotated[list[Count], msgspec.Meta(min_length=1)]
    setup_min: NotNegative | None = None
    reading_s: Positive | None = None
    travel_mm: Positive | None = None
    whole_runs: bool = False
    price: NotNegative = 0.0
    operator: str = ""
    runs_by: str | None = None
    pairs_mm: list[tuple[Triple, Triple]] | None = None
    coordinates: dict[str, Axis] = {}

    @property
    def mounted(self) -> list[str]:
        """Names of its set-ups."""
        return [*([self.setup] if self.setup is not None else []), *self.setups]


class PlanTable(StudyTable, frozen=True, kw_only=True):
    """[plan]: which measurements to do, in which order, over the workspace of
    [prediction].

    budget_min        time there is;  stages: the most there may be
    wanted            `{ z_um = 30 }`: least time to reach these; without, most accurate
                      within the budget
    worth             a last stage that makes the machine more accurate by less than
                      this share is not done
    compare           sequences of measurements, with all readings of each (or the best
                      ones that the budget pays for), shown beside the best plan of
                      their time
    virtual_machines  carried through all stages of the plan
    """

    budget_min: Annotated[float, msgspec.Meta(gt=0)] | None = None
    stages: Annotated[int, msgspec.Meta(ge=1, le=12)] = 4
    wanted: dict[str, Positive] = {}
    worth: Annotated[float, msgspec.Meta(ge=0, lt=1)] = 0.0
    compare: list[Annotated[list[str], msgspec.Meta(min_length=1)]] = []
    virtual_machines: Whole = 0
    measurement: list[MeasuredTable] = []
