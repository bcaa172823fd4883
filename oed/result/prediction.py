"""Accuracy in result.json: predicted with its budget, forecast, adjusted, accepted."""

import bisect
from typing import Annotated, ClassVar, Literal

import msgspec

from oed.result.record import Judgement, Record, Size


class PromiseRecord(Record, frozen=True):
    """What an acceptance test demands of one pose component, in `unit`."""

    #: rms error over the workspace; of what no drive corrects, with further axes that
    #: take the known error back
    promised: float
    #: largest rms of the measured errors that a machine at its promise has: it fails
    #: beyond
    limit: float
    power: float  #: probability that a machine which misses the promise is caught
    uncertainty: float  #: standard uncertainty of one measured error
    unit: str
    #: rms error over the workspace without additional axes, where no drive corrects the
    #: component
    without: float | None = None
    #: largest rms with which it meets its promise: a machine that misses stays below
    #: with a probability of 5 %; null where the test cannot confirm
    confirms: float | None = None


class AcceptanceSection(Record, frozen=True):
    """Which poses confirm the promised accuracy."""

    #: commands by column, in the order of the plan
    poses: Annotated[list[dict[str, float]], msgspec.Meta(min_length=1)]
    components: dict[str, PromiseRecord]  #: {component: demand}
    reference: str  #: against which errors are stated: absolute, home or best_fit
    miss: float  #: factor on the promised rms of a machine that misses
    false_alarm: float  #: probability that a machine at its promise fails
    conditions: list[str] = []  #: what the promise rests on
    #: {component: demand} of what no drive corrects; measured or not
    further: dict[str, PromiseRecord] = {}
    #: errors of these, known in advance, at each pose, in their units
    offsets: list[dict[str, float]] = []
    #: {component: rms} that the plan predicted for a healthy machine, with all that is
    #: known corrected, in the components' units
    healthy: dict[str, float] = {}


class VerdictRecord(Record, frozen=True):
    """The judgement of one pose component, in `unit`.

    Of what no drive corrects, rms and max are those with additional axes, and `without`
    the rms error without them. `passed` holds where the verdict is pass; `probability` is
    that of a true rms error within the promise, at the measured poses.
    """

    rms: float
    max: float
    limit: float
    promised: float
    unit: str
    passed: bool
    without: float | None = None
    verdict: Judgement | None = None
    probability: float | None = None

    @property
    def judgement(self) -> Judgement:
        """The verdict; that of older versions knew pass and fail alone."""
        return self.verdict or ("pass" if self.passed else "fail")


class PositioningRecord(Record, frozen=True):
    """Figures in the manner of ISO 230-2, in `unit`; null where directions are missing."""

    targets: int
    approaches: int  #: fewest of one direction at a target; the standard asks for five
    accuracy: float
    systematic: float
    repeatability: float
    mean: float | None
    reversal: float | None
    unit: str


class VerificationSection(Record, frozen=True):
    """Whether the measured errors confirm the promise."""

    passed: bool
    readings: int
    components: dict[str, VerdictRecord]
    positioning: dict[str, PositioningRecord] = {}
    #: verdicts on what no drive corrects, as far as it was measured
    further: dict[str, VerdictRecord] = {}
    #: {component: rms} that the plan predicted for a healthy machine
    healthy: dict[str, float] = {}
    #: the worst of the components; null in results of older versions, whose tests could
    #: not end in `cannot tell`
    verdict: Judgement | None = None

    @property
    def judgement(self) -> Judgement:
        """The verdict; that of older versions knew pass and fail alone."""
        return self.verdict or ("pass" if self.passed else "fail")


class AdjustmentLine(Record, frozen=True):
    """A parameter to move, in `unit`."""

    parameter: str
    about: str
    by: str  #: what moves it
    amount: float
    unit: str
    sd: float  #: standard deviation of the fitter's error
    #: total error of the list without this line, with the others chosen anew, in the
    #: unit of the total
    without: float
    #: amount in steps of what moves it; None where it is turned continuously
    steps: int | None = None


class AdjustedRecord(Record, frozen=True):
    """Rms errors over the workspace after some lines."""

    total: float  #: after software compensates all identified parameters
    corrected: dict[str, float]  #: the same by component
    #: by component, with a controller that keeps its nominal parameters
    plain: dict[str, float]


class AdjustmentSection(Record, frozen=True):
    """The shortest list of adjustments that is worth its work."""

    reference: str  #: against which errors are stated
    poses: int  #: of the workspace
    unit: dict[str, str]  #: of each component
    about: str  #: what the total error is, and what does not count in it
    lines: list[AdjustmentLine]  #: in order
    accuracy: list[AdjustedRecord]  #: before the first line, and after each
    conditions: list[str] = []  #: what the figures rest on
    #: of the total error: um, or 1 where it is over what is wanted
    total_unit: str = "1"


