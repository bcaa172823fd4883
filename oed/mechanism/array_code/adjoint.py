"""Adjoints of many small systems of equations at once, entry by entry.

With matrices A (k, k) and B (k, m) at each point, and right sides g (k,), a row is

    B^T lambda        where        A^T lambda = g.

The order of rows in which A^T is eliminated is that of one point
(`oed.mechanism.array_code.elimination`). Where it is a poor one, the residual A^T lambda - g is larger
than rounding explains, and the row is returned as inaccurate.

The singular values of A are known by their product, the determinant, and by their sum
of squares. So the condition number is at most |A|^k (k - 1)^(-(k - 1) / 2) / |det A|,
with the Frobenius norm |A|: the others than the smallest have the largest product where
they are equal.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from oed.base.arrays import Array, Mask
from oed.mechanism.array_code.elimination import Elimination
from oed.mechanism.array_code.layout import Layout
from oed.mechanism.array_code.operations import memory
from oed.mechanism.array_code.tape import ArrayTape

#: residual over the largest product of a matrix's entry and an adjoint's
ROUNDING = 1e-14


class AdjointRows(NamedTuple):
    """Rows at n points.

    values     (n, channels, m)
    condition  (n,) bound on the condition numbers of A
    accurate   (n,) which rows are as accurate as A's condition permits
    """

    values: Array
    condition: Array
    accurate: Mask

    def part(self, chunk: slice) -> AdjointRows:
        """The rows of a chunk of points, on the same memory."""
        return AdjointRows(
            self.values[chunk], self.condition[chunk], self.accurate[chunk]
        )


class ArrayAdjoint:
    """Rows at `size` points.

    layout  of an SX function of A and of the row B^T lambda, which takes lambda last
    scale   (k,) units of A's columns, for the condition number
    """

    def __init__(self, layout: Layout, size: int, scale: Array) -> None:
        rows = len(scale)
        self._tape = ArrayTape(layout, size)
        self._matrix_calls = self._tape.calls_for([0])
        self._rest_calls = self._tape.calls_after([0])
        self._row_calls = self._tape.calls_for([1])
        self._elimination = Elimination(rows, size, transposed=True)
        self._right = memory((rows, size))
        self._products = memory((rows, rows, size))
        # matrices are stored column by column
        self._weights = np.repeat(scale**2, rows)
        self._volume = (rows - 1.0) ** (-(rows - 1.0) / 2.0) / np.prod(scale)

    def run(self, inputs: Sequence[Array], right: Array, out: AdjointRows) -> None:
        """Rows at up to `size` points (n, entries), written to `out`.

        right  (n, channels, k)
        """
        tape, elimination, count = self._tape, self._elimination, len(right)
        tape.load(inputs)
        tape.evaluate(self._matrix_calls)
        matrices = tape.outputs[0]
        elimination.choose_order(matrices)
        elimination.factorise(matrices)
        out.condition[:] = self._condition()[:count]
        out.accurate[:] = True
        for channel in range(right.shape[1]):
            self._right[:, :count] = right[:, channel].T
            np.copyto(tape.inputs[-1], elimination.solve(self._right))
            out.accurate[:] &= self._is_accurate()[:count]
            # the first row's values may lie where those that it shared with A were
            tape.evaluate(self._row_calls if channel else self._rest_calls)
            out.values[:, channel] = tape.outputs[1][:, :count].T

    def _condition(self) -> Array:
        """Bounds (size,) on the condition numbers."""
        squares = self._products.reshape(len(self._weights), -1)
        with np.errstate(all="ignore"):
            np.square(self._tape.outputs[0], out=squares)
            norm = np.sqrt(self._weights @ squares) ** len(self._right)
            volume = self._volume * np.abs(self._elimination.inverse_determinants())
            return np.asarray(norm * volume)

    def _is_accurate(self) -> Mask:
        """Where the residuals (size,) are those of rounding."""
        matrices = self._tape.outputs[0].reshape(self._products.shape)
        with np.errstate(all="ignore"):
            np.multiply(matrices, self._tape.inputs[-1], out=self._products)
            residual = np.abs(self._products.sum(axis=1) - self._right).max(axis=0)
            np.abs(self._products, out=self._products)
            return np.asarray(residual <= ROUNDING * self._products.max(axis=(0, 1)))
