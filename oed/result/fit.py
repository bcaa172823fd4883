"""Estimate, posterior and goodness: sections of result.json of what readings tell."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

import msgspec

from oed.result.gap import CompensationName
from oed.result.record import Number, Record, Size


class OutlierRecord(Record, frozen=True):
    """A reading that all others contradict.

    row   of its file
    file  its name, where the readings are of several
    """

    setup: str
    run: str
    order: int
    row: int
    pull: float
    file: str = ""


class MistakeRecord(Record, frozen=True):
    """A mistake that explains readings which do not fit, and how far it does."""

    what: str
    evidence: str


class NoiseRecord(Record, frozen=True):
    """One number of the noise law as estimated.

    kind     reading (about the mean of its run), run, seat, course at the session's end
             (standard deviations),
             carried (share of the variance) or reach (in readings)
    of       set-up and channel, or set-up; empty for all readings
    stated   what the stated noise has
    departs  whether it surely differs from that by more than matters
    """

    kind: str
    of: str
    value: float
    sd: float
    unit: str
    stated: Number = None
    departs: bool = False


class LeftOutRun(Record, frozen=True):
    """A run against what all other runs predict of it.

    values     number of its values
    ratio      its errors over what is predicted
    p_high     probability of larger errors
    log_score  log predictive density, readings in units of their noise
    """

    setup: str
    run: str
    values: int
    ratio: float
    p_high: float
    log_score: float

    @property
    def chi2(self) -> float:
        """Squared standardised errors, of as many degrees of freedom as values."""
        return self.ratio**2 * self.values


class GoodnessSection(Record, frozen=True):
    """Goodness of fit against the stated noise, and what a check of the readings says.

    chi2, dof  of the parameters that are delivered, as in `estimate`, without `outliers`
               and `doubtful`; p_low, p_high  probabilities of less and of more
    law_p_low, law_p_high  of less and of more under the law that is estimated, with a
               scatter of single readings within what a statement is good for
    bad_fit    whether nothing fitted to the readings can be trusted
    outliers   gross errors, which no fit includes
    doubtful   readings that may be gross errors or noise; fits include them
    unlocated  rows of the file one of which is wrong; fits include all
    findings   sentences, the most harmful first
    noise     the noise law as estimated, by the names of its numbers; empty where the
              noise is as stated
    noise_words  how it departs from the stated noise, as sentences
    left_out  each run predicted from the others; their log score with its standard
              deviation in `left_out_score` and `left_out_sd`
    """

    chi2: Number
    dof: Number
    p_low: Number
    p_high: Number
    bad_fit: bool = False
    outliers: list[OutlierRecord] = []
    doubtful: list[OutlierRecord] = []
    unlocated: list[int] = []
    mistakes: list[MistakeRecord] = []
    findings: list[str] = []
    noise: dict[str, NoiseRecord] = {}
    noise_words: list[str] = []
    left_out: list[LeftOutRun] = []
    left_out_score: Number = None
    left_out_sd: Number = None
    law_p_low: Number = None
    law_p_high: Number = None

    @property
    def fit_words(self) -> str:
        """What the figures of a fit leave out, as the end of a phrase: rows set aside."""
        return self.without_rows(len(self.outliers), "set aside")

    @property
    def chi2_words(self) -> str:
        """What chi2 leaves out, likewise: rows set aside, and rows in doubt."""
        doubtful = self.without_rows(len(self.doubtful), "in doubt")
        joint = " and" if self.outliers and doubtful else ""
        return f"{self.fit_words}{joint}{doubtful}"

    @staticmethod
    def without_rows(count: int, what: str) -> str:
        """` without the 2 rows set aside`; empty for none."""
        return (
            f" without the {count} row{'s' if count > 1 else ''} {what}"
            if count
            else ""
        )


#: probability below which a discrepancy contradicts the posterior, either way
CONTRADICTION_PROBABILITY = 0.005


class ParameterEstimate(Record, frozen=True):
    """An identified parameter, in its display unit."""

    value: float
    sd: Size
    unit: str
    nominal: float
    prior_sd: Size
    identified: (
        str  # seen | weak | prior  (how much the readings tightened the tolerance)
    )
    truth: float | None = None  # of a virtual machine


class CombinationEstimate(Record, frozen=True):
    """A linear combination of parameters that the readings determine.

    terms      coefficient of each parameter, SI over SI; 1 at the first that has its unit
    value      of the combination's departure from nominal
    tolerance  its standard deviation before the readings
    """

    terms: dict[str, float]
    value: float
    sd: float
    tolerance: float
    unit: str


class HeldParameter(Record, frozen=True):
    """A parameter that the model holds exactly, and that the readings contradict.

    parameters    one, or several that are moved together
    held, estimate, sd  where it is held, and freed, in `unit`; means of several
    p_value       of the held value, times the number of such tests
    changes       {parameter: change with this one freed}, of those that change most, in
                  their `units`
    tool_mm       rms shift of the tool by these changes, at the poses read
    """

    parameters: list[str]
    held: float
    estimate: float
    sd: float
    unit: str
    p_value: float
    changes: dict[str, float]
    units: dict[str, str]
    tool_mm: float


class RunCurve(Record, frozen=True):
    """Readings along a run, as departures from those of the nominal machine, in `unit`.

    kind         circle: `at` is the angle in degrees; line: the way along it in mm
    measured     of each reading
    predicted    of the identified machine
    half_widths  half of the 95 % interval of a reading about `predicted`
    compensated  what the compensated machine is predicted to read, from the parameters
                 and what no drive corrects, with half of its 95 % interval; none where
                 only joints are recorded, and of readings after compensation
    """

    setup: str
    run: str
    channel: str
    unit: str
    kind: Annotated[str, msgspec.Meta(pattern="^(circle|line)$")]
    at: list[float]
    measured: list[float]
    predicted: list[float]
    half_widths: list[float]
    compensated: list[float] = []
    compensated_half_widths: list[float] = []


class EstimateSection(Record, frozen=True):
    """Least squares with tolerance priors. rms and residuals are in the fine unit of
    their channel, `units`.
    """

    parameters: dict[str, ParameterEstimate]
    rms_before: dict[str, float]
    rms_after: dict[str, float]
    units: dict[str, str]  # of each channel
    channels: list[str]  # of each residual
    readings: int
    dof: float
    chi2: Size
    iterations: list[dict[str, float]]
    warnings: list[str]
    residuals: list[float]  # of each reading, after
    residuals_before: list[float]
    covariance: list[list[float]] = []  # of `parameters`, in their units
    combinations: list[CombinationEstimate] = []
    # read, or read against, each once; none where only joints are recorded
    commands: list[dict[str, float]] = []
    # of results of older versions, whose fit could allow effects beside the geometry
    effects: list[dict[str, str | float | bool]] = []
    faulty: float | None = None
    controller: dict[str, float] = {}
    sent: str = CompensationName.MIXTURE
    # what the model holds exactly, and the readings contradict
    held: list[HeldParameter] = []
    # circles and lines of the readings
    runs: list[RunCurve] = []


class Marginal(Record, frozen=True):
    """Posterior of one parameter, in its display unit.

    rhat    of emcee's ensembles; None for independent draws
    ess     None for a parameter that is not sampled
    """

    mean: float
    sd: float
    q025: float
    q975: float
    rhat: Number
    ess: Number
    unit: str


class PredictiveCheckRecord(Record, frozen=True):
    """A discrepancy of the residuals, in units of the stated noise.

    low, high  95 % of the draws of the noise lie between
    p_high     share of draws in which the noise has the larger one
    """

    observed: float
    low: float
    high: float
    p_high: float

    @property
    def alarming(self) -> bool:
        """Whether the readings contradict the posterior."""
        return (
            not CONTRADICTION_PROBABILITY
            <= self.p_high
            <= 1.0 - CONTRADICTION_PROBABILITY
        )


class PosteriorSection(Record, frozen=True):
    """Sampler summary. `posterior.nc` holds the draws.

    sampler    `importance` (independent draws) or `emcee`
    pareto_k   shape of the tail of the importance weights, also where emcee ran because it
               is too large; None where no weights were computed
    proposals  points that were weighted

    Of emcee alone, None and 0 for independent draws: acceptance, walkers,
    autocorrelation.
    """

    IMPORTANCE: ClassVar[str] = "importance"
    EMCEE: ClassVar[str] = "emcee"

    marginals: dict[str, Marginal]
    acceptance: Number
    draws: int
    walkers: int
    autocorrelation: Number
    directions: list[str]  # names of the worst-seen directions shown in the corner plot
    corner: list[
        list[float]
    ]  # thinned draws [draw][direction], in prior standard deviations
    checks: dict[str, PredictiveCheckRecord] = {}  # posterior predictive
    sampler: str = "emcee"
    pareto_k: Number = None
    proposals: int = 0

    @staticmethod
    def largest_pareto_k(points: int) -> float:
        """Shape of the weights' tail up to which means over `points` converge.

        Vehtari, Simpson, Gelman, Yao and Gabry 2024, JMLR 25(72), equation 13.

        >>> k = PosteriorSection.largest_pareto_k
        >>> k(1000), k(1_000_000)
        (0.666..., 0.7)
        """
        return min(1.0 - 1.0 / math.log10(max(points, 10)), 0.7)