class ForecastComponent(Record, frozen=True):
    """Errors of one pose component against the reference, in `unit`, as rms."""

    unit: str
    expected: float  #: what calibration is expected to leave
    #: what interpolation between the nodes is predicted to leave, before a reading
    planned: float
    measured: float | None = None  #: errors of the nodes as read
    #: what the table is predicted to leave over the workspace, with the ends of its 95
    #: % interval
    predicted: float | None = None
    low: float | None = None
    high: float | None = None
    #: errors of nodes less their prediction by all others; and as predicted
    left_out: float | None = None
    left_out_predicted: float | None = None
    #: what the table leaves at nodes that were not fitted; as predicted, the largest
    #: one, and the largest error without the table
    checked: float | None = None
    checked_predicted: float | None = None
    checked_max: float | None = None
    checked_max_before: float | None = None


class ForecastSection(Record, frozen=True):
    """Which nodes to measure, and what the controller's table leaves."""

    components: dict[str, ForecastComponent]  #: {component: figures}
    reference: str  #: against which errors are stated: home or absolute
    #: commands to measure, by column, the most useful one first
    nodes: Annotated[list[dict[str, float]], msgspec.Meta(min_length=1)]
    setup: str  #: set-up whose times count
    minutes: float  #: time of mounting it and of reading all nodes
    readings: int = 0  #: number of rows read
    #: nodes of the controller's table along each command coordinate
    table: dict[str, int] = {}
    #: places of these nodes, by column of the command
    places: dict[str, list[float]] = {}
    #: what the table adds to the joints at its nodes, by column, the last coordinate
    #: running fastest
    corrections: dict[str, list[float]] = {}
    whole: bool = False  #: whether these also hold what identified parameters correct
    sentences: list[str] = []  #: what the figures rest on


class BudgetLine(Record, frozen=True):
    """A source of the errors of the compensated machine; values by pose component."""

    source: str  #: its name
    #: instrument, run, course, noise law, set-up, effects, prior or linearisation; with
    #: a compensation file also interpolation, rounding or left out
    kind: str
    #: of the predicted variance; below 0 where a linear calculation predicts too much
    share: dict[str, float]
    #: root of its variance, in the component's unit, with the sign of its share
    size: dict[str, float]
    #: rms error without it, the estimate adapted; null where nobody can remove it
    without: dict[str, float] | None = None
    #: rms error with half its standard deviation, or null
    halved: dict[str, float] | None = None


class UnmodelledLine(Record, frozen=True):
    """Expected errors by an effect that the model lacks; values by pose component."""

    effect: str
    about: str
    expected: str  #: its expected size, in words
    #: rms error that it adds through calibration to the workspace
    size: dict[str, float]
    with_it: dict[str, float]  #: rms error of the compensated machine with it
    remedy: str
    #: why the readings cannot find it; null where they can
    not_testable: str | None = None
    #: rms error with it at 30 times that size, the largest usual one
    far: dict[str, float] = {}
    #: rms error of `usual.components` without it; absent from results of earlier
    #: versions
    without: dict[str, float] = {}


class UsualEffects(Record, frozen=True):
    """Accuracy of a machine with all usual effects at their expected sizes.

    Values are rms errors by pose component, of those that the drives correct; of all where
    they correct none.
    """

    effects: list[str]  #: their names
    unmodelled: dict[str, float]  #: where the calibration knows none of them
    #: where all are fitted with the parameters, and corrected with them
    fitted: dict[str, float]
    #: where all are fitted so, and a controller is sent parameters alone; `known`:
    #: corrected with them. Absent from results of earlier versions
    components: "dict[str, ComponentAccuracy]" = {}


class BudgetSection(Record, frozen=True):
    """Sources of the errors that remain, each component in its fine unit."""

    #: rms error that the lines add up to; of what no drive corrects, with additional
    #: axes that take the known error back
    predicted: dict[str, float]
    lines: list[BudgetLine]  #: of what the prediction contains
    #: effects that it does not contain, at their expected sizes, the one that costs
    #: `usual` most first
    unmodelled: list[UnmodelledLine] = []
    #: the machine with all of these; null where none are listed
    usual: UsualEffects | None = None
    advice: list[str] = []  #: what to improve first, in sentences
    #: rms error of what no drive corrects, without additional axes
    no_axes: dict[str, float] = {}


#: a figure of drawn machines, and its errors: one, or one for each end
Figure = Annotated[str, msgspec.Meta(pattern="^(rms|p95|max)(_interval)?$")]
MonteCarloErrors = Annotated[list[float], msgspec.Meta(min_length=1, max_length=2)]
Interval = tuple[float, float]  #: lower and upper end
#: what held-out readings say of a fit
HeldOutVerdict = Literal["agrees", "confirms", "contradicts"]


