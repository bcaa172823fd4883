"""What is planned, in result.json: what readings can see, the design, and its stages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

import msgspec

from oed.result.record import Logarithm, Number, Record, Size


class IdentifiabilityFinding(Record, frozen=True):
    """One line of the identifiability verdict in words."""

    kind: str  # seen | combination | lost | weak
    text: str
    remedies: tuple[str, ...] = ()  # additional readings that would help, a phrase each


class IdentifiabilitySection(Record, frozen=True):
    """What the plan's readings can see. Combinations and lost directions are
    {parameter: coefficient}, SI.
    """

    parameters: list[str]
    n: int
    rank: Annotated[int, msgspec.Meta(ge=0)]
    tolerance: float  # singular values below this share of the largest count as zero
    scaling: str
    singular_values: list[Size]
    combinations: list[dict[str, float]]
    lost: list[dict[str, float]]
    words: list[IdentifiabilityFinding]
    #: {index: value} over the determined directions, where the study asks for them
    indices: dict[str, float] = {}


class KappaMap(Record, frozen=True):
    """Condition number over the number of circles and of points on each, for one
    parametrisation.
    """

    title: str
    circles: list[int]
    points: list[int]
    kappa: Sequence[Sequence[Number]]  # [circle][point]


class RecordedChoice(Record, frozen=True):
    """A covariate to record, or a choice that lets effects be told apart.

    gain      share by which the error falls: root mean square of the components, each in
              units of what the plan leaves without it
    readings  further readings like the plan's that would give the same without it; None
              where no number does
    """

    name: str  # column of the readings file, or name of a measurement
    words: str
    effects: list[str]  # that are functions of it
    accuracy: dict[str, float]
    gain: float
    readings: int | None


class RecordingSection(Record, frozen=True):
    """What the readings of a plan leave where nothing but poses is recorded, and what else.

    Accuracies are rms errors by component and fine unit (`z_um`) after compensation.
    """

    readings: int  # of the plan
    accuracy: dict[str, float]
    floor: dict[str, float]  # with any number of readings like these
    choices: list[RecordedChoice]  # the best first


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


class Sd(Record, frozen=True):
    """Standard deviation of a parameter, in its display unit."""

    sd: float
    unit: str


class StageRecord(Record, frozen=True):
    """One stage of the plan: measurement, what it identifies, its cost (min).

    The fields with defaults are those of planned stages. Accuracies are root mean
    squares over the workspace, by component and unit (`z_um`), after all stages up to
    this one.
    """

    measurement: str
    setups: list[str]  # in working order
    readings: int
    identifies: (
        int  # rank of its own readings, over the machine and the stage's set-ups
    )
    cost: float
    kappa: float
    predicted: dict[str, float]
    chosen: int | None = None  # candidates: readings, or whole runs
    begin_min: float | None = None
    end_min: float | None = None
    price: float = 0.0
    operator: str = ""
    available: dict[
        str, float
    ] = {}  # least and mean chance that a chosen candidate can be read
    lost: float | None = None  # candidates expected out of the instrument's travel
    cut_off_um: float | None = (
        None  # largest, of what linearisation leaves out of a reading after the stage
    )
    rank: int | None = None  # of all readings so far, over the machine's parameters
    parameters: dict[str, Sd] = {}  # after the stage
    #: parameters and combinations that no reading so far determines
    unidentified: list[str] = msgspec.field(default_factory=list, name="held")
    accuracy: dict[str, float] = {}
    realised: dict[str, float] = {}  # of virtual machines, over the predicted one
    realised_lost: float | None = None  # candidates that virtual machines lost
    coverage: float | None = None  # of their true parameters, inside 95 % intervals


class AlternativePlan(Record, frozen=True):
    """A plan in short: measurements in order, readings (or runs) of each, and why it is
    not the plan, in words.

    value is what plans are judged by, the smaller the better: the worst component over
    what is wanted, or the root mean square of the components over what they are before
    any reading.
    """

    names: list[str]
    readings: list[int]
    minutes: float
    value: float
    accuracy: dict[str, float]
    why: str = ""


class SequenceRecord(Record, frozen=True):
    """A sequence that was asked for, and the best plan found in its time. It takes all
    readings of each measurement, or, where they take longer than the budget, the best
    ones within it.

    gain: factor by which each component is more accurate with that plan;  bound: no plan of that time has a smaller
    value.  weakest: smallest singular value of its readings, in the scaling "length"
            (mm, angles times the lever)
    """

    name: str
    sequence: AlternativePlan = msgspec.field(name="way")
    rank: int
    parameters: int
    kappa: float
    weakest: float
    observability: dict[str, float]
    lost: float
    plan: AlternativePlan
    gain: dict[str, float]
    bound: float
    words: str = ""


class PlanEffects(Record, frozen=True):
    """The effects that a plan allows for, and the plan for a machine without them.

    without   that plan, with the accuracy that it reaches on a machine with the effects
    promised  accuracy that it has on a machine without them, by component and fine unit
    """

    groups: int
    unknowns: int  # combinations of them that the plan carries from stage to stage
    without: AlternativePlan
    promised: dict[str, float]
    words: str
    recording: RecordingSection | None = None  # what else to record


class PlanSection(Record, frozen=True):
    """The plan as stages. The fields with defaults are those of plans that were
    searched for.

    goal            wanted accuracy by component;  reached: whether the plan has it
    best_reachable  accuracy of the most accurate plan found
    needs           what would have to change, where that is not enough
    bound           no plan within the budget has a smaller value;  loss: share by which
                    the plan may miss it at most
    lines           supporting lines drawn for the bound
    front           plans of which none is both shorter and more accurate, shortest
                    first
    """

    stages: list[StageRecord]
    cost: float
    alternatives: list[str | AlternativePlan]
    budget_min: float | None = None
    price: float = 0.0
    value: float | None = None
    goal: dict[str, float] = {}
    reached: bool = True
    start_accuracy: dict[str, float] = {}
    accuracy: dict[str, float] = {}
    best_reachable: dict[str, float] = {}
    needs: list[str] = []
    bound: float | None = None
    loss: float | None = None
    lines: int | None = None
    front: list[AlternativePlan] = []
    stop: str = ""
    compared: list[SequenceRecord] = []
    after: str = ""  # what was known and done before, in words
    virtual_machines: int = 0
    effects: PlanEffects | None = None
