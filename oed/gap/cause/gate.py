"""Whether a gap stands out in one place, where the evidence would have none.

The evidence shares its prior among forms; a gap that none of them has well may stand
out in one leg, run or stretch of time all the same. The scan over places tests that
without any prior. Of its p-value, corrected for all places, this much at most can be
made against no gap: its odds are divided by B = 1 / (-e p ln p) (Sellke, Bayarri,
Berger 2001).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array
from oed.gap.cause import answers
from oed.gap.cause.which import Hypothesis, Search
from oed.gap.place import locate

#: p-value below which the scan has a say
SEEN = 0.05


def weighed(
    made: Sequence[Search],
    hypotheses: Sequence[Hypothesis],
    shares: Array,
    rng: np.random.Generator,
) -> Array:
    """Probabilities (hypotheses,) from those by the evidence: changed only where these
    would have no gap told.
    """
    told, best = answers.told(answers.gathered(made, hypotheses, shares))
    if told[0].effects:
        return shares
    search = made[best.law]
    p = locate.least_p_value(search.problem, search.law_at(search.level(best)), rng)
    none = np.array([not h.effects and not h.unknown for h in hypotheses], dtype=bool)
    changed = np.where(none, shares / against_none(p), shares)
    return np.asarray(changed / changed.sum())


def against_none(p: float) -> float:
    """The most that a p-value can say against what it tests: a Bayes factor, 1 where
    the scan has no say.
    """
    if not 0.0 < p <= 1.0:
        raise ValueError(f"p-value {p}: give one above 0, at most 1")
    return 1.0 / (-math.e * p * math.log(p)) if p < SEEN else 1.0
