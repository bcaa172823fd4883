"""Comparison of hypotheses from searches under several noise laws, and probabilities.

The noise law is a nuisance: every set of effects gets the one of several laws that
suits it best.

An effect rarely has its textbook form. Where it carries most of the gap and an unknown
remainder the rest, it is likelier that it acts in another form than that something
unknown looks like it. An unknown alone is therefore weighed against the best effect
with a remainder by the share of the gap that this effect carries. Nor is a second
effect that explains next to nothing with the first in the model as likely as another.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.arrays import Array
from oed.gap.cause.hypothesis import Hypothesis, Key
from oed.gap.cause.search import Search

#: log odds of an effect with an unknown remainder: slope and even point in its share of
#: the gap, and their bound
SLOPE, EVEN, STEEPEST = 8.0, 0.4, 6.0
#: share of what a set of effects explains below which the least of them may be part of
#: the others' real form, and log odds by which the set is less likely where that effect
#: explains nothing
LITTLE, MINOR = 0.1, 2.0
#: power of the evidence among explanations of a gap: their forms are models all, and
#: none of them quite true (a learning rate as of Gruenwald and van Ommen 2017, Bayesian
#: Anal. 12, 1069-1103)
RATE = 0.9


def compare(searches: Sequence[Search]) -> list[Hypothesis]:
    """Hypotheses under the law that suits each best, by log posterior, best first."""
    best: dict[Key, Hypothesis] = {}
    for number, search in enumerate(searches):
        for h in search.run():
            h = dataclasses.replace(h, law=number)
            h = _adjust_for_least_effect(_adjust_for_remainder(h))
            if h.key not in best or best[h.key].score < h.score:
                best[h.key] = h
    alone: Key = (frozenset(), True)
    mixed = [h for h in best.values() if h.unknown and h.effects]
    if mixed and alone in best:
        rival = max(mixed, key=lambda h: h.score)
        log_odds = max(_log_odds(rival.share), 0.0)
        unknown = best[alone]
        log_prior = unknown.log_prior - log_odds
        best[alone] = dataclasses.replace(unknown, log_prior=log_prior)
    return sorted(best.values(), key=lambda h: -h.score)


def probabilities(hypotheses: Sequence[Hypothesis]) -> Array:
    """Posterior probabilities of hypotheses.

    That of a gap is by the scores; among its causes the scores count a little less.
    """
    scores = np.array([h.score for h in hypotheses])
    gap = np.array([h.is_gap for h in hypotheses], dtype=bool)
    if gap.any():
        flat = RATE * scores[gap]
        total = special.logsumexp(scores[gap])
        scores[gap] = flat - special.logsumexp(flat) + total
    return np.asarray(special.softmax(scores))


def _log_odds(share: float) -> float:
    """Log odds that an effect acts, from its share of what the readings hold.

    The share is of what they hold beyond noise. Known effects in adapted forms keep
    most of it; a rival of an unknown effect gets little by chance.
    """
    return float(np.clip(SLOPE * (share - EVEN), -STEEPEST, STEEPEST))


def _adjust_for_remainder(h: Hypothesis) -> Hypothesis:
    """Lower the prior of effects that carry little of a gap with an unknown remainder."""
    if not h.unknown or not h.effects:
        return h
    log_prior = h.log_prior + min(_log_odds(h.share), 0.0)
    return dataclasses.replace(h, log_prior=log_prior)


def _adjust_for_least_effect(h: Hypothesis) -> Hypothesis:
    """Lower the prior of sets of which one effect explains next to nothing.

    What it explains is more likely part of the others' real form.
    """
    lack = max(1.0 - h.least_share / LITTLE, 0.0)
    return dataclasses.replace(h, log_prior=h.log_prior - MINOR * lack)
