"""Accuracy in result.json: predicted with its budget, forecast, adjusted, accepted."""

from __future__ import annotations

import bisect
from typing import Annotated, ClassVar, Literal

import msgspec

from oed.result.record import Judgement, Record, Size


class PromiseRecord(Record, frozen=True):
    """What an acceptance test demands of one pose component, in `unit`.

    promised     rms error over the workspace; of what no drive corrects, with further
                 axes that take the known error back
    limit        largest rms of the measured errors that a machine at its promise has: it
                 fails beyond
    confirms     largest rms with which it meets its promise: a machine that misses stays
                 below with a probability of 5 %; null where the test cannot confirm
    power        probability that a machine which misses the promise is caught
    uncertainty  standard uncertainty of one measured error
    without      rms error over the workspace without additional axes, where no drive
                 corrects the component
    """

    promised: float
    limit: float
    power: float
    uncertainty: float
    unit: str
    without: float | None = None
    confirms: float | None = None


class AcceptanceSection(Record, frozen=True):
    """Which poses confirm the promised accuracy.

    poses        commands by column, in the order of the plan
    components   {component: demand}
    reference    against which errors are stated: absolute, home or best_fit
    miss         factor on the promised rms of a machine that misses
    false_alarm  probability that a machine at its promise fails
    conditions   what the promise rests on
    further      {component: demand} of what no drive corrects; measured or not
    offsets      errors of these, known in advance, at each pose, in their units
    healthy      {component: rms} that the plan predicted for a healthy machine, with all
                 that is known corrected, in the components' units
    """

    poses: Annotated[list[dict[str, float]], msgspec.Meta(min_length=1)]
    components: dict[str, PromiseRecord]
    reference: str
    miss: float
    false_alarm: float
    conditions: list[str] = []
    further: dict[str, PromiseRecord] = {}
    offsets: list[dict[str, float]] = []
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
    """Figures in the manner of ISO 230-2, in `unit`; null where directions are missing.

    approaches  fewest of one direction at a target; the standard asks for five
    """

    targets: int
    approaches: int
    accuracy: float
    systematic: float
    repeatability: float
    mean: float | None
    reversal: float | None
    unit: str


class VerificationSection(Record, frozen=True):
    """Whether the measured errors confirm the promise.

    verdict  the worst of the components; null in results of older versions, whose tests
             could not end in `cannot tell`
    further  verdicts on what no drive corrects, as far as it was measured
    healthy  {component: rms} that the plan predicted for a healthy machine
    """

    passed: bool
    readings: int
    components: dict[str, VerdictRecord]
    positioning: dict[str, PositioningRecord] = {}
    further: dict[str, VerdictRecord] = {}
    healthy: dict[str, float] = {}
    verdict: Judgement | None = None

    @property
    def judgement(self) -> Judgement:
        """The verdict; that of older versions knew pass and fail alone."""
        return self.verdict or ("pass" if self.passed else "fail")


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


class ForecastComponent(Record, frozen=True):
    """Errors of one pose component against the reference, in `unit`, as rms.

    expected       what calibration is expected to leave
    planned        what interpolation between the nodes is predicted to leave, before a
                   reading
    measured       errors of the nodes as read
    predicted      what the table is predicted to leave over the workspace, with the ends
                   of its 95 % interval
    left_out       errors of nodes less their prediction by all others; and as predicted
    checked        what the table leaves at nodes that were not fitted; as predicted, the
                   largest one, and the largest error without the table
    """

    unit: str
    expected: float
    planned: float
    measured: float | None = None
    predicted: float | None = None
    low: float | None = None
    high: float | None = None
    left_out: float | None = None
    left_out_predicted: float | None = None
    checked: float | None = None
    checked_predicted: float | None = None
    checked_max: float | None = None
    checked_max_before: float | None = None


class ForecastSection(Record, frozen=True):
    """Which nodes to measure, and what the controller's table leaves.

    components  {component: figures}
    reference   against which errors are stated: home or absolute
    nodes       commands to measure, by column, the most useful one first
    setup       set-up whose times count
    minutes     time of mounting it and of reading all nodes
    readings    number of rows read
    table       nodes of the controller's table along each command coordinate
    places      places of these nodes, by column of the command
    corrections  what the table adds to the joints at its nodes, by column, the last
                coordinate running fastest
    whole       whether these also hold what identified parameters correct
    sentences   what the figures rest on
    """

    components: dict[str, ForecastComponent]
    reference: str
    nodes: Annotated[list[dict[str, float]], msgspec.Meta(min_length=1)]
    setup: str
    minutes: float
    readings: int = 0
    table: dict[str, int] = {}
    places: dict[str, list[float]] = {}
    corrections: dict[str, list[float]] = {}
    whole: bool = False
    sentences: list[str] = []


