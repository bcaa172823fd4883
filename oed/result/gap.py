"""The diagnosis in result.json: `gap`, its mixture, and `gap_before` of a plan.

Names of the first block of fields of `Gap` are fixed by the contract. Sizes and
residuals are in the fine unit of their channel. A number that is not known is null.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar, Final

import msgspec

from oed.result.prediction import PredictionSection
from oed.result.record import Point, Probability, Record, Size

#: an effect of an answer whose form no known effect has
UNKNOWN = "unknown"


class CompensationName:
    """Names of the compensations that are compared: `sent` and `choices` of a mixture."""

    MIXTURE: Final = "mixture"
    BEST: Final = "best answer"
    BEST_WITH_EFFECTS: Final = "best answer with effects"
    PLAIN: Final = "plain fit"
    NOTHING: Final = "nothing"


class MixedAnswer(Record, frozen=True):
    """An answer that the mixture holds, with its probability by the diagnosis.

    effects  that act, `unknown` for something of no known form; none: no gap
    unseen   whether small effects of one common size act as well
    """

    effects: tuple[str, ...]
    probability: Probability
    unseen: bool = False


class MixedParameter(Record, frozen=True):
    """A parameter over all hypotheses, in `unit`.

    within     standard deviation that the answers have on average; the rest of `sd` is
               between them
    low, high  ends of the 95 % interval, quantiles of the mixture
    """

    value: float
    sd: float
    within: Size
    low: float
    high: float
    unit: str


class CompensationChoice(Record, frozen=True):
    """A compensation, and the rms error that all answers expect of it.

    name  `plain fit` (no effect in the model), `best answer` or `mixture`, each with the
          geometry alone; `best answer with effects`, where effects are corrected;
          `nothing`
    rms   {component: in its fine unit}
    """

    name: str
    rms: dict[str, float]


class MixtureSection(Record, frozen=True):
    """Parameters and accuracy over all hypotheses of a diagnosis.

    answers     that were fitted, the decision's first
    rest        probability of all others
    controller  parameters for a controller that corrects geometry alone, in the units of
                `parameters`: those of `sent`
    sent        the choice of least expected error with the geometry alone; `mixture` is
                the mean, shifted so that it takes up what is known of the effects
    covariance  of `parameters`, in their units
    choices     compensations and what all answers expect of each
    prediction  with `controller` sent, over all hypotheses; null without a workspace
    with_effects  the same with the parameters and the effects of the best answer sent;
                null where none is corrected, or that is expected to be worse
    words       in sentences
    """

    answers: list[MixedAnswer]
    rest: float
    parameters: dict[str, MixedParameter]
    covariance: list[list[float]]
    controller: dict[str, float] = {}
    sent: str = CompensationName.MIXTURE
    choices: list[CompensationChoice] = []
    prediction: PredictionSection | None = None
    with_effects: PredictionSection | None = None
    words: list[str] = []


#: two names
Pair = Annotated[list[str], msgspec.Meta(min_length=2, max_length=2)]


class SharedRecord(Record, frozen=True):
    """A combination of an effect's coefficients that a rival imitates.

    detectability    sqrt(lambda) where nothing else acts
    separation       sqrt(lambda) once the rival absorbs what it can
    angle_deg        principal angle between the combination and the rival
    """

    words: str
    combination: dict[str, float]
    detectability: float = msgspec.field(name="seen")
    separation: float = msgspec.field(name="apart")
    angle_deg: float


class RivalRecord(Record, frozen=True):
    """How well an effect can be distinguished from another: sqrt(lambda_k|j), smallest principal
    angle.
    """

    name: str
    separation: float = msgspec.field(name="apart")
    angle_deg: float
    shared: list[SharedRecord]


class DetectabilityRecord(Record, frozen=True):
    """What could be found of one effect.

    detectability  at its expected size, over the values of its constants from `low` to
                   `high`; `power`: chance of finding it at 1 % false alarm
    signature      rms of its readings at that size; `absorbed`: share of it that
                   calibration absorbs
    least, median  smallest rms that is found with 90 % power: in the form seen best,
                   and typically
    sizes          least size of each coefficient by itself
    """

    name: str
    about: str
    columns: int = 0
    detectability: float = 0.0
    low: float = 0.0
    high: float = 0.0
    power: float = 0.0
    visible: bool = False
    signature: dict[str, float] = {}
    absorbed: float = 0.0
    least: dict[str, float | None] = {}
    median: dict[str, float | None] = {}
    sizes: dict[str, float | None] = {}
    rivals: list[RivalRecord] = []
    not_testable: str | None = None


class DetectabilityTable(Record, frozen=True):
    """All effects over one plan of `readings` readings.

    names, apart, angles_deg   (K), (K x K): row after column is absorbed; detectability
                               on the diagonal
    classes    groups of visible effects that can not all be distinguished;  absorbed:
               pairs, the first not from the second
    exact      pairs of which some combinations are the same to these readings
    """

    readings: int
    effects: list[DetectabilityRecord]
    names: list[str]
    separation: list[list[float]] = msgspec.field(name="apart")
    angles_deg: list[list[float]]
    classes: list[list[str]]
    absorbed: list[Pair]
    exact: list[Pair]


class ChosenRun(Record, frozen=True):
    """A run to take, under its condition (SI)."""

    setup: str
    run: str
    condition: dict[str, float]
    seconds: float


class SeparationRecord(Record, frozen=True):
    """A combination of an effect's coefficients against a rival: sqrt(lambda) of the
    chosen runs, and of the readings planned without [gap.design] (null where they
    cannot test it).
    """

    effect: str
    rival: str
    words: str
    detectability: float = msgspec.field(name="seen")
    separation: float = msgspec.field(name="apart")
    before: float | None


class ChosenRuns(Record, frozen=True):
    """Runs chosen to tell effects apart, `kept` ones among them.

    apart, bound   least sqrt(lambda_k|j) over all pairs; no plan under the rules
                   exceeds the bound
    before         the same of the readings planned without [gap.design]
    efficiency     of the compound with D, against its bound;  proven: all plans were
                   tried
    volume         log det of the parameters' information, in tolerances
    """

    candidates: int
    retained: int = msgspec.field(name="kept")
    runs: list[ChosenRun]
    separation: float = msgspec.field(name="apart")
    bound: float
    before: float | None
    efficiency: float
    proven: bool
    share: float
    volume: float
    seconds: float
    separations: list[SeparationRecord] = msgspec.field(name="told")
    table: DetectabilityTable


class GapBeforeSection(Record, frozen=True):
    """What the planned readings could find, and the runs that [gap.design] chose."""

    table: DetectabilityTable
    units: dict[str, str]
    chosen: ChosenRuns | None
    words: list[str]


class AnswerRecord(Record, frozen=True):
    """One explanation: effects that act together (none: no gap; `unknown`: a shape that
    no known effect has).

    classes: for each effect the names that these readings cannot tell it from, itself
    among them
    unseen: part of the probability at sizes that these readings cannot show
    """

    effects: tuple[str, ...]
    probability: float
    classes: tuple[tuple[str, ...], ...] = ()
    unseen: float = 0.0

    @property
    def visible(self) -> float:
        """Probability at sizes that the readings show."""
        return self.probability - self.unseen


class PlaceRecord(Record, frozen=True):
    """A place of the gap: `leg 1`, `run ID`, `time A-B` (s), `phase A-B` (deg),
    `direction +1`, `set-up NAME`.

    p_value: posterior probability that it holds no more than an even share of the gap;
    strength: the share that it holds; same_as: a place of another kind that has the same
    readings
    """

    block: str
    p_value: float
    strength: float | None = None
    same_as: str = ""


class ClosureRecord(Record, frozen=True):
    """How far the gap shrinks on readings kept out: (s0 - s1) / (s0 - s_noise), 95 %
    interval, chance of harm.
    """

    #: value below which a figure says no more than that the gap more than doubles
    MIN_STATED: ClassVar[float] = -1.0

    split: Annotated[str, msgspec.Meta(pattern="^(within|whole)$")]
    value: float | None
    low: float | None
    high: float | None
    p_worse: float | None
    s0: float | None
    s1: float | None
    s_noise: float | None
    n: int


class EffectNote(Record, frozen=True):
    """An effect in words; `missing`: why these readings cannot test it, `column`: what
    would have to be recorded, `nature`: what it has in common with others, `check`: what
    to check where it is far larger than expected.
    """

    about: str
    remedy: str
    exposed_by: str
    source: str
    missing: str = ""
    column: str = ""
    nature: str = ""
    check: str = ""


class CoefficientRecord(Record, frozen=True):
    """A coefficient of a selected effect, in its SI unit `unit`; `prior_sd` is the size
    that was expected of it; `shape`: it only lets the form depart from the textbook's.

    Those of `corrected` are from the same estimate.
    """

    effect: str
    name: str
    label: str
    value: float
    sd: float
    unit: str
    prior_sd: float | None
    shape: bool = False


class SizeRecord(Record, frozen=True):
    """Size of a selected effect in the readings, rms by channel in its fine unit: `rms`
    as it acts, `remaining` what calibration leaves of that; detectability sqrt(lambda).
    """

    effect: str
    rms: dict[str, float]
    detectability: float | None
    remaining: dict[str, float] = {}


class Trace(Record, frozen=True):
    """One channel of one run: residual before and after, and what the effects and a
    remainder of unknown form explain of it, each as calibration leaves it, in `unit`.

    kind   circle: `at` is the angle in degrees; line: the way along it in mm; points:
           the number of the reading
    base   name of the run without its pass: both directions of a circle share it
    radius of a circle, mm
    """

    setup: str
    run: str
    base: str
    channel: str
    unit: str
    kind: Annotated[str, msgspec.Meta(pattern="^(circle|line|points)$")]
    at: list[float]
    before: list[float]
    explained: list[float]
    unexplained: list[float]
    after: list[float]
    direction: int | None = None
    payload: float | None = msgspec.field(default=None, name="payload_N")
    feed_mm_min: float | None = None
    radius_mm: float | None = None


class Spot(Record, frozen=True):
    """A place of the tool (base frame, mm) with the rms residual of its readings,
    before and after.
    """

    at: Point
    before: float
    after: float


class SecondVisitRecord(Record, frozen=True):
    """Runs to read at a second visit, which separate the answers of a diagnosis best.

    poses                of each run, a reference pose among them
    probability_now      that the likeliest set of effects is right, members of a class
                         apart
    probability_after    the same after the visit, expected
    separations          what the runs separate, in the forms and sizes as estimated
    inseparable          pairs of answers that no run of these separates further
    words                what the visit is worth, in sentences
    """

    runs: list[ChosenRun]
    poses: list[int]
    probability_now: float
    probability_after: float
    separations: list[SeparationRecord]
    inseparable: list[tuple[str, str]]
    words: list[str] = []


class GapSection(Record, frozen=True):
    """The diagnosis of one set of readings.

    verdict   none, effect, class (one of several that cannot be distinguished), mixture
              (several, or one and an unknown remainder), unknown, scatter (beyond the
              instrument, and no effect explains it)
    scatter   of readings over the stated one, or over that between readings taken again
              (`scatter_against`), with that verdict
    scatter_shape  white, along the run, `run ID` or `leg K`
    set95     the fewest sets of named effects that hold 95 % of the probability
              together, whatever is beside them
    constants  of each selected effect, SI
    selected  effects of the best answer, `unknown` aside
    rms_before, rms_after  rms residual of all readings by channel, without and with
              the selected effects, as a fit by the stated noise leaves it
    spots     rms residual by place of the tool, in `spots_unit` ("sigma": in units of
              the stated noise)
    unknown   what a remainder of unknown form is like, in words, with probabilities,
              the likeliest first
    nearest   effects that explain at least half of it, the nearest first: causes of its
              kind, none of which has its form
    left_out  effects that fit, but at sizes that are not believed: not named
    effective_laws  number of equally good noise laws that the first answer rests on
    words     one finding a sentence, the most important first
    next      what to do about it
    second_visit  readings that separate the answers; null where the first is sure
    mixture   parameters and accuracy over all hypotheses; null where no answer can be used
    """

    #: probability from which an answer, or an effect, is sure
    SURE_PROBABILITY: ClassVar[float] = 0.8
    #: probability of effects that show from which one is not excluded
    DOUBT_PROBABILITY: ClassVar[float] = 0.05
    #: members of a class, at most, that are named each
    MAX_CLASS_NAMES: ClassVar[int] = 4
    #: what the scatter of readings is compared with, where they were not taken again
    DATA_SHEET: ClassVar[str] = "data sheet"
    #: what to do where no effect is reported
    GO_AHEAD: ClassVar[str] = (
        "Nothing beyond the geometry and the noise is seen: compensate the geometry."
    )
    #: probability of an effect from which it more likely acts than not
    EVEN_PROBABILITY: ClassVar[float] = 0.5
    #: cost of a missed gap over that of one further test in vain: no gap is reported where
    #: the odds for it are larger. Of 204 healthy machines one in twenty has a gap reported
    #: (docs/benchmarks/second.md)
    MISSED_GAP_COST: ClassVar[float] = 2.5
    #: probability of no gap that shows from which none is reported: cost over cost + 1
    NO_GAP_PROBABILITY: ClassVar[float] = 2.5 / 3.5

    verdict: Annotated[
        str, msgspec.Meta(pattern="^(none|effect|class|mixture|unknown|scatter)$")
    ]
    answers: list[AnswerRecord]
    set95: list[AnswerRecord]
    where: list[PlaceRecord]
    closure: list[ClosureRecord]
    not_testable: list[str]
    confusable: list[list[str]]

    selected: list[str] = []
    tried: list[str] = []
    marginal: dict[str, float] = {}
    about: dict[str, EffectNote] = {}
    coefficients: list[CoefficientRecord] = []
    sizes: list[SizeRecord] = []
    noise: list[str] = []
    units: dict[str, str] = {}  # of each channel
    rms_before: dict[str, float] = {}
    rms_after: dict[str, float] = {}
    traces: list[Trace] = []
    spots: list[Spot] = []
    spots_unit: str = "um"
    words: list[str] = []
    next: list[str] = []
    constants: dict[str, dict[str, float]] = {}
    unknown: dict[str, float] = {}
    nearest: list[str] = []
    left_out: list[str] = []
    scatter: float | None = None
    scatter_against: str = ""
    scatter_shape: str = ""
    effective_laws: float | None = None
    second_visit: SecondVisitRecord | None = None
    mixture: MixtureSection | None = None

    @property
    def findings(self) -> list[str]:
        """Findings in sentences, what all answers expect, and what to do first."""
        sentences = list(self.words)
        if self.mixture is not None and self.mixture.prediction is not None:
            sentences += self.mixture.words[-1:]
        return [*sentences, *self.next[:1]]

    @property
    def visible_probability(self) -> float:
        """That an effect acts at a size that the readings show."""
        return sum(answer.visible for answer in self.answers if answer.effects)

    @property
    def effect_reported(self) -> bool:
        """Whether the verdict is an effect, known or not."""
        return self.verdict not in ("none", "scatter")

    @property
    def effect_likely(self) -> bool:
        """Whether an effect is reported, and more likely acts than not.

        One that is less likely is a reason to read again, and none to correct it.
        """
        return self.effect_reported and self.visible_probability > self.EVEN_PROBABILITY


def probability_of(effect: str, answers: Sequence[AnswerRecord]) -> float:
    """That an effect acts at a size that the readings show, whatever is beside it."""
    return sum(answer.visible for answer in answers if effect in answer.effects)
