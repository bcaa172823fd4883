"""Tables of a study file, as frozen structs. See `study` for how a file is read,
`resolve` for what it means.

Tables that take fields by the name of a parameter, a setting or a coordinate, with the
unit at the end (`length_mm`), collect them in the field named by `rest`.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from pkm_studies.study.fields import (
    READINGS,
    Count,
    CriterionName,
    Name,
    NotNegative,
    Positive,
    StudyTable,
    Triple,
    Whole,
)
from pkm_studies.study.gap import GapTable as GapTable


class Span(StudyTable, frozen=True, kw_only=True):
    """Evenly spaced values, in the unit of the field: `{ from = 0, to = 360, count =
    12, endpoint = false }`.
    """

    from_: float = msgspec.field(name="from")
    to: float
    count: Count
    endpoint: bool = True


class Range(StudyTable, frozen=True, kw_only=True):
    """Lowest and highest value, in the unit of the field."""

    from_: float = msgspec.field(name="from")
    to: float


#: values of one command coordinate: a number, a list, evenly spaced, or held by the
#: instrument
Axis = float | list[float] | Span | Literal["hold"]


class GridTable(StudyTable, frozen=True, kw_only=True):
    """[[design.candidates]]: poses of one set-up, all values of each coordinate
    combined.
    """

    rest = "coordinates"
    setup: str
    runs_by: str | None = None
    pairs_mm: list[tuple[Triple, Triple]] | None = None
    coordinates: dict[str, Axis] = {}


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


class ReferenceTable(GridTable, frozen=True, kw_only=True):
    """[[design.reference]]: as candidates, but a given plan; tables of one name make
    one plan.
    """

    rest = "coordinates"
    name: str


class ConeTable(StudyTable, frozen=True, kw_only=True):
    """Directions within `half_angle_deg` of `axis` (any length)."""

    axis: Triple
    half_angle_deg: Positive


class SphereTable(StudyTable, frozen=True, kw_only=True):
    """An obstacle: a sphere in the base frame."""

    at_mm: Triple
    radius_mm: Positive


class RodTable(StudyTable, frozen=True, kw_only=True):
    """An obstacle: all points within `radius_mm` of a straight line, in the base frame."""

    from_mm: Triple
    to_mm: Triple
    radius_mm: Positive


class LimitsTable(StudyTable, frozen=True, kw_only=True):
    """[design.limits]: candidates that break one are left out, and counted. What is not
    given is not asked.

    joints         travel of joints by name and unit, `{ q1_mm = { from = 350, to = 800
                   } }`, within the machine's own
    singularity    least reciprocal condition number of the closure's slopes over the
                   pose, between 0 and 1
    travel_mm      by how much a held reading may differ from what the instrument holds
                   (a ball bar's travel)
    travel_chance  least probability that it stays within the travel on a machine with
                   errors of the size of its tolerances; needs `travel_mm`
    cup_cone       where the line from the cup to the tool point may point, in the base
                   frame
    tool_cone      where the line from the tool point to the cup may point, in the
                   platform's frame
    spheres, rods  obstacles; they need `links_mm` or `bar_mm`
    links_mm       radius of the machine's links;  bar_mm of the bar from cup to tool
                   point
    margin_mm      clearance to keep;  ignore: numbers, from 0, of the skeleton's lines
                   that are not looked at

    travel goes for instruments that hold a reading, cones and bar for those whose other
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


class KappaTable(StudyTable, frozen=True, kw_only=True):
    """[[kappa]]: condition number over m circles of n points. The range, `z_mm = {
    from, to }`, spaces the circles.
    """

    rest = "coordinates"
    title: str = ""
    setup: str
    circles: Annotated[list[Count], msgspec.Meta(min_length=1)]
    points: Annotated[list[Count], msgspec.Meta(min_length=1)]
    coordinate: str | None = None
    coordinates: dict[str, Range] = {}


class ReadingsTable(StudyTable, frozen=True, kw_only=True):
    """[readings]: from files, from a named source of data, or from a virtual machine."""

    files: list[str] = []
    source: str | None = None
    path: str | None = None
    simulate: bool = False
    draw: bool = False
    truth: dict[str, float | dict[str, float]] = {}
    fit: list[str] | None = None
    predict: list[str] = []


class IdentifyTable(StudyTable, frozen=True, kw_only=True):
    """[identify]: parameters freed in turn, by name or pattern."""

    stages: Annotated[list[list[str]], msgspec.Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: [["*"]]
    )
    max_iterations: Count = 50


class PosteriorTable(StudyTable, frozen=True, kw_only=True):
    """[posterior]: how long to sample. `steps` is the most; sampling stops at `ess` a
    parameter.
    """

    enabled: bool = True
    walkers: Annotated[int, msgspec.Meta(ge=4, le=100_000)] | None = None
    steps: Count = 20_000
    ess: Count = 1000
    thin: Count | None = None


class PredictionTable(StudyTable, frozen=True, kw_only=True):
    """[prediction]: residual accuracy over a grid of the workspace, against a
    reference.
    """

    rest = "coordinates"
    reference: Literal["home", "absolute", "best_fit"] = "home"
    virtual_machines: Whole = 0
    coordinates: dict[str, Axis] = {}


class ReportTable(StudyTable, frozen=True, kw_only=True):
    """[report]."""

    html: bool = True
    pdf: bool = True
    corner: Count = 6


class ClaimTable(StudyTable, frozen=True, kw_only=True):
    """[expect]: what a result must be. `of` is a dotted path into result.json."""

    of: str
    equals: bool | float | str | None = None
    min: float | None = None
    max: float | None = None
    contains: str | None = None


class StudyFile(StudyTable, frozen=True, kw_only=True):
    """A study file, schema 1."""

    schema: Literal[1]
    name: Name
    title: str = ""
    question: str = ""
    seed: Whole = 0
    slow: bool = False
    machine: MachineTable
    setup: Annotated[list[SetupTable], msgspec.Meta(min_length=1)]
    noise: NoiseTable = NoiseTable()
    prior: PriorTable = PriorTable()
    design: DesignTable | None = None
    plan: PlanTable | None = None
    kappa: list[KappaTable] = []
    readings: ReadingsTable | None = None
    identify: IdentifyTable = IdentifyTable()
    posterior: PosteriorTable = PosteriorTable()
    prediction: PredictionTable | None = None
    gap: GapTable | None = None
    report: ReportTable = ReportTable()
    expect: dict[Name, ClaimTable] = {}
