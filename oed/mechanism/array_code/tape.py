"""A CasADi function as array operations on many points.

CasADi interprets its instructions point by point. For hundreds of points, the same
instructions run faster one after the other, each as a NumPy operation over all points:
the interpreter's cost is then shared by the points, and the processor's vector units
work. Alike instructions share one operation (`oed.mechanism.array_code.layout`).

Where some inputs stay the same from one evaluation to the next, as joints and
parameters do in Newton's method, what depends on them alone is evaluated once.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Any

import numpy as np

from oed.base.arrays import Array
from oed.mechanism.array_code.layout import Layout, Pack, RowBlocks
from oed.mechanism.array_code.operations import BITWISE, Call, fill_bits, make, memory
from oed.mechanism.array_code.packs import CONSTANTS, RowRun


class ArrayTape:
    """A dense SX function at `size` points, on memory of its own.

    Attributes:

    inputs   for each input, the memory (entries, size)
    outputs  for each output, the memory (entries, size), column by column of a matrix
    """

    def __init__(self, layout: Layout, size: int) -> None:
        self._layout, self._size = layout, size
        # ones: unused points of a short batch must stay clear of singular values
        self.inputs = [memory((count, size), 1.0) for count in layout.inputs]
        pairs = zip(layout.outputs, layout.doubles, strict=True)
        self.outputs = [memory((n, size), kind=_kind(double)) for n, double in pairs]
        self._blocks: list[Array] = [*self.inputs, *self.outputs]
        self._blocks += self._rows_of(layout.fixed_blocks)
        self._blocks += self._rows_of(layout.varied_blocks)
        self._views: dict[tuple[Any, ...], Any] = {}
        self._fixed = [call for pack in layout.fixed for call in self._calls_of(pack)]
        self._varied = [list(self._calls_of(pack)) for pack in layout.varied]
        self._calls = [call for calls in self._varied for call in calls]

    def calls_for(self, outputs: Collection[int]) -> list[Call]:
        """The calls that these outputs need, for `evaluate`."""
        needed = self._layout.needed(outputs)
        pairs = zip(self._layout.varied, self._varied, strict=True)
        return [
            call
            for pack, calls in pairs
            if not needed.isdisjoint(pack.nodes)
            for call in calls
        ]

    def calls_after(self, outputs: Collection[int]) -> list[Call]:
        """The calls that these outputs, the first ones, do not need.

        They follow those of `calls_for` once: they may overwrite what they take.
        """
        needed = self._layout.needed(outputs)
        pairs = zip(self._layout.varied, self._varied, strict=True)
        return [
            call
            for pack, calls in pairs
            if needed.isdisjoint(pack.nodes)
            for call in calls
        ]

    def load(self, inputs: Sequence[Array]) -> None:
        """Copy leading inputs of up to `size` points (n, entries), and `prepare`.

        Points that are left over repeat the first.
        """
        for entries, values in zip(self.inputs, inputs, strict=False):
            entries[:, : len(values)] = values.T
            entries[:, len(values) :] = values[:1].T
        self.prepare()

    def prepare(self) -> None:
        """Evaluate what depends on the inputs that do not vary, after they change."""
        make(self._fixed)

    def evaluate(self, calls: Sequence[Call] | None = None) -> None:
        """Compute `outputs` from `inputs`; all, or what `calls` write."""
        make(self._calls if calls is None else calls)

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Evaluate up to `size` points (n, entries); writes `outputs` in place."""
        self.load(inputs)
        self.evaluate()
        for values, entries in zip(outputs, self.outputs, strict=True):
            values[:] = entries[:, : len(values)].T

    # -- calls -------------------------------------------------------------------------

    def _rows_of(self, blocks: RowBlocks) -> Iterator[Array]:
        """Memory (rows, size) of each block."""
        numbers = memory((blocks.rows * self._size,), kind=_kind(double=False))
        for block in blocks.blocks:
            first = block.first * self._size
            length = block.length * self._size * (1 + block.double)
            values = numbers[first : first + length].view(_kind(block.double))
            yield values.reshape(-1, self._size)

    def _calls_of(self, pack: Pack) -> Iterator[Call]:
        """Calls that compute a pack."""
        operation, double = pack.node.operation, pack.node.double
        assert operation is not None
        for run, whole in pack.runs:
            arguments = []
            for k, step in enumerate(run.steps):
                values = self._values(run, k, step, double)
                if whole and values.ndim == 2:
                    values = values.reshape(-1)
                condition = operation is fill_bits and k == 0
                if operation in BITWISE and not condition:
                    values = values.view(np.dtype(f"i{values.itemsize}"))
                arguments.append(self._shared(values))
            yield operation, tuple(arguments)

    def _values(self, run: RowRun, k: int, step: int | None, double: bool) -> Any:
        """Numbers of the k-th rows of a run's lanes: one row or constant, or several."""
        rows = [lane.rows[k] for lane in run.lanes]
        first = rows[0]
        if first.block == CONSTANTS:
            constants = self._layout.constants(rows)
            if step is None:
                return np.array(constants, dtype=_kind(double))[:, None]
            return np.array(constants[0], dtype=_kind(double))
        block = self._blocks[first.block]
        if not step:
            return block[first.row]
        return block[first.row : first.row + step * len(rows) : step]

    def _shared(self, values: Any) -> Any:
        """The same array for the same numbers: arrays take cache as numbers do."""
        if values.ndim == 0:
            key: tuple[Any, ...] = (values.tobytes(), values.dtype)
        else:
            place, _ = values.__array_interface__["data"]
            key = (place, values.shape, values.strides, values.dtype)
        return self._views.setdefault(key, values)


def _kind(double: bool) -> Any:
    """Data type of a precision."""
    return np.dtype(np.float64 if double else np.float32)
