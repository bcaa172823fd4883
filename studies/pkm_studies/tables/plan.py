"""Tables of [plan]: measurements to choose from, and the time for them."""

from typing import Annotated, Literal

import msgspec

from pkm_studies.tables.base import (
    Count,
    NotNegative,
    Positive,
    StudyTable,
    Triple,
    Whole,
)
from pkm_studies.tables.grids import Axis


class MeasuredTable(StudyTable, frozen=True, kw_only=True):
    """[[plan.measurement]]: a measurement that can be ordered.

    name       of the measurement
    setup      set-up to mount
    setups     further set-ups of the same measurement, with the same grid
    counts     numbers of readings (or whole runs) worth trying; no plan takes more than
               the highest
    setup_min  time to mount all its set-ups; by default the instruments'
    reading_s  time of one pass
    travel_mm  a reading that differs more from the expected one is lost (a ball bar's
               travel); by default none is lost
    whole_runs whether to choose whole runs
    price      of the measurement, besides its time
    operator   who can do it
    runs_by    as in [[design.candidates]]
    pairs_mm   likewise
    further    coordinates of the grid, as in [[design.candidates]]
    """

    free_keys = "coordinates"
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
        if self.setup is None:
            return self.setups
        return [self.setup, *self.setups]


class PlanTable(StudyTable, frozen=True, kw_only=True):
    """[plan]: which measurements to do, in which order.

    budget_min        time there is
    stages            most stages of the plan
    wanted            accuracy, as in `{ z_um = 30 }`: the plan reaches it in the least
                      time; without it, the plan is the most accurate within the budget
    worth             least share by which a last stage has to improve the accuracy
    compare           sequences of measurements to show with the best plan of their time;
                      each takes all its readings, or the best that the budget pays for
    virtual_machines  number carried through all stages of the plan
    effects           effects that the plan allows for beside the geometry, at the sizes
                      expected of them: by name, or "catalogue"
    measurement       [[plan.measurement]] tables: what can be ordered

    Accuracy is that over the workspace of [prediction].
    """

    budget_min: Annotated[float, msgspec.Meta(gt=0)] | None = None
    stages: Annotated[int, msgspec.Meta(ge=1, le=12)] = 4
    wanted: dict[str, Positive] = {}
    worth: Annotated[float, msgspec.Meta(ge=0, lt=1)] = 0.0
    compare: list[Annotated[list[str], msgspec.Meta(min_length=1)]] = []
    virtual_machines: Whole = 0
    effects: Literal["none", "catalogue"] | list[str] = "none"
    measurement: list[MeasuredTable] = []
