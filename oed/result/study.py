"""What a study ends in: `result.json`, loss-free, so that a report can be made again
from it.

Field names are fixed by the contract; values are SI unless a `unit` stands beside them.
Arrays are lists.
"""

from __future__ import annotations

import msgspec

from oed.result.gap import Gap as Gap
from oed.result.gap_before import GapBefore as GapBefore
from oed.result.plan import Plan as Plan
from oed.result.plan import Sd as Sd
from oed.result.plan import Sequence as Sequence
from oed.result.plan import Stage as Stage
from oed.result.plan import Way as Way

SCHEMA = 1


class Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base: frozen, unknown fields refused."""


class Group(Part, frozen=True):
    """One line of the identifiability verdict in words."""

    kind: str  # seen | combination | lost | weak
    text: str
    remedies: list[str] = []


class Identifiability(Part, frozen=True):
    """What the plan's readings can see. Combinations and lost directions are
    {parameter: coefficient}, SI.
    """

    parameters: list[str]
    n: int
    rank: int
    tolerance: float  # singular values below this share of the largest count as zero
    scaling: str
    singular_values: list[float]
    combinations: list[dict[str, float]]
    lost: list[dict[str, float]]
    words: list[Group]


class Pose(Part, frozen=True):
    """One planned reading: where it is taken, in user units (`z_mm`, ...), and what it
    nominally reads.
    """

    setup: str
    run: str
    order: int
    command: dict[str, float]
    reading: dict[str, float]


class PlanScore(Part, frozen=True):
    """One plan scored: the chosen one, or a reference to compare with."""

    name: str
    n: int
    criterion: str
    value: float
    logdet: float  # of the readings' information, with the tolerances where they count
    efficiency: float  # phi(plan) / phi(chosen), per reading where no tolerances count
    kappa: float
    observability: dict[str, float]
    #: predicted rms of each pose component (`z_um`) over the workspace, once all that
    #: is known of it is corrected
    predicted: dict[str, float] = {}
    gain: dict[
        str, float
    ] = {}  # factor by which each is better than that of the first reference plan


class Compared(Part, frozen=True):
    """The design for one criterion, and how the designs for the others do by it."""

    name: str  # criterion
    value: float
    bound: float | None
    efficiency: float | None
    proven: bool
    gain: float  # phi of this design over phi of the main one, by this criterion: 1 or more
    values: dict[str, float]  # by this criterion, of the design for each criterion


class Polished(Part, frozen=True):
    """Poses (and set-ups) polished off the grid: the criterion before and after."""

    before: float
    after: float
    words: str
    setups: dict[
        str, dict[str, float]
    ]  # what was free of each set-up, as it is now, in user units


class Ordered(Part, frozen=True):
    """The working order of the chosen readings: joint travel in the order of the
    candidates and as ordered, s.

    Readings kept from an earlier plan come first in their set-up, as they are, and are
    not counted.
    """

    setups: list[str]
    before_s: float
    after_s: float
    exact: bool  # whether no way is shorter, within each set-up
    references: int  # thermal reference readings put between
    minutes: float  # mounting, travel and readings together


class Robust(Part, frozen=True):
    """A plan chosen over scenarios: log phi by the risk asked for, and in each scenario
    (the first is nominal).
    """

    risk: str
    level: float
    scenarios: int
    value: float
    bound: float
    efficiency: float
    nominal: float  # of the plan for the nominal machine, by the same risk
    values: list[float]
    nominal_values: list[float]


class HowMany(Part, frozen=True):
    """Predicted rms of pose components (`z_um`) against the number of readings, and the
    bound of each alone.

    fewest: readings that reach what is wanted, None where none up to `most` do; no plan
    of fewer than `at_least` can
    """

    wanted: dict[str, float]
    sizes: list[int]
    accuracy: dict[str, list[float]]
    bound: dict[str, list[float]]
    fewest: int | None = None
    at_least: int | None = None
    most: int | None = None
    words: str = ""


class Design(Part, frozen=True):
    """The chosen readings.

    value, bound, efficiency are of the chosen readings under the study's rules: nothing
    is better than the bound (for kappa, the smaller is the better, nothing is below
    it). Polished readings leave the grid, and have no bound.
    """

    criterion: str
    n: int
    value: float
    bound: float | None
    efficiency: float | None
    kappa: float
    observability: dict[str, float]
    poses: list[Pose]
    scaling: str
    candidates: int
    plans: list[PlanScore]
    words: str = ""  # how good the choice is known to be, as a sentence
    directions: int = 0  # that the candidates see and the criterion is told over, of `columns` unknowns
    columns: int = 0
    gap: float | None = (
        None  # what is known of the bound's own slack (log of an efficiency)
    )
    proven: bool = False
    compound: dict[str, float] = {}  # shares of the criteria
    setups: list[str] = []  # used, in working order
    kept: int = 0  # readings that belonged to the plan before
    cost_min: float | None = None  # mounting and reading
    refused: dict[str, int] = {}  # candidates left out, by reason
    compared: list[Compared] = []
    polished: Polished | None = None
    order: Ordered | None = None
    robust: Robust | None = None
    how_many: HowMany | None = None


class KappaMap(Part, frozen=True):
    """Condition number over the number of circles and of points on each, for one
    parametrisation.
    """

    title: str
    circles: list[int]
    points: list[int]
    kappa: list[list[float]]  # [circle][point]


class Value(Part, frozen=True):
    """An identified parameter, in its display unit."""

    value: float
    sd: float
    unit: str
    nominal: float
    prior_sd: float
    identified: (
        str  # seen | weak | prior  (how much the readings tightened the tolerance)
    )
    truth: float | None = None  # of a virtual machine


class Estimate(Part, frozen=True):
    """Least squares with tolerance priors. rms and residuals are in the fine unit of
    their channel, `units`.
    """

    parameters: dict[str, Value]
    rms_before: dict[str, float]
    rms_after: dict[str, float]
    units: dict[str, str]  # of each channel
    channels: list[str]  # of each residual
    readings: int
    dof: float
    chi2: float
    iterations: list[dict[str, float]]
    warnings: list[str]
    residuals: list[float]  # of each reading, after
    residuals_before: list[float]


class Marginal(Part, frozen=True):
    """Posterior of one parameter, in its display unit."""

    mean: float
    sd: float
    q025: float
    q975: float
    rhat: float
    ess: float
    unit: str


class Posterior(Part, frozen=True):
    """Sampler summary. `posterior.nc` holds the draws."""

    marginals: dict[str, Marginal]
    acceptance: float
    draws: int
    walkers: int
    autocorrelation: float
    directions: list[str]  # names of the worst-seen directions shown in the corner plot
    corner: list[
        list[float]
    ]  # thinned draws [draw][direction], in prior standard deviations


class Spread(Part, frozen=True):
    """Error of one pose component over the workspace: rms, 95th percentile, largest, in
    `unit`.
    """

    rms: float
    p95: float
    max: float
    unit: str


class Component(Part, frozen=True):
    """Residual accuracy of one pose component. `known` is what remains once a further
    axis corrects it too.
    """

    compensatable: bool
    before: Spread
    after: Spread
    known: Spread
    budget: dict[str, float]  # share of the variance of `known`, by source


class MapPoint(Part, frozen=True):
    """1-sigma prediction at one workspace pose (user units), by component."""

    command: dict[str, float]
    before: dict[str, float]
    after: dict[str, float]


class Prediction(Part, frozen=True):
    """Residual accuracy over the workspace, against a stated reference (absolute, home
    or best_fit).
    """

    reference: str
    components: dict[str, Component]
    unit: dict[str, str]
    poses: int
    map: list[MapPoint]
    mode: str  # "plan" (priors only) or "identified" (with the estimate)
    realised: dict[str, Spread] | None = None  # of virtual machines after compensation
    realised_share: dict[str, float] = {}  # their rms over the predicted one


class HeldOut(Part, frozen=True):
    """Prediction of readings kept out of the fit; the new set-up's own unknowns are
    adjusted, but not in `rms_raw`.
    """

    name: str
    channel: str
    n: int
    rms: float
    rms_raw: float
    unit: str
    coverage: float  # share of readings inside their 95 % predictive interval
    residuals: list[float]
    half_widths: list[float]  # of the 95 % predictive interval


class Claim(Part, frozen=True):
    """A claim of the study's [expect] table, measured."""

    claim: str
    measured: float | str
    wanted: str
    met: bool


