"""Newton's method and adjoints at many points in NumPy, digit by digit as compiled."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from oed.base import Array, Index, Mask

SHORT_STEP = 1e-4  #: step (m, rad) after which the slopes are kept
#: most steps with new slopes: the last are quadratic, so that eight reach rounding
NEWTON_STEPS = 8
CHORD_STEPS = 4  #: most steps with kept slopes, which show the error that remains
FINAL_ERROR = 1e-17  #: error (m, rad) after which a point takes no further step
REMAINING_ERROR = 1e-15  #: error (m, rad) that the last step may leave

#: values (n, k) and slopes (n, k, k) of systems at unknowns (n, k), and their numbers
Equations = Callable[[Array, Index], tuple[Array, Array]]
Values = Callable[[Array, Index], Array]  #: the values alone


class SolvedSystems(NamedTuple):
    """Solutions of n systems of equations."""

    values: Array  #: (n, k)
    solved: Mask  #: (n,) which hold
    #: (n,) which others ended with a short step: careful steps may start there
    near: Mask


class AdjointRows(NamedTuple):
    """Rows at n points."""

    values: Array  #: (n, channels, m)
    condition: Array  #: (n,) bound on the condition numbers of A


class Factors(NamedTuple):
    """Factors L U of n matrices, by elimination with each matrix's own pivots."""

    entries: Array  #: (k, k, n): L below, U above, one over U's diagonal on it
    order: Index  #: (k, n) rows of the matrix, in the order of the factors'

    def of(self, chosen: Mask) -> "Factors":
        """Those of the chosen matrices."""
        if chosen.all():
            return self
        return Factors(self.entries[:, :, chosen], self.order[:, chosen])

    def solve(self, right: Array) -> Array:
        """Solutions (k, n) at right sides (k, n)."""
        entries, n = self.entries, right.shape[1]
        solution: Array = right[self.order, np.arange(n)]
        if n == 1:
            return _solution_of_one(entries[:, :, 0].tolist(), solution[:, 0].tolist())
        for k in range(len(entries)):
            solution[k + 1 :] -= entries[k + 1 :, k] * solution[k]
        for k in reversed(range(len(entries))):
            solution[k] *= entries[k, k]
            solution[:k] -= entries[:k, k] * solution[k]
        return solution


def factors(matrices: Array) -> Factors:
    """Factors of matrices (n, k, k)."""
    n, rows, _ = matrices.shape
    if n == 1:
        return _factors_of_one(matrices[0].tolist())
    # numbers of rows in the last column, which moves with the rows
    entries = np.empty((rows, rows + 1, n))
    entries[:, :rows] = matrices.transpose(1, 2, 0)
    entries[:, rows] = np.arange(rows)[:, None]
    for k in range(rows):
        _exchange(entries, k, np.abs(entries[k:, k]).argmax(axis=0) + k)
        np.divide(1.0, entries[k, k], out=entries[k, k])
        below = entries[k + 1 :, k]
        below *= entries[k, k]
        entries[k + 1 :, k + 1 : rows] -= below[:, None] * entries[k, k + 1 : rows]
    return Factors(entries[:, :rows], entries[:, rows].astype(np.intp))


# Of one matrix, Python's own numbers are five times as fast as arrays of one entry.
def _factors_of_one(rows: list[list[float]]) -> Factors:
    order = list(range(len(rows)))
    for k in range(len(rows)):
        best = max(range(k, len(rows)), key=lambda i: abs(rows[i][k]))
        rows[k], rows[best] = rows[best], rows[k]
        order[k], order[best] = order[best], order[k]
        first, pivot = rows[k], rows[k][k]
        first[k] = 1.0 / pivot if pivot else math.copysign(math.inf, pivot)
        for row in rows[k + 1 :]:
            row[k] *= first[k]
            for j in range(k + 1, len(rows)):
                row[j] -= row[k] * first[j]
    return Factors(np.array(rows)[:, :, None], np.array(order)[:, None])


def _solution_of_one(entries: list[list[float]], x: list[float]) -> Array:
    for k, row in enumerate(entries):
        for j in range(k):
            x[k] -= row[j] * x[j]
    for k in reversed(range(len(x))):
        for j in reversed(range(k + 1, len(x))):
            x[k] -= entries[k][j] * x[j]
        x[k] *= entries[k][k]
    return np.array(x)[:, None]


