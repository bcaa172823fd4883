"""Residual accuracy: the `prediction` and `held_out` sections of result.json."""

from __future__ import annotations

import bisect
from typing import Annotated, Final, Literal

import msgspec

from oed.result.budget import BudgetSection
from oed.result.record import Judgement, Record, Size

#: a figure of drawn machines, and its errors: one, or one for each end
Figure = Annotated[str, msgspec.Meta(pattern="^(rms|p95|max)(_interval)?$")]
MonteCarloErrors = Annotated[list[float], msgspec.Meta(min_length=1, max_length=2)]
#: lower and upper end
Interval = tuple[float, float]
#: what held-out readings say of a fit
HeldOutVerdict = Literal["agrees", "confirms", "contradicts"]
#: probabilities of the quantiles that are stored of a distribution
LEVELS: Final[tuple[float, ...]] = (
    *(0.005, 0.01, 0.025, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5),
    *(0.6, 0.7, 0.8, 0.9, 0.95, 0.975, 0.99, 0.995),
)


class SpreadRecord(Record, frozen=True):
    """Error of one pose component over the workspace: rms, 95th percentile, largest, in
    `unit`.

    An interval holds that figure of 95 % of the machines, each over its workspace.
    `rms_quantiles` are those of the rms error of one machine, at the probabilities
    `LEVELS`.
    `monte_carlo` has the standard errors that the number of drawn machines leaves, by
    figure: of `p95`, `max` and both ends of an interval, of `rms` where it is drawn.
    """

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
        levels, quantiles = LEVELS, self.rms_quantiles
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
