"""Comparison of hypotheses: evidence over noise laws, and posterior probabilities.

The noise law is a nuisance: the evidence of a set of effects is the sum over laws that
stand for all (`oed.gap.data.laws`). Priors are fixed beforehand (`hypothesis.PRIOR`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.base.arrays import Array
from oed.gap.cause.hypothesis import Hypothesis, Key
from oed.gap.cause.search import Search


def compare(searches: Sequence[Search]) -> list[Hypothesis]:
    """Hypotheses with their evidence over all laws, by log posterior, best first."""
    by_key: dict[Key, list[Hypothesis]] = {}
    for number, search in enumerate(searches):
        for h in search.run():
            by_key.setdefault(h.key, []).append(dataclasses.replace(h, law=number))
    hypotheses = [_over_laws(alike) for alike in by_key.values()]
    return sorted(hypotheses, key=lambda h: -h.score)


def _over_laws(alike: Sequence[Hypothesis]) -> Hypothesis:
    """One hypothesis under several laws, in the form and law that suit it best.

    Its evidence is over all of them.
    """
    best = max(alike, key=lambda h: h.log_evidence)
    total = special.logsumexp([h.log_evidence for h in alike])
    return dataclasses.replace(best, log_evidence=float(total))


def probabilities(hypotheses: Sequence[Hypothesis]) -> Array:
    """Posterior probabilities of hypotheses."""
    return np.asarray(special.softmax([h.score for h in hypotheses]))
