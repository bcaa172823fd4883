"""What a diagnosis says: the verdict, its answers with probabilities, where, how far,
and what to do next.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Literal

from oed.arrays import Array
from oed.gap.data.problem import GapProblem
from oed.noise.law import NoiseLaw

Verdict = Literal["none", "effect", "class", "mixture", "unknown"]
UNKNOWN = "unknown"


@dataclasses.dataclass(frozen=True, slots=True)
class Answer:
    """One explanation: effects acting together (none: no gap; `unknown` for a shape no
    effect has), its probability.

    classes  for each effect the names that these readings cannot tell it from, itself
             among them
    """

    effects: tuple[str, ...]
    probability: float
    classes: tuple[tuple[str, ...], ...] = ()


@dataclasses.dataclass(frozen=True, slots=True)
class Coefficient:
    """A coefficient of a selected effect: posterior mean and standard deviation in its
    own unit.
    """

    effect: str
    name: str
    label: str
    mean: float
    sd: float


@dataclasses.dataclass(frozen=True, slots=True)
class Size:
    """How large an effect is in these readings: root mean square, SI, by channel;
    before and after what the geometry absorbs (in units of the noise: detectability
    sqrt(lambda)).
    """

    effect: str
    rms: Mapping[str, float]
    detectability: float


@dataclasses.dataclass(frozen=True, slots=True)
class Block:
    """Where a gap lies: `leg K` from 1, `run ID`, `time A-B` in s, `phase A-B` in deg,
    `direction +1`; corrected p.
    """

    block: str
    p_value: float
    strength: float = 0.0  # share of the gap's energy that the block holds


@dataclasses.dataclass(frozen=True, slots=True)
class Closure:
    """How far the gap shrinks on held-out readings: C = (S0 - S1) / (S0 - Snoise), 95 %
    interval, chance of harm.

    S: mean squared residual, standardised by its predictive covariance. `n` readings
    were held out.
    """

    split: Literal["within", "whole"]
    value: float
    low: float
    high: float
    p_worse: float
    s0: float
    s1: float
    s_noise: float
    n: int


@dataclasses.dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """A diagnosis of one set of readings.

    verdict        none, effect, class (which of several cannot be told), mixture (an
                   effect and an unknown remainder, or several effects), unknown
    answers        by probability, none first only where it is sure, see `answers`
    set95          the fewest sets of named effects that together have 95 %, see
                   `answers`
    marginal       {effect: probability that it acts}
    law            noise as estimated;  noise_words: the same in words
    constants      {effect: its constants' values in the form that suits the readings
                   best}
    coefficients, sizes   of the selected effects
    explained      (N,) part of the residual that the selected effects explain, SI
    unexplained    (N,) part that an unknown remainder explains, SI
    likeness       {what the unknown remainder is like, in words: probability}, the
                   likeliest first; empty without one
    before, after  (N,) residuals of the calibration without and with the selected
                   effects, SI
    where, closure, not_testable {effect: why}, confusable (groups of names), next
    (sentences)
    """

    problem: GapProblem
    verdict: Verdict
    answers: tuple[Answer, ...]
    set95: tuple[Answer, ...]
    marginal: Mapping[str, float]
    law: NoiseLaw
    noise_words: tuple[str, ...]
    constants: Mapping[str, Mapping[str, float]]
    coefficients: tuple[Coefficient, ...]
    sizes: tuple[Size, ...]
    explained: Array
    unexplained: Array
    likeness: Mapping[str, float]
    before: Array
    after: Array
    where: tuple[Block, ...]
    closure: tuple[Closure, ...]
    not_testable: Mapping[str, str]
    confusable: tuple[tuple[str, ...], ...]
    next: tuple[str, ...]
