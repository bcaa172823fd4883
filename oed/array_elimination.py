"""Gaussian elimination of many small matrices at once, one array operation a column.

Matrices lie entry by entry, each entry of all points in one row of memory, as
`oed.array_tape` writes them. The order of the rows is that of partial pivoting at one
point, for all. At other points it may be a poor one: whoever takes these solutions
measures their error, as `oed.array_newton` does by the steps that follow.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from oed.array_operations import Call, make, memory
from oed.arrays import Array


class Elimination:
    """Factors of `size` matrices (rows, rows), on memory of its own."""

    def __init__(self, rows: int, size: int) -> None:
        self._rows = rows
        self._order, self._entries = np.arange(rows), np.arange(rows * rows)
        self._factors = memory((rows * rows, size))
        self._solution = memory((rows, size))
        entries = self._factors.reshape(rows, rows, size)
        product = memory((size,))
        self._factorise = _factorisation(entries, product)
        self._substitute = _substitution(entries, self._solution, product)

    def choose_order(self, matrices: Array) -> None:
        """Take the order of rows from the first matrix; see `factorise`."""
        rows = self._rows
        self._order = _pivot_order(matrices[:, 0].reshape(rows, rows).T)
        self._entries = (self._order[:, None] + rows * np.arange(rows)).ravel()

    def factorise(self, matrices: Array) -> None:
        """Factors L U of matrices (rows * rows, size), each stored column by column."""
        np.take(matrices, self._entries, axis=0, out=self._factors, mode="clip")
        make(self._factorise)

    def solve(self, right: Array) -> Array:
        """Solutions (rows, size) of the factorised matrices at right sides.

        They lie in memory that the next call overwrites.
        """
        np.take(right, self._order, axis=0, out=self._solution, mode="clip")
        make(self._substitute)
        return self._solution


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
            for j in rows[k + 1 :]:
                calls += _less(factors[i, j], factor, factors[k, j], product)
    return calls


def _substitution(factors: Array, solution: Array, product: Array) -> list[Call]:
    """Calls that replace right sides by solutions."""
    calls: list[Call] = []
    rows = range(len(factors))
    for i in rows:
        for k in rows[:i]:
            calls += _less(solution[i], factors[i, k], solution[k], product)
    for i in reversed(rows):
        for k in rows[i + 1 :]:
            calls += _less(solution[i], factors[i, k], solution[k], product)
        calls.append((np.multiply, (solution[i], factors[i, i], solution[i])))
    return calls


def _less(entry: Array, first: Array, second: Array, product: Array) -> list[Call]:
    """Calls that subtract a product from an entry."""
    subtraction = (np.subtract, (entry, product, entry))
    return [(np.multiply, (first, second, product)), subtraction]


def _pivot_order(matrix: Array) -> Any:
    """Order of the rows of a matrix by partial pivoting; any where it has a NaN."""
    rest, order = matrix.copy(), np.arange(len(matrix))
    for k in range(len(matrix) - 1):
        best = k + int(np.argmax(np.abs(rest[k:, k])))
        rest[[k, best]], order[[k, best]] = rest[[best, k]], order[[best, k]]
        pivot = rest[k, k] or 1.0
        rest[k + 1 :, k:] -= np.outer(rest[k + 1 :, k] / pivot, rest[k, k:])
    return order
