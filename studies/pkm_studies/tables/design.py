"""Tables of [design]: criterion, number of readings, polish, order, robustness."""

from typing import Annotated, Literal

import msgspec

from pkm_studies.tables.base import (
    DEFAULT_READINGS,
    Count,
    CriterionName,
    IndexName,
    NotNegative,
    Positive,
    Share,
    StudyTable,
    Triple,
    Whole,
)
from pkm_studies.tables.grids import Axis, GridTable, OpenRange, Range, ReferenceTable

# Tables of [design.limits]: joint travel, singularity, cones and obstacles.


class ConeTable(StudyTable, frozen=True, kw_only=True):
    """Directions within a cone.

    axis            of the cone, of any length
    half_angle_deg  largest angle from the axis
    """

    axis: Triple
    half_angle_deg: Positive


class SphereTable(StudyTable, frozen=True, kw_only=True):
    """An obstacle: a sphere.

    at_mm      centre, base frame
    radius_mm  of the sphere
    """

    at_mm: Triple
    radius_mm: Positive


class RodTable(StudyTable, frozen=True, kw_only=True):
    """An obstacle: all points near a line segment.

    from_mm    one end of the segment, base frame
    to_mm      the other end
    radius_mm  distance from the segment within which the obstacle is
    """

    from_mm: Triple
    to_mm: Triple
    radius_mm: Positive


class LimitsTable(StudyTable, frozen=True, kw_only=True):
    """[design.limits]: candidates outside a limit are left out, and counted.

    joints         travel of joints, `{ q1_mm = { from = 350, to = 800 } }`, within that
                   of the machine
    singularity    least reciprocal condition number of the closure's slopes over the
                   pose, between 0 and 1
    travel_mm      largest difference of a held reading from what the instrument holds,
                   such as a ball bar's travel
    travel_chance  least probability that it stays within the travel on a machine with
                   errors of the size of its tolerances; needs `travel_mm`
    cup_cone       directions from the cup to the tool point, in the base frame
    tool_cone      directions from the tool point to the cup, in the platform's frame
    spheres        obstacles; they need `links_mm` or `bar_mm`
    rods           obstacles likewise
    links_mm       radius of the machine's links
    bar_mm         radius of the bar from cup to tool point
    margin_mm      clearance to keep
    ignore         numbers, from 0, of lines of the machine's skeleton that may touch

    Travel applies to instruments that hold a reading; cones and bar to those whose other
    end has a place.
    """

    joints: dict[str, Range] = {}
    singularity: Positive | None = None
    travel_mm: NotNegative | None = None
    travel_chance: Positive | None = None
    cup_cone: ConeTable | None = None
    tool_cone: ConeTable | None = None
    spheres: list[SphereTable] = []
    rods: list[RodTable] = []
    links_mm: Positive | None = None
    bar_mm: Positive | None = None
    margin_mm: NotNegative = 0.0
    ignore: list[int] = []


# Tables of [design]: criterion, number of readings, polish, order, robustness.


class PolishTable(StudyTable, frozen=True, kw_only=True):
    """[design.polish]: the chosen poses are moved off the grid to a local optimum.

    enabled     whether to polish
    free        settings that may move, by set-up: a setting or tool_x, tool_y, tool_z
                with its unit, and its lowest and highest value, as in
                `free = { cup = { at_x_mm = [-100, 100] } }`
    clearance   least determinant of the closure's slopes, as a share of that at home
    iterations  of the optimiser, at most
    """

    enabled: bool = True
    free: dict[str, dict[str, tuple[float, float]]] = {}
    clearance: Positive | None = None
    iterations: Count = 500


