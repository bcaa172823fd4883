"""Many evaluations of one CasADi function at once, without copies and without a Python
loop over points.

`casadi.Function.map` runs the same instruction tape over many columns; its buffer
interface works in place on NumPy memory. Calling a function with DM matrices instead
costs three to ten times as much in conversions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from oed.arrays import Array

#: columns of the mapped tapes: large batches are cut into the first, the rest is padded
#: into the smallest that fits, by a third at the most from 4 on; a tape is made where
#: it is wanted first, in half a millisecond
CHUNK_SIZES = (
    1024,
    768,
    512,
    384,
    256,
    192,
    128,
    96,
    64,
    48,
    32,
    24,
    16,
    12,
    8,
    6,
    4,
    2,
    1,
)


class BatchedFunction:
    """Vectorised form of `inputs -> outputs`, SX matrices.

    Calling it with arrays (n, size_in) or (size_in,), one for each input, returns a
    list of arrays (n, rows, columns), or (n, rows) where an output is a column. A
    single input row is used for all n.
    """

    def __init__(
        self, name: str, inputs: Sequence[Any], outputs: Sequence[Any]
    ) -> None:
        dense = [ca.densify(ca.SX(o)) for o in outputs]
        self._function = ca.Function(name, list(inputs), dense, {"cse": True})
        self._shapes = [
            self._function.size_out(i) for i in range(self._function.n_out())
        ]
        self._tapes: dict[int, _Tape] = {}

    def __call__(self, *arrays: Array) -> list[Array]:
        n = max([a.shape[0] for a in arrays if a.ndim == 2], default=1)
        flat = [
            (
                a
                if a.ndim == 2 and a.shape[0] == n
                else np.broadcast_to(a, (n, a.shape[-1]))
            )
            for a in arrays
        ]
        results = [np.empty((n, rows * columns)) for rows, columns in self._shapes]
        start = 0
        while start < n:
            size = min(
                (c for c in CHUNK_SIZES if c >= n - start), default=CHUNK_SIZES[0]
            )
            part = slice(start, min(start + size, n))
            self._tape(size).run([a[part] for a in flat], [r[part] for r in results])
            start += size
        return [
            r if columns == 1 else r.reshape(n, columns, rows).transpose(0, 2, 1)
            for r, (rows, columns) in zip(results, self._shapes, strict=True)
        ]

    def _tape(self, size: int) -> _Tape:
        if size not in self._tapes:
            self._tapes[size] = _Tape(self._function, size)
        return self._tapes[size]


class _Tape:
    """One mapped function on memory of its own, which CasADi keeps pointers to."""

    def __init__(self, function: Any, size: int) -> None:
        self._buffer, self._evaluate = function.map(size).buffer()
        # ones, not zeros: columns that a short batch leaves unused must stay clear of
        # singular values
        self._inputs = [
            np.ones((size, function.numel_in(i))) for i in range(function.n_in())
        ]
        self._outputs = [
            np.zeros((size, function.numel_out(i))) for i in range(function.n_out())
        ]
        for setter, memory in (
            (self._buffer.set_arg, self._inputs),
            (self._buffer.set_res, self._outputs),
        ):
            for i, array in enumerate(memory):
                if array.size:
                    setter(i, memoryview(array.reshape(-1).data))

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Evaluate up to `size` rows; `outputs` are written in place."""
        for memory, array in zip(self._inputs, inputs, strict=True):
            memory[: len(array)] = array
        self._evaluate()
        for array, memory in zip(outputs, self._outputs, strict=True):
            array[:] = memory[: len(array)]