def _exchange(rows: Array, k: int, best: Index) -> None:
    """Exchange row k (columns, n) with the best (n,) of each point, most often the same."""
    common = int(best[0]) if best.size else k
    if common != k:
        rows[[k, common]] = rows[[common, k]]
    others = np.flatnonzero(best != common)
    if others.size:
        displaced = rows[common, :, others]
        rows[common, :, others] = rows[k, :, others]
        rows[k, :, others] = rows[best[others], :, others]
        rows[best[others], :, others] = displaced


def solve(
    equations: Equations,
    values: Values,
    start: Array,
    step_tolerance: float,
    longest: float,
) -> SolvedSystems:
    """Solve systems of equations from a start (n, k) by Newton's method.

    Once the last step of a system is short, further steps keep its slopes (the chord
    method; Ortega and Rheinboldt 1970, section 7.1): each leaves the same share of the
    error, so that two steps s1 and s2 tell the error that remains, s2^2 / s1.

    step_tolerance  longest last step (m, rad)
    longest         longest step (m, rad) of a system that this method may solve
    """
    n = len(start)
    solutions = SolvedSystems(
        start.copy(), np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    )
    active = np.arange(n)
    with np.errstate(all="ignore"):
        for remaining in reversed(range(NEWTON_STEPS)):
            value, slope = equations(solutions.values[active], active)
            slopes = factors(slope)
            step = slopes.solve(value.T)
            size = np.abs(step).max(axis=0)
            possible = size <= longest
            goes_on = possible & (size > SHORT_STEP) & (remaining > 0)
            solutions.values[active] -= np.where(possible, step, 0.0).T
            ends = possible & ~goes_on
            if ends.any():
                last = active[ends], slopes.of(ends), size[ends]
                _chord_steps(values, last, step_tolerance, solutions)
            active = active[goes_on]
            if not active.size:
                break
    return solutions


def _chord_steps(
    values: Values,
    last: tuple[Index, Factors, Array],
    step_tolerance: float,
    solutions: SolvedSystems,
) -> None:
    """Take steps with kept slopes; what they find is written to `solutions`.

    last  systems (n,) by number, their slopes, and the sizes of their last steps
    """
    points, slopes, before = last
    for remaining in reversed(range(CHORD_STEPS)):
        step = slopes.solve(values(solutions.values[points], points).T)
        solutions.values[points] -= step.T
        size = np.abs(step).max(axis=0)
        error = np.where(size == 0.0, 0.0, size * size / before)
        is_short = size <= step_tolerance
        solutions.solved[points] = is_short & (error <= REMAINING_ERROR)
        solutions.near[points] = is_short & ~solutions.solved[points]
        moves = ~(is_short & (error <= FINAL_ERROR))
        if not (remaining and moves.any()):
            break
        points, slopes, before = points[moves], slopes.of(moves), size[moves]


def condition_bound(matrices: Array, slopes: Factors, scale: Array) -> Array:
    """Bounds (n,) on the condition numbers of matrices A (n, k, k), columns in units:
    at most |A|^k (k - 1)^(-(k - 1) / 2) / |det A|, by the Frobenius norm |A|.
    """
    k = len(scale)
    entries = (matrices * scale).transpose(2, 1, 0).reshape(k * k, -1)
    square = np.cumsum(np.square(entries), axis=0)[-1]
    volume = np.ones(len(matrices))
    for row in range(k):
        volume *= slopes.entries[row, row] / scale[row]
        volume *= np.sqrt(square)
        if row > 0:
            volume /= np.sqrt(k - 1.0)
    return np.abs(volume)


def adjoint_rows(
    matrices: Array, row: Callable[[Array], Array], right: Array, scale: Array
) -> AdjointRows:
    """Rows B^T x with A^T x = g, for matrices A (n, k, k) and right sides g.

    row    B^T x (n, m) at x (n, k)
    right  (n, channels, k)
    scale  (k,) units of A's columns, for the condition numbers
    """
    with np.errstate(all="ignore"):
        slopes = factors(matrices.transpose(0, 2, 1))
        condition = condition_bound(matrices, slopes, scale)
        rows = [
            row(slopes.solve(np.ascontiguousarray(right[:, channel].T)).T)
            for channel in range(right.shape[1])
        ]
        return AdjointRows(np.stack(rows, axis=1), condition)