class OrderTable(StudyTable, frozen=True, kw_only=True):
    """[design.order]: the order of reading; by default, short joint travel in a set-up.

    start                where each set-up begins: at home, or anywhere
    speed_mm_s           of linear joints
    speed_deg_s          of rotary joints
    reference_every_min  longest time between two thermal reference readings; they are
                         the first and the last readings of each set-up, too
    reference            command of the reference, as in
                         `{ z_mm = 1146, psi_deg = 0, theta = "hold" }`; by default the
                         first pose of the set-up
    change_tool_min      time to change the tool
    change_place_min     time to move or teach the cup
    change_settings_min  time to change what the settings describe, such as the bar

    The changes decide the order of the set-ups.
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
    """[design.robust]: a plan for many machines, not only the nominal one.

    risk       what the plan is judged by: the mean over scenarios, the mean of the worst
               share `level` ("cvar"), or the worst one
    level      that share
    scenarios  number of machines and set-ups drawn from the tolerances

    It needs a smooth criterion and prior = true.
    """

    risk: Literal["mean", "cvar", "worst"] = "mean"
    level: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.2
    scenarios: Annotated[int, msgspec.Meta(ge=2, le=1000)] = 20


class HowManyTable(StudyTable, frozen=True, kw_only=True):
    """[design.how_many]: predicted accuracy against the number of readings.

    readings   numbers of readings to show
    wanted     accuracy, as in `{ z_um = 50 }`: the fewest readings that reach it are
               sought
    most       largest number of readings in that search
    """

    readings: Annotated[list[Count], msgspec.Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: [10, 15, 20, 30, 40, 60]
    )
    wanted: dict[str, Positive] = {}
    most: Count = 100


class QuotaTable(StudyTable, frozen=True, kw_only=True):
    """[[design.quota]]: how many readings a plan takes from a selection of candidates.

    The selection holds the candidates that meet all of `setups`, `runs` and the ranges.
    With `whole_runs`, numbers count runs, and a run is selected where all its readings
    are. Retained readings do not count. Every plan keeps the numbers exactly.

    name         in messages
    setups       names of set-ups; by default all
    runs         names or patterns of runs; by default all
    min          least number of readings from the selection
    max          largest number of readings from the selection
    min_share    least number, as a share of the readings to choose
    max_share    largest number, as a share of the readings to choose
    coordinates  ranges of command coordinates, as in `z_mm = { from = 1200 }`
    """

    free_keys = "coordinates"
    name: str = ""
    setups: list[str] = []
    runs: list[str] = []
    min: Whole | None = None
    max: Whole | None = None
    min_share: Share | None = None
    max_share: Share | None = None
    coordinates: dict[str, OpenRange] = {}


class DesignTable(StudyTable, frozen=True, kw_only=True):
    """[design]: which readings to choose, by which criterion, under which rules.

    criterion      D: the volume of the parameters' uncertainty; Ds: that of `interest`;
                   A: the mean variance of the parameters; c: the variance of a
                   `combination`; I, G: the mean and the largest variance of the pose
                   over the workspace of [prediction]; E: the worst-known direction;
                   kappa: the condition number; O1 to O5: the observability indices
    compound       instead of a criterion, shares of several: `{ D = 0.5, I = 0.5 }`
    interest       for Ds: names or patterns; by default the machine's own parameters
    combination    for c: coefficients by parameter, per SI unit (m, rad)
    accuracy       for I and G: wanted accuracy, `{ x_um = 30, theta_arcsec = 5 }`;
                   components not named do not count. By default all count, angles times
                   the machine's lever
    indices        indices to report of these and of the reference plans' readings, over
                   the directions that they determine: kappa, O1 to O5,
                   noise_amplification
    compare        further criteria to design for; each plan is scored by all of them
    readings       number to choose (30, where there is no budget); with `whole_runs`,
                   the number of runs
    budget_min     time for mounting and reading, retained readings included; instead of
                   `readings` or with it
    setups_max     most set-ups to mount, besides those of retained readings
    apart          least distance of two readings in a set-up, as in
                   `{ z_mm = 10, psi_deg = 5 }`
    whole_runs     whether to choose whole runs (circles, lines)
    keep           name of a reference plan whose readings are part of the plan
    keep_readings  readings file whose readings are part of the plan
    scaling        "length": angles times the lever, all readings alike; "tolerance": in
                   units of tolerances and noise
    prior          whether the tolerances count as knowledge; needs
                   scaling = "tolerance"
    effects        effects that the plan allows for beside the geometry, at the sizes
                   expected of them: by name, or "catalogue"; needs scaling = "tolerance"
                   and [prediction]
    quota          [[design.quota]] tables: numbers of readings from selections
    equal          equal numbers of readings a set-up, or a run
    branch_nodes   nodes of a branch-and-bound tree that lowers the bound and may prove
                   the plan optimal; 0: none. For smooth criteria (D, Ds, A, c, I, O1,
                   O5) and a plain number of readings
    starts         number of search rounds
    method         "exchange": search among plans; "relaxed": the optimal weights of the
                   candidates, and the readings of largest weight. For D, A and E, and
                   a plain number of readings
    solver         of the weights: "built_in", or "clarabel" or "scs" by cvxpy
    candidates     [[design.candidates]] tables: what can be read
    reference      [[design.reference]] tables: plans to compare with
    limits         [design.limits]: which candidates can be read
    polish         [design.polish]: poses off the grid
    order          [design.order]: the order of reading
    robust         [design.robust]: a plan for many machines
    how_many       [design.how_many]: accuracy by number of readings
    """

    criterion: CriterionName = "D"
    compound: dict[str, Positive] = {}
    interest: list[str] = []
    combination: dict[str, float] = {}
    accuracy: dict[str, Positive] = {}
    indices: list[IndexName] = []
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
    effects: Literal["none", "catalogue"] | list[str] = "none"
    quota: list[QuotaTable] = []
    equal: Literal["setup", "run"] | None = None
    branch_nodes: Whole = 0
    starts: Count = 20
    method: Literal["exchange", "relaxed"] = "exchange"
    solver: Literal["built_in", "clarabel", "scs"] | None = None
    candidates: list[GridTable] = []
    reference: list[ReferenceTable] = []
    limits: LimitsTable | None = None
    polish: PolishTable | None = None
    order: OrderTable = OrderTable()
    robust: RobustTable | None = None
    how_many: HowManyTable | None = None

    @property
    def allows_effects(self) -> bool:
        """Whether readings are chosen for a machine with effects beside the geometry."""
        return self.effects != "none"

    @property
    def size(self) -> int | None:
        """Number of readings or runs to choose; None where only the budget limits it."""
        if self.readings is None and self.budget_min is None:
            return DEFAULT_READINGS
        return self.readings

    @property
    def criteria(self) -> tuple[str, ...]:
        """Names of the criteria that judge a plan, without shares."""
        return tuple(self.compound) if self.compound else (self.criterion,)

    @property
    def judged_by(self) -> str:
        """The criterion's name: "D", or "compound"."""
        return "compound" if self.compound else self.criterion
