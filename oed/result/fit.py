"""Estimate and posterior: the `estimate` and `posterior` sections of result.json."""

from __future__ import annotations

import math
from typing import Annotated

import msgspec

from oed.result.mixture import MIXTURE
from oed.result.record import Number, Record, Size

#: probability below which a discrepancy contradicts the posterior, either way
CONTRADICTED = 0.005


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
    sent: str = MIXTURE
    # what the model holds exactly, and the readings contradict
    held: list[HeldParameter] = []
    # circles and lines of the readings
    runs: list[RunCurve] = []


#: samplers of the posterior
IMPORTANCE, EMCEE = "importance", "emcee"


def largest_pareto_k(points: int) -> float:
    """Shape of the weights' tail up to which means over `points` converge.

    Vehtari, Simpson, Gelman, Yao and Gabry 2024, JMLR 25(72), equation 13.

    >>> largest_pareto_k(1000), largest_pareto_k(1_000_000)
    (0.666..., 0.7)
    """
    return min(1.0 - 1.0 / math.log10(max(points, 10)), 0.7)


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
        return not CONTRADICTED <= self.p_high <= 1.0 - CONTRADICTED


class PosteriorSection(Record, frozen=True):
    """Sampler summary. `posterior.nc` holds the draws.

    sampler    `importance` (independent draws) or `emcee`
    pareto_k   shape of the tail of the importance weights, also where emcee ran because it
               is too large; None where no weights were computed
    proposals  points that were weighted

    Of emcee alone, None and 0 for independent draws: acceptance, walkers,
    autocorrelation.
    """

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