class Line(Part, frozen=True):
    """A polyline of the drawing, m."""

    kind: str  # machine | path | reading | cup
    points: list[list[float]]


class Drawing(Part, frozen=True):
    """The machine at its home pose and the planned tool points, m, base frame."""

    lines: list[Line]
    tool_points: list[list[float]]
    reading_of: list[str]  # set-up of each tool point
    bars: list[list[list[float]]]  # reading's far end to tool point, where there is one


class MachineInfo(Part, frozen=True):
    """The machine's table, in display units."""

    name: str
    about: str
    source: str
    parameters: list[dict[str, str | float]]
    frame: list[str]


class SetupInfo(Part, frozen=True):
    """A set-up as used, in display units."""

    name: str
    instrument: str
    about: str
    numbers: dict[str, float]
    sigma: dict[str, float]
    unknowns: dict[str, float]


class StudyResult(Part, frozen=True):
    """The whole result of one study; sections of stages that did not run are null."""

    schema: int
    version: str
    study: str
    title: str
    question: str
    seed: int
    seconds: (
        float  # wall time; the only entry that differs between two runs with one seed
    )
    machine: MachineInfo
    setups: list[SetupInfo]
    study_text: str
    versions: dict[str, str]
    headline: list[str]  # the five numbers that matter, as sentences
    identifiability: Identifiability | None = None
    identifiability_of: dict[
        str, Identifiability
    ] = {}  # variants asked for: one circle, one tool, ...
    design: Design | None = None
    kappa_maps: list[KappaMap] = []
    plan: Plan | None = None
    estimate: Estimate | None = None
    posterior: Posterior | None = None
    prediction: Prediction | None = None
    held_out: list[HeldOut] = []
    gap: Gap | None = None
    gap_before: GapBefore | None = None
    drawing: Drawing | None = None
    warnings: list[str] = []
    claims: list[Claim] = []