class SpreadRecord(Record, frozen=True):
    """Error of one pose component over the workspace: rms, 95th percentile, largest, in
    `unit`.

    An interval holds that figure of 95 % of the machines, each over its workspace.
    `rms_quantiles` are those of the rms error of one machine, at the probabilities
    `LEVELS`.
    `monte_carlo` has the standard errors that the number of drawn machines leaves, by
    figure: of `p95`, `max` and both ends of an interval, of `rms` where it is drawn.
    """

    #: probabilities of the quantiles that are stored of a distribution
    LEVELS: ClassVar[tuple[float, ...]] = (
        *(0.005, 0.01, 0.025, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5),
        *(0.6, 0.7, 0.8, 0.9, 0.95, 0.975, 0.99, 0.995),
    )

    rms: Size
    p95: Size
    max: Size
    unit: str
    rms_interval: Interval | None = None
    p95_interval: Interval | None = None
    max_interval: Interval | None = None
    rms_quantiles: list[float] = []
    monte_carlo: dict[Figure, MonteCarloErrors] = {}

    def probability_within(self, limit: float) -> float:
        """Probability that the rms error of one machine is at most a limit.

        Between the outermost of `LEVELS`, for draws tell no more. A result of an older
        version has the interval alone, or nothing: then it is one half.
        """
        levels, quantiles = self.LEVELS, self.rms_quantiles
        if not quantiles and self.rms_interval is not None:
            levels = (0.025, 0.5, 0.975)
            quantiles = [self.rms_interval[0], self.rms, self.rms_interval[1]]
        if not quantiles:
            return 0.5
        above = bisect.bisect_right(quantiles, limit)
        if above in (0, len(quantiles)):
            return levels[min(above, len(levels) - 1)]
        low, high = quantiles[above - 1], quantiles[above]
        share = (limit - low) / (high - low)
        return levels[above - 1] + share * (levels[above] - levels[above - 1])


class ComponentAccuracy(Record, frozen=True):
    """Residual accuracy of one pose component. `known` is what remains once a further
    axis corrects it too.
    """

    compensatable: bool
    before: SpreadRecord
    after: SpreadRecord
    known: SpreadRecord
    budget: dict[str, float]  # share of the variance of `known`, by source

    @property
    def judged(self) -> SpreadRecord:
        """What is compared with the wanted accuracy: of no drive, unknown."""
        return self.after if self.compensatable else self.known


class MapPoint(Record, frozen=True):
    """1-sigma prediction at one workspace pose (user units), by component."""

    command: dict[str, float]
    before: dict[str, float]
    after: dict[str, float]
    #: tool point (3,) of the reference tool, m, in the base frame
    at: Annotated[list[float], msgspec.Meta(max_length=3)] = []


class ToolAccuracy(Record, frozen=True):
    """Accuracy after compensation at a tool point, `length` beyond the reference one."""

    length: float
    unit: str
    components: dict[str, SpreadRecord]


class PredictionSection(Record, frozen=True):
    """Residual accuracy over the workspace, against a stated reference (absolute, home
    or best_fit).
    """

    reference: Annotated[str, msgspec.Meta(pattern="^(home|absolute|best_fit)$")]
    components: dict[str, ComponentAccuracy]
    unit: dict[str, str]
    poses: int
    map: list[MapPoint]
    # priors only, or with the estimate, the effects, or all answers of a diagnosis
    mode: Annotated[str, msgspec.Meta(pattern="^(plan|identified|corrected|mixture)$")]
    realised: dict[str, SpreadRecord] | None = (
        None  # of virtual machines after compensation
    )
    realised_share: dict[str, float] = {}  # their rms over the predicted one
    budget: BudgetSection | None = None
    # after compensation against each reference, by reference and component
    references: dict[str, dict[str, SpreadRecord]] = {}
    # commands at which each component is predicted worst
    worst: dict[str, MapPoint] = {}
    # after compensation at tools of other lengths
    tools: list[ToolAccuracy] = []
    # rms error to reach, by component, in its unit
    wanted: dict[str, float] = {}
    # values by column at which the machine is used, where effects are allowed; what is not
    # there is as in the session
    states: dict[str, list[float]] = {}
    states_from: str = ""  # "study", or "readings" where the study states none

    @property
    def with_usual_effects(self) -> dict[str, ComponentAccuracy]:
        """The accuracy of a plan's driven components, usual effects counted."""
        usual = None if self.budget is None else self.budget.usual
        if self.mode != "plan" or usual is None:
            return {}
        return {n: c for n, c in usual.components.items() if n in usual.fitted}

    @property
    def judged_components(self) -> dict[str, ComponentAccuracy]:
        """The accuracy that is compared with the wanted one."""
        return self.components | self.with_usual_effects


class HeldOutSection(Record, frozen=True):
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
    predicted: float | None = None  #: rms that is predicted for the readings
    #: of the same readings with the nominal numbers in place of the fitted ones
    rms_before: float | None = None
    #: confirms: the fit predicts them better than the nominal numbers do. contradicts:
    #: worse, or fewer are inside than belong there. agrees: neither
    verdict: HeldOutVerdict | None = None
    words: str = ""  #: the verdict in a sentence


class WantedVerdict(Record, frozen=True):
    """Verdict on one component's rms error over the workspace, in `unit`."""

    judgement: Judgement
    probability: float  #: that the rms error of this machine is at most what is wanted
    rms: float  #: predicted; wanted: what it is compared with
    wanted: float
    unit: str
    scope: str  #: what the probability holds
    #: whether readings that no fit used agree with the prediction
    confirmed: bool = False
    decide: str = ""  #: what would decide, where neither pass nor fail is stated
