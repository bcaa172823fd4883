"""The chosen readings: the `design` section of result.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from oed.result.record import Logarithm, Number, Record
from oed.result.recording import RecordingSection


class PlannedReading(Record, frozen=True):
    """One planned reading: where it is taken, in user units (`z_mm`, ...), and what it
    nominally reads; `joints` are those that the controller sends, by column (`q1_mm`, ...).
    """

    setup: str
    run: str
    order: int
    command: dict[str, float]
    reading: dict[str, float]
    joints: dict[str, float] = {}


class PlanScore(Record, frozen=True):
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
    #: factor by which each is better than that of the first reference plan
    gain: dict[str, float] = {}


class CriterionComparison(Record, frozen=True):
    """The design for one criterion, and how the designs for the others do by it."""

    name: str  # criterion
    value: float
    bound: float | None
    efficiency: float | None
    proven: bool
    gain: float  # phi of this design over phi of the main one, by this criterion: 1 or more
    values: Mapping[str, Number]  # by this criterion, of the design for each criterion


class PolishSummary(Record, frozen=True):
    """Poses (and set-ups) polished off the grid: the criterion before and after."""

    before: float
    after: float
    words: str
    setups: dict[
        str, dict[str, float]
    ]  # what was free of each set-up, as it is now, in user units


class WorkingOrder(Record, frozen=True):
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


class RobustSummary(Record, frozen=True):
    """A plan chosen over scenarios: log phi by the risk asked for, and in each scenario
    (the first is nominal).
    """

    risk: str
    level: float
    scenarios: int
    value: Logarithm
    bound: Logarithm
    efficiency: float
    nominal: Logarithm  # of the plan for the nominal machine, by the same risk
    values: Sequence[Logarithm | None]
    nominal_values: Sequence[Logarithm | None]


class HowManySummary(Record, frozen=True):
    """Predicted rms of pose components (`z_um`) against the number of readings, and the
    bound of each alone.

    fewest: readings that reach what is wanted, None where none up to `most` do; no plan
    of fewer than `at_least` can
    """

    wanted: dict[str, float]
    sizes: list[int]
    accuracy: Mapping[str, Sequence[Number]]
    bound: Mapping[str, Sequence[Number]]
    fewest: int | None = None
    at_least: int | None = None
    most: int | None = None
    words: str = ""


class CandidateWeight(Record, frozen=True):
    """Weight of a candidate: a reading, or a run by its first reading."""

    setup: str
    run: str
    command: dict[str, float]  # in user units (`z_mm`, ...)
    weight: float  # share of a reading, 0 to 1


class RelaxedSummary(Record, frozen=True):
    """Optimal weights of the candidates, their criterion's value and its bound."""

    solver: str
    value: float  # of the criterion at the weights
    bound: float  # of the criterion for all plans
    gap: float  # between value and bound, log of an efficiency
    weights: list[CandidateWeight]  # largest first; the others are 0


class AllowedEffects(Record, frozen=True):
    """The plan that allows for effects, beside the plan for a machine without.

    Accuracies are rms errors by component and fine unit (`z_um`) after compensation, with
    the effects at the sizes expected of them, once all that is known is corrected. The
    plan is chosen for effects of `size` times that. An efficiency above 1 is that of a
    plan which is better than this one.
    """

    groups: int  # of effects
    unknowns: int  # combinations of them that the criterion profiles out
    efficiency: float  # of the plan for a machine without effects, where it has them
    efficiency_without: float  # of this plan, where the machine has none
    accuracy: dict[str, float]
    accuracy_without: dict[str, float]  # of the plan for a machine without effects
    before: dict[str, float]  # without any reading
    recording: RecordingSection | None = None  # what else to record
    size: float = 1.0  # of the effects that the plan is chosen for, in expected sizes


class DesignSection(Record, frozen=True, kw_only=True):
    """The chosen readings.

    value, bound, efficiency are of the chosen readings under the study's rules: nothing
    is better than the bound (for kappa, the smaller is the better, nothing is below
    it). Polished readings leave the grid, and have no bound.
    """

    criterion: str
    n: int
    value: float
    bound: float | None = None
    efficiency: float | None = None
    kappa: float
    observability: dict[str, float]
    poses: list[PlannedReading] = []
    scaling: str
    candidates: int
    plans: list[PlanScore] = []
    words: str = ""  # how good the choice is known to be, as a sentence
    directions: int = 0  # that the candidates see and the criterion is stated over, of `columns` unknowns
    columns: int = 0
    # what is known of the bound's own slack (log of an efficiency)
    gap: Logarithm | None = None
    proven: bool = False
    compound: dict[str, float] = {}  # shares of the criteria
    setups: list[str] = []  # used, in working order
    #: readings that belonged to the plan before
    retained: int = msgspec.field(default=0, name="kept")
    cost_min: float | None = None  # mounting and reading
    refused: dict[str, int] = {}  # candidates left out, by reason
    compared: list[CriterionComparison] = []
    polished: PolishSummary | None = None
    order: WorkingOrder | None = None
    robust: RobustSummary | None = None
    how_many: HowManySummary | None = None
    effects: AllowedEffects | None = None
    relaxed: RelaxedSummary | None = None  # weights, where the plan is of the largest
