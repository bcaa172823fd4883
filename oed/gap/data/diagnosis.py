"""Types of a diagnosis: verdict, answers with probabilities, places, closure, advice."""

import dataclasses
from collections.abc import Mapping
from typing import Literal

from oed.base import Array
from oed.gap.data.problem import GapProblem, Metric
from oed.noise import NoiseLaw
from oed.result import (
    UNKNOWN,
    AnswerRecord,
    ClosureRecord,
    CoefficientRecord,
    PlaceRecord,
)

Verdict = Literal["none", "effect", "class", "mixture", "unknown", "scatter"]
#: verdicts without an effect: noise as stated, and more scatter than the instrument has
NO_EFFECT: tuple[Verdict, ...] = ("none", "scatter")
#: what the scatter of readings is compared with, where they were taken again
ON_THE_SPOT = "repeats on the spot"
AGAIN = "repeated runs"


@dataclasses.dataclass(frozen=True, slots=True)
class ExcessScatter:
    """Scatter of readings beyond their instrument."""

    factor: float  #: scatter over that of the reference
    against: str  #: the reference: the data sheet, or readings taken again
    shape: str  #: `white`, `along the run`, `run NAME` or `leg K`


@dataclasses.dataclass(frozen=True, slots=True)
class Size:
    """How large an effect is in these readings."""

    effect: str  #: name of the effect
    #: {channel: root mean square, SI}, before the geometry absorbs
    rms: Mapping[str, float]
    #: {channel: root mean square, SI} of what calibration leaves of it
    remaining: Mapping[str, float]
    #: sqrt(lambda), in units of the noise, after the geometry absorbs
    detectability: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class Explained:
    """What the effects of an answer explain of the residual."""

    #: {effect: its constants in the form that suits the readings best}
    constants: Mapping[str, Mapping[str, float]]
    coefficients: tuple[CoefficientRecord, ...]  #: of the selected effects
    sizes: tuple[Size, ...]  #: of the selected effects
    explained: Array  #: (N,) part of the residual that the selected effects explain, SI
    unexplained: Array  #: (N,) part that what else the answer has explains, SI
    #: (N,) residuals of the calibration without and with the selected effects, SI, both
    #: fitted by the stated noise, as an identification leaves them
    before: Array
    after: Array


@dataclasses.dataclass(frozen=True, slots=True)
class AnswerContent:
    """What acts by an answer, in the form that suits the readings best."""

    constants: Mapping[str, Mapping[str, float]]  #: {effect: its constants}
    unknown: bool  #: whether something of no known form acts as well


@dataclasses.dataclass(frozen=True, kw_only=True)
class Diagnosis(Explained):
    """A diagnosis of one set of readings."""

    problem: GapProblem  #: the residuals that it is of
    #: none, effect, class (several that are indistinguishable), mixture (several
    #: effects, or one and an unknown remainder), unknown
    verdict: Verdict
    answers: tuple[AnswerRecord, ...]  #: the decision first, the others by probability
    set95: tuple[AnswerRecord, ...]  #: the 95 % credible set of effects
    marginal: Mapping[str, float]  #: {effect: probability that it acts}
    law: NoiseLaw  #: noise law as estimated
    noise_words: tuple[str, ...]  #: the same in words
    #: {form of the unknown remainder in words: probability}, the likeliest first; empty
    #: without a remainder
    likeness: Mapping[str, float]
    #: effects whose form comes nearest to the unknown remainder's
    nearest: tuple[str, ...]
    where: tuple[PlaceRecord, ...]  #: blocks in which the gap lies
    closure: tuple[ClosureRecord, ...]  #: how far it shrinks on held-out readings
    not_testable: Mapping[str, str]  #: {effect: why these readings cannot test it}
    #: groups of effects that these readings cannot distinguish
    confusable: tuple[tuple[str, ...], ...]
    next: tuple[str, ...]  #: advice, in sentences
    contents: tuple[AnswerContent, ...]  #: what acts by each of the answers
    #: of readings, where that is more than the instrument has and nothing explains it;
    #: None otherwise
    scatter: ExcessScatter | None = None
    #: number of equally good noise laws that the evidence of the answer rests on; None
    #: under a known law
    effective_laws: float | None = None
    #: the problem without outliers; None where it was not searched
    clean: GapProblem | None = None
    #: {(effects, whether an unknown acts): probability}
    shares: Mapping[tuple[frozenset[str], bool], float] = dataclasses.field(
        default_factory=dict
    )
    #: effects that fit at a size that no machine has alone
    left_out: tuple[str, ...] = ()

    @property
    def selected(self) -> tuple[str, ...]:
        """Named effects of the best answer; none where no effect is reported."""
        if self.verdict in NO_EFFECT or not self.answers:
            return ()
        return tuple(name for name in self.answers[0].effects if name != UNKNOWN)

    def after_calibration(self, change: Array) -> Array:
        """What remains of a change (N,) of the readings, SI, after fitting parameters."""
        problem = self.problem
        stated = Metric(problem, problem.stated_law)
        return stated.fit_remainder(problem.noise_units(change)) * problem.sigma
