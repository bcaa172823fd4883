"""The best of all plans, for criteria of extreme eigenvalues and few enough plans.

These criteria are not smooth: exchanges end in local optima, and bounds by relaxation
leave a share open. Where there are few plans, all of them cost less than the search, and
the best one is proven.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

from oed.base import Array, Index
from oed.design.forms import Criterion, ExtremeEigenvalues
from oed.design.rules import Rules

#: plans that are looked at, at most
MOST_PLANS = 100_000
#: numbers in the matrices that are in memory at once
PART = 1_000_000
#: plans whose log phi differs by less are equally good: the first one is taken
EQUAL = 1e-10


def best_of_all(
    blocks: Array, criterion: Criterion, base: Array, rules: Rules
) -> Index | None:
    """The best plan for blocks (C, k, n) and prior information (n, n).

    None where the criterion is another one, rules beyond a number of candidates hold, or
    there are too many plans.
    """
    size = rules.sole_size
    if size is None or not isinstance(criterion, ExtremeEigenvalues):
        return None
    if math.comb(len(blocks), size) > MOST_PLANS:
        return None
    products = blocks.transpose(0, 2, 1) @ blocks
    best, chosen = -np.inf, None
    for plans in _plans(len(blocks), size, max(PART // products[0].size, 1)):
        matrices = np.broadcast_to(base, (len(plans), *base.shape)).copy()
        for place in range(size):
            matrices += products[plans[:, place]]
        eigenvalues = np.asarray(np.linalg.eigvalsh(matrices), dtype=float)
        values = criterion.of_eigenvalues(eigenvalues)
        if values.max() > best + EQUAL:
            best = float(values.max())
            chosen = plans[np.flatnonzero(values >= best - EQUAL)[0]]
    return chosen


def _plans(count: int, size: int, part: int) -> Iterator[Index]:
    """All plans (m, size) of so many candidates, some at a time."""
    plans = itertools.combinations(range(count), size)
    while some := list(itertools.islice(plans, part)):
        yield np.array(some, dtype=np.intp)
