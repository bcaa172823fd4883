"""What a diagnosis of the gap between model and machine ends in: the `gap` section of
result.json.

Names of the first block of fields of `Gap` are fixed by the contract. Sizes and
residuals are in the fine unit of their channel. A number that is not known is null.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import msgspec

from oed.result.gap_before import ChosenRun, SeparationRecord
from oed.result.mixture import MixtureSection
from oed.result.record import Point, Record

#: closure below which a figure says no more than that the gap more than doubles
LEAST_CLOSURE = -1.0
#: probability of an effect from which it more likely acts than not
EVEN = 0.5
#: cost of a missed gap over that of one further test in vain: no gap is reported where
#: the odds for it are larger. Of 204 healthy machines one in twenty has a gap reported
#: (docs/benchmarks/second.md)
MISSED_GAP_COST = 2.5
#: probability of no gap that shows from which none is reported
NO_GAP_PROBABILITY = MISSED_GAP_COST / (MISSED_GAP_COST + 1.0)


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
    effective_laws  number of equally good noise laws that the first answer rests on
    words     one finding a sentence, the most important first
    next      what to do about it
    second_visit  readings that separate the answers; null where the first is sure
    mixture   parameters and accuracy over all answers; null where no answer can be used
    """

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
    def effect_reported(self) -> bool:
        """Whether the verdict is an effect, known or not."""
        return self.verdict not in ("none", "scatter")

    @property
    def effect_likely(self) -> bool:
        """Whether an effect is reported, and more likely acts than not.

        One that is less likely is a reason to read again, and none to correct it.
        """
        return self.effect_reported and visible_probability(self.answers) > EVEN


def visible_probability(answers: Sequence[AnswerRecord]) -> float:
    """That an effect acts at a size that the readings show."""
    return sum(answer.visible for answer in answers if answer.effects)
