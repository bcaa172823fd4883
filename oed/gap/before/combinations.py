"""Combinations of an effect's coefficients, in prior standard deviations, in words."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from oed.base.linear_algebra import by_size

#: share of the mean by which coefficients that are common may differ
COMMON = 0.1
#: share of the largest below which a coefficient is not mentioned
MINOR = 0.2


def in_words(combination: Mapping[str, float]) -> str:
    """A combination of coefficients, its largest share 1, in words."""
    values = np.array(list(combination.values()))
    names = list(combination)
    if len(values) == 1:
        return names[0]
    mean = values.mean()
    if np.all(np.abs(values - mean) < COMMON * abs(mean)):
        return f"common to {', '.join(names[:-1])} and {names[-1]}"
    terms = []
    for k in by_size(values):
        if abs(values[k]) >= MINOR:
            terms.append(_term(float(values[k]), names[k]))
    return " ".join(terms).removeprefix("+ ")


def _term(value: float, name: str) -> str:
    """A term with its sign; a factor of 1 is not written."""
    sign = "-" if value < 0 else "+"
    size = f"{abs(value):.2g}"
    return f"{sign} {name}" if size == "1" else f"{sign} {size} {name}"
