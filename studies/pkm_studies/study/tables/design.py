"""Tables for [design]: criterion, number of readings, polish, order, robustness."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from pkm_studies.study.tables.base import (
    READINGS,
    Count,
    CriterionName,
    NotNegative,
    Positive,
    StudyTable,
)
from pkm_studies.study.tables.grids import Axis, GridTable, ReferenceTable
from pkm_studies.study.tables.limits import LimitsTable


class PolishTable(StudyTable, frozen=True, kw_only=True):
    """[design.polish]: chosen poses moved, off the grid, to a local optimum.

    free       set-up: { setting or tool_x, tool_y, tool_z with its unit: [lowest,
               highest] }, moved along: `free = { cup = { at_x_mm = [-100, 100] } }`
    clearance  least determinant of the closure's slopes, as a share of that at home
    """

    enabled: bool = True
    free: dict[str, dict[str, tuple[float, float]]] = {}
    clearance: Positive | None = None
    iterations: Count = 500


class OrderTable(StudyTable, frozen=True, kw_only=True):
    """[design.order]: the order of reading; without this table, a short way by the
    joints within each set-up.

    start                where each set-up's way begins: at home, or anywhere
    speed_mm_s, speed_deg_s   of the joints
    reference_every_min  a thermal reference reading at least so often, first and last
                         in each set-up, in runs named "reference"
    reference            its command, `{ z_mm = 1146, psi_deg = 0, theta = "hold" }`; by
                         default the set-up's first pose
    change_tool_min, change_place_min, change_settings_min   time to change the tool, to move or teach the cup, to
                         change what the settings tell (the bar): they order the set-ups
    """

    start: Literal["home", "anywhere"] = "home"
    speed_mm_s: Positive = 50.0
    speed_deg_s: Positive = 10.0
    reference_every_min: Positive | None = None
    reference: dict[str, Axis] = {}
    change_tool_min: NotNegative = 15.0
    change_place_min: NotNegative = 10.0
    change_settings_min: NotNegative = 5.0


class RobustTable(StudyTable, frozen=True, kw_only=True):
    """[design.robust]: a plan that serves many machines, not only the nominal one.

    Scenarios of parameters and set-ups are drawn from the tolerances; the plan is
    judged by their mean, by the mean of the worst share `level` ("cvar"), or by the
    worst one. Needs a smooth criterion and prior = true.
    """

    risk: Literal["mean", "cvar", "worst"] = "mean"
    level: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.2
    scenarios: Annotated[int, msgspec.Meta(ge=2, le=1000)] = 20


class HowManyTable(StudyTable, frozen=True, kw_only=True):
    """[design.how_many]: predicted accuracy against the number of readings, over the
    workspace of [prediction].

    readings   numbers to show;  wanted  `{ z_um = 50 }`: the fewest readings that reach
               it are sought, up to `most`
    """

    readings: Annotated[list[Count], msgspec.Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: [10, 15, 20, 30, 40, 60]
    )
    wanted: dict[str, Positive] = {}
    most: Count = 100


class DesignTable(StudyTable, frozen=True, kw_only=True):
    """[design]: how many readings to choose from the candidates, by which criterion,
    under which rules.

    criterion      D: the volume of the parameters' uncertainty; Ds: of those of
                   `interest`; A: their mean variance; c: the variance of a
                   `combination`; I, G: the mean and the largest variance of the pose
                   over the workspace of [prediction]; E: the worst-known direction;
                   kappa: the condition number; O1 to O5: the observability indices
    compound       instead of a criterion: shares of several, `{ D = 0.5, I = 0.5 }`
    interest       Ds: names or patterns; by default the machine's own parameters
    combination    c: coefficients by parameter, per SI unit (m, rad)
    accuracy       I, G: wanted accuracy, `{ x_um = 30, theta_arcsec = 5 }`; components
                   not named do not count. By default all count, angles times the
                   machine's lever
    compare        criteria to design for besides, and to score each other's plans with
    readings       how many to choose (30, where there is no budget); with whole_runs,
                   how many runs
    budget_min     time there is for mounting and reading, min, kept readings too;
                   instead of or beside `readings`
    setups_max     set-ups mounted at the most, besides those of kept readings
    apart          least distance of two readings of a set-up, `{ z_mm = 10, psi_deg = 5
                   }`
    whole_runs     choose whole runs (circles, lines), not single readings
    keep           name of a reference plan;  keep_readings: a readings file. Their
                   readings are part of the plan, and new ones are chosen to go with
                   them
    scaling        "length": angles times the lever, readings alike; "tolerance": in
                   units of tolerances and noise
    prior          count the tolerances as knowledge; needs scaling = "tolerance"
    starts         rounds of the search
    """

    criterion: CriterionName = "D"
    compound: dict[str, Positive] = {}
    interest: list[str] = []
    combination: dict[str, float] = {}
    accuracy: dict[str, Positive] = {}
    compare: list[str] = []
    readings: Count | None = None
    budget_min: Positive | None = None
    setups_max: Count | None = None
    apart: dict[str, Positive] = {}
    whole_runs: bool = False
    keep: str | None = None
    keep_readings: str | None = None
    scaling: Literal["length", "tolerance"] = "length"
    prior: bool = False
    starts: Count = 20
    candidates: list[GridTable] = []
    reference: list[ReferenceTable] = []
    limits: LimitsTable | None = None
    polish: PolishTable | None = None
    order: OrderTable = OrderTable()
    robust: RobustTable | None = None
    how_many: HowManyTable | None = None

    @property
    def size(self) -> int | None:
        """Readings (or runs) to choose; None where only the budget tells."""
        return (
            READINGS
            if self.readings is None and self.budget_min is None
            else self.readings
        )

    @property
    def criteria(self) -> tuple[str, ...]:
        """Names of the criteria judged by, shares aside."""
        return tuple(self.compound) if self.compound else (self.criterion,)

    @property
    def judged_by(self) -> str:
        """The criterion's name: "D", or "compound"."""
        return "compound" if self.compound else self.criterion
