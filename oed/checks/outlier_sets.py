"""The few readings that are wrong together: the best set of up to three.

A search by one reading at a time can take the neighbours of two outliers for them, or
stop between them (masking). Leaving out the values of a set S lowers the penalised sum of
squares by g_S^T (P_SS)^-1 g_S, with P the precision of prediction and g = P r. All sets of
up to three of the most suspicious readings are compared by that, less the square of the
limit for each reading.
"""

from __future__ import annotations

import itertools

import numpy as np

from oed.arrays import Array, Index
from oed.checks.fit import LeaveOneOut

#: readings that are combined, and most in one set
CANDIDATES, MOST = 60, 3


def best_set(
    prediction: LeaveOneOut, reading: Index, removed: list[int], limit: float
) -> list[int]:
    """The readings, by number, to leave out in place of `removed`.

    reading  (N,) number of the reading that each value belongs to
    """
    if not 0 < len(removed) <= MOST:
        return removed
    candidates = _candidates(prediction, reading)
    candidates = np.union1d(candidates, np.array(removed, dtype=np.intp))
    best, best_value = removed, _value(prediction, reading, removed, limit)
    for size in range(1, MOST + 1):
        sets, values = _values(prediction, reading, candidates, size, limit)
        if not len(sets):
            continue
        k = int(np.argmax(values))
        if values[k] > best_value + 1e-9:
            best, best_value = [int(one) for one in sets[k]], float(values[k])
    return best


def _candidates(prediction: LeaveOneOut, reading: Index) -> Index:
    """The readings whose values are farthest from what all others predict."""
    pulls = np.abs(prediction.gradient) / np.sqrt(prediction.diagonal)
    largest = np.zeros(1 + int(reading[-1]))
    np.maximum.at(largest, reading, pulls)
    return np.argsort(-largest, kind="stable")[:CANDIDATES].astype(np.intp)


def _value(
    prediction: LeaveOneOut, reading: Index, members: list[int], limit: float
) -> float:
    """What leaving out some readings gains, less what they cost."""
    values = np.flatnonzero(np.isin(reading, members))
    block = prediction.columns(values)[values]
    gradient = prediction.gradient[values]
    gain = float(gradient @ np.linalg.solve(block, gradient))
    return gain - limit**2 * len(members)


def _values(
    prediction: LeaveOneOut, reading: Index, candidates: Index, size: int, limit: float
) -> tuple[Index, Array]:
    """Sets (S, size) of readings with equally many values each, and their worth (S,)."""
    places = [np.flatnonzero(reading == one) for one in candidates]
    count = max(len(place) for place in places)
    whole = [k for k, place in enumerate(places) if len(place) == count]
    chosen = np.concatenate([places[k] for k in whole])
    precision = prediction.columns(chosen)[chosen]
    gradient = prediction.gradient[chosen]
    sets = np.array(
        list(itertools.combinations(range(len(whole)), size)), dtype=np.intp
    )
    if not len(sets):
        return sets, np.empty(0)
    at = (count * sets[:, :, None] + np.arange(count)).reshape(len(sets), -1)
    blocks = precision[at[:, :, None], at[:, None, :]]
    parts = gradient[at]
    solved = np.linalg.solve(blocks, parts[..., None])[..., 0]
    gains = np.einsum("si,si->s", parts, solved)
    return candidates[np.array(whole)][sets], gains - limit**2 * size
