"""The few readings that are wrong together: shifts of sets of up to three.

A search by one reading at a time can take the neighbours of two outliers for them, or
stop between them (masking). Leaving out the values of a set S lowers the penalised sum of
squares by g_S^T (P_SS)^-1 g_S, with P the precision of prediction and g = P r. All sets of
up to three of the most suspicious readings are compared by that, less the square of the
limit for each reading.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array, Index
from oed.checks.far_reading import LeaveOneOut

#: readings that are combined, and most in one set
CANDIDATES, MOST = 60, 3


def best_set(prediction: LeaveOneOut, removed: list[int], limit: float) -> list[int]:
    """The readings, by number, to leave out in place of `removed`."""
    if not 0 < len(removed) <= MOST:
        return removed
    values = prediction.values(removed)
    gradient = prediction.gradient[values]
    gain = float(
        gradient @ np.linalg.solve(prediction.columns(values)[values], gradient)
    )
    best, best_value = removed, gain - limit**2 * len(removed)
    for solutions in solve_sets(prediction, removed):
        gains = solutions.gain - limit**2 * solutions.sets.shape[1]
        k = int(np.argmax(gains))
        if gains[k] > best_value + 1e-9:
            best, best_value = [int(one) for one in solutions.sets[k]], float(gains[k])
    return best


@dataclasses.dataclass(frozen=True)
class SetSolutions:
    """Best shifts of the values of sets of equally many readings and values.

    sets             (S, m) numbers of readings
    values           (S, k) places of their values
    shift, sd        (S, k) best shifts and their standard deviations, SI
    gain             (S,) by which they lower the penalised sum of squares
    log_determinant  (S,) of the precision of the values
    """

    sets: Index
    values: Index
    shift: Array
    sd: Array
    gain: Array
    log_determinant: Array


def solve_sets(prediction: LeaveOneOut, members: Sequence[int]) -> list[SetSolutions]:
    """Solutions for all sets of 1 to MOST readings with equally many values each.

    They are of the readings that others predict worst, and of some members, by number.
    """
    pulls = np.abs(prediction.gradient) / np.sqrt(prediction.diagonal)
    largest = np.zeros(prediction.count)
    np.maximum.at(largest, prediction.reading, pulls)
    worst = np.argsort(-largest, kind="stable")[:CANDIDATES]
    candidates = np.union1d(worst, np.array(members, dtype=np.intp))
    places = [prediction.values([one]) for one in candidates]
    count = max(len(place) for place in places)
    whole = [k for k, place in enumerate(places) if len(place) == count]
    chosen = np.concatenate([places[k] for k in whole])
    precision = prediction.columns(chosen)[chosen]
    names = candidates[np.array(whole)]
    solutions = []
    for size in range(1, min(MOST, len(whole)) + 1):
        combined = list(itertools.combinations(range(len(whole)), size))
        sets = np.array(combined, dtype=np.intp)
        at = (count * sets[:, :, None] + np.arange(count)).reshape(len(sets), -1)
        gradient = prediction.gradient[chosen][at]
        blocks = precision[at[:, :, None], at[:, None, :]]
        inverse = np.linalg.inv(blocks)
        shift = np.einsum("sij,sj->si", inverse, gradient)
        solutions.append(
            SetSolutions(
                sets=names[sets],
                values=chosen[at],
                shift=shift,
                sd=np.sqrt(_variances(blocks, inverse)),
                gain=np.maximum(np.einsum("si,si->s", gradient, shift), 0.0),
                log_determinant=np.linalg.slogdet(blocks)[1],
            )
        )
    return solutions


def _variances(blocks: Array, inverse: Array) -> Array:
    """Diagonals (S, k) of inverses of blocks (S, k, k): 1 over the block's at least."""
    least = 1.0 / np.einsum("sii->si", blocks)
    return np.asarray(np.maximum(np.einsum("sii->si", inverse), least))
