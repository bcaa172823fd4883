"""Gaussian elimination of many small matrices at once, one array operation a column.

Matrices lie entry by entry, each entry of all points in one row of memory, as
`oed.mechanism.array_code.tape` writes them. The order of the rows is that of partial pivoting at one
point, for all. At other points it may be a poor one: whoever takes these solutions
measures their error, as `oed.mechanism.array_code.newton` does by the steps that follow.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from oed.base.arrays import Array, Index
from oed.mechanism.array_code.operations import Call, make, memory

#: least number of rows from which one operation is faster than several
FEWEST_ROWS = 3


class Elimination:
    """Factors of `size` matrices (rows, rows), on memory of its own.

    double      whether in double precision, not single
    transposed  whether of the transposed matrices
    """

    def __init__(
        self, rows: int, size: int, double: bool = True, transposed: bool = False
    ) -> None:
        kind = np.dtype(np.float64 if double else np.float32)
        self._rows, self._transposed = rows, transposed
        self._order, self._entries = np.arange(rows), np.arange(rows * rows)
        self._factors = memory((rows * rows, size), kind=kind)
        self._solution = memory((rows, size), kind=kind)
        entries = self._factors.reshape(rows, rows, size)
        product = memory((rows, size), kind=kind)
        self._factorise = _factorisation(entries, product)
        self._substitute = _substitution(entries, self._solution, product)

    def choose_order(self, matrices: Array) -> None:
        """Take the order of rows from the first matrix; see `factorise`."""
        rows = self._rows
        places = np.arange(rows * rows).reshape(rows, rows)
        if not self._transposed:
            places = places.T
        self._order = _pivot_order(matrices[places, 0])
        self._entries = places[self._order].ravel()

    def factorise(self, matrices: Array) -> None:
        """Factors L U of matrices (rows * rows, size), each stored column by column."""
        np.take(matrices, self._entries, axis=0, out=self._factors, mode="clip")
        make(self._factorise)

    def inverse_determinants(self) -> Array:
        """One over the determinants (size,) of the factorised matrices, up to signs."""
        diagonal = self._factors[:: self._rows + 1]
        return np.asarray(np.multiply.reduce(diagonal, axis=0))

    def solve(self, right: Array) -> Array:
        """Solutions (rows, size) of the factorised matrices at right sides.

        They lie in memory that the next call overwrites.
        """
        self._solution[:] = right[self._order]
        make(self._substitute)
        solution: Array = self._solution
        return solution


def _factorisation(factors: Array, product: Array) -> list[Call]:
    """Calls that replace matrices by L below and U above; the diagonal by 1 / U's."""
    calls: list[Call] = []
    rows = range(len(factors))
    for k in rows:
        pivot = factors[k, k]
        calls.append((np.reciprocal, (pivot, pivot)))
        for i in rows[k + 1 :]:
            factor = factors[i, k]
            calls.append((np.multiply, (factor, pivot, factor)))
            row, first = factors[i, k + 1 :], factors[k, k + 1 :]
            calls += _less(row, first, factor, product)
    return calls


def _substitution(factors: Array, solution: Array, product: Array) -> list[Call]:
    """Calls that replace right sides by solutions."""
    calls: list[Call] = []
    rows = range(len(factors))
    for k in rows:
        below = slice(k + 1, None)
        calls += _less(solution[below], factors[below, k], solution[k], product)
    for k in reversed(rows):
        calls.append((np.multiply, (solution[k], factors[k, k], solution[k])))
        calls += _less(solution[:k], factors[:k, k], solution[k], product)
    return calls


def _less(entries: Array, first: Array, second: Array, product: Array) -> list[Call]:
    """Calls that subtract products from entries (m, size).

    Of first (m, size) and second (size,), with room for them.
    """
    count = len(entries)
    if count >= FEWEST_ROWS:
        groups: list[Any] = [slice(0, count)]
    else:
        groups = list(range(count))
    calls: list[Call] = []
    for rows in groups:
        calls.append((np.multiply, (first[rows], second, product[rows])))
        calls.append((np.subtract, (entries[rows], product[rows], entries[rows])))
    return calls


def _pivot_order(matrix: Array) -> Index:
    """Order of the rows of a matrix by partial pivoting; any where it has a NaN.

    Of one small matrix, Python's numbers are faster than a call of LAPACK.
    """
    rows, order = matrix.tolist(), list(range(len(matrix)))
    for k in range(len(rows)):
        best = max(range(k, len(rows)), key=lambda i: abs(rows[i][k]))
        rows[k], rows[best] = rows[best], rows[k]
        order[k], order[best] = order[best], order[k]
        first = rows[k]
        pivot = first[k] or 1.0
        for row in rows[k + 1 :]:
            factor = row[k] / pivot
            for j in range(k + 1, len(rows)):
                row[j] -= factor * first[j]
    return np.array(order)