class BudgetLine(Record, frozen=True):
    """A source of the errors of the compensated machine; values by pose component.

    source   its name
    kind     instrument, run, course, noise law, set-up, effects, prior or linearisation;
             with a compensation file also interpolation, rounding or left out
    share    of the predicted variance; below 0 where a linear calculation predicts too
             much
    size     root of its variance, in the component's unit, with the sign of its share
    without  rms error without it, the estimate adapted; null where nobody can remove it
    halved   rms error with half its standard deviation, or null
    """

    source: str
    kind: str
    share: dict[str, float]
    size: dict[str, float]
    without: dict[str, float] | None = None
    halved: dict[str, float] | None = None


class UnmodelledLine(Record, frozen=True):
    """Expected errors by an effect that the model lacks; values by pose component.

    size          rms error that it adds through calibration to the workspace
    with_it       rms error of the compensated machine with it
    expected      its expected size, in words
    far           rms error with it at 30 times that size, the largest usual one
    without       rms error of `usual.components` without it; absent from results of
                  earlier versions
    not_testable  why the readings cannot find it; null where they can
    """

    effect: str
    about: str
    expected: str
    size: dict[str, float]
    with_it: dict[str, float]
    remedy: str
    not_testable: str | None = None
    far: dict[str, float] = {}
    without: dict[str, float] = {}


class UsualEffects(Record, frozen=True):
    """Accuracy of a machine with all usual effects at their expected sizes.

    Values are rms errors by pose component, of those that the drives correct; of all where
    they correct none.

    effects     their names
    unmodelled  where the calibration knows none of them
    fitted      where all are fitted with the parameters, and corrected with them
    components  where all are fitted so, and a controller is sent parameters alone; `known`:
                corrected with them. Absent from results of earlier versions
    """

    effects: list[str]
    unmodelled: dict[str, float]
    fitted: dict[str, float]
    components: dict[str, ComponentAccuracy] = {}


class BudgetSection(Record, frozen=True):
    """Sources of the errors that remain, each component in its fine unit.

    predicted   rms error that the lines add up to; of what no drive corrects, with
                additional axes that take the known error back
    no_axes     rms error of what no drive corrects, without additional axes
    lines       of what the prediction contains
    unmodelled  effects that it does not contain, at their expected sizes, the one that
                costs `usual` most first
    usual       the machine with all of these; null where none are listed
    advice      what to improve first, in sentences
    """

    predicted: dict[str, float]
    lines: list[BudgetLine]
    unmodelled: list[UnmodelledLine] = []
    usual: UsualEffects | None = None
    advice: list[str] = []
    no_axes: dict[str, float] = {}


#: a figure of drawn machines, and its errors: one, or one for each end
Figure = Annotated[str, msgspec.Meta(pattern="^(rms|p95|max)(_interval)?$")]
MonteCarloErrors = Annotated[list[float], msgspec.Meta(min_length=1, max_length=2)]
#: lower and upper end
Interval = tuple[float, float]
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
        """What is compared with the wanted accuracy.

        Of a component that no drive corrects, the unknown part, as criteria judge it.
        """
        return self.after if self.compensatable else self.known


class MapPoint(Record, frozen=True):
    """1-sigma prediction at one workspace pose (user units), by component.

    at    tool point (3,) of the reference tool, m, in the base frame
    """

    command: dict[str, float]
    before: dict[str, float]
    after: dict[str, float]
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

    predicted   rms that is predicted for the readings
    rms_before  of the same readings with the nominal numbers in place of the fitted ones
    verdict     confirms: the fit predicts them better than the nominal numbers do.
                contradicts: worse, or fewer are inside than belong there. agrees: neither
    words       the verdict in a sentence
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
    predicted: float | None = None
    rms_before: float | None = None
    verdict: HeldOutVerdict | None = None
    words: str = ""


class WantedVerdict(Record, frozen=True):
    """Verdict on one component's rms error over the workspace, in `unit`.

    rms          predicted; wanted: what it is compared with
    probability  that the rms error of this machine is at most what is wanted
    scope        what the probability holds
    confirmed    whether readings that no fit used agree with the prediction
    decide       what would decide, where neither pass nor fail is stated
    """

    judgement: Judgement
    probability: float
    rms: float
    wanted: float
    unit: str
    scope: str
    confirmed: bool = False
    decide: str = ""
