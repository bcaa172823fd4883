"""A CasADi function at many points: instruction by instruction, or point by point.

What NumPy would round differently (sines and other functions of the C library) runs in
CasADi's interpreter in both ways, so that a point's digits are the same.
"""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import casadi as ca
import numpy as np

from oed.base import Array
from oed.mechanism.graph import OPERATIONS

#: numbers of points for which the interpreter is prepared, in half a millisecond each
CHUNK_SIZES = (256, 32, 4, 1)
#: points of a NumPy operation; of the largest, rows still fit into the processor's cache
TAPE_SIZES = (256, 384, 512, 768, 1024, 1536, 2048)
#: points at which the interpreter does an operation of the C library together
LIBRARY_POINTS = 256
#: instructions that compute nothing
MOVES = frozenset({ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST})


class Interpreter:
    """A function in CasADi's interpreter, on memory that it keeps pointers to.

    Its buffer interface works in place on NumPy memory: calls with DM matrices would
    spend three to ten times as long on conversions.
    """

    def __init__(self, function: Any) -> None:
        self._function = function
        self._mapped: dict[int, _Mapped] = {}

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Evaluate at points (n, entries); writes `outputs` in place."""
        for size, chunk in _chunks(len(outputs[0])):
            if size not in self._mapped:
                self._mapped[size] = _Mapped(self._function, size)
            mapped = self._mapped[size]
            for memory, values in zip(mapped.inputs, inputs, strict=True):
                memory[:] = values[chunk]
            mapped.evaluate()
            for values, memory in zip(outputs, mapped.outputs, strict=True):
                values[chunk] = memory


class _Mapped:
    """A function mapped to `size` points, on memory that CasADi keeps pointers to."""

    def __init__(self, function: Any, size: int) -> None:
        inputs, outputs = range(function.n_in()), range(function.n_out())
        self._buffer, self.evaluate = function.map(size).buffer()
        self.inputs = [np.ones((size, function.numel_in(i))) for i in inputs]
        self.outputs = [np.zeros((size, function.numel_out(i))) for i in outputs]
        _attach(self._buffer.set_arg, self.inputs)
        _attach(self._buffer.set_res, self.outputs)


def _chunks(n: int) -> Iterator[tuple[int, slice]]:
    """Chunks of n points, each with its size."""
    start = 0
    for size in CHUNK_SIZES:
        while n - start >= size:
            yield size, slice(start, start + size)
            start += size


def _attach(setter: Any, arrays: Sequence[Array]) -> None:
    for i, array in enumerate(arrays):
        if array.size:
            setter(i, memoryview(array.reshape(-1).data))


class ArrayTape:
    """A function's instructions as NumPy operations over all points.

    `is_known` tells whether every instruction is in the table of operations.
    """

    def __init__(self, function: Any) -> None:
        self._function = function
        self._arrays: dict[int, _Arrays] = {}
        codes = {function.instruction_id(k) for k in range(function.n_instructions())}
        self.is_known = codes <= OPERATIONS.keys() | MOVES

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Evaluate at points (n, entries); writes `outputs` in place."""
        n = len(outputs[0])
        start = 0
        while start < n:
            size = next((s for s in TAPE_SIZES if s >= n - start), TAPE_SIZES[-1])
            if size not in self._arrays:
                self._arrays[size] = _Arrays(self._function, size)
            chunk = slice(start, start + size)
            self._arrays[size].run(
                [a[chunk] for a in inputs], [a[chunk] for a in outputs]
            )
            start += size


class _Arrays:
    """The operations of a function at `size` points, on memory of their own."""

    def __init__(self, function: Any, size: int) -> None:
        # ones: unused points of a short batch must stay clear of slow numbers
        inputs = [function.numel_in(i) for i in range(function.n_in())]
        outputs = [function.numel_out(i) for i in range(function.n_out())]
        self._inputs = [np.ones((entries, size)) for entries in inputs]
        self._outputs = [np.empty((entries, size)) for entries in outputs]
        rows = np.empty((function.sz_w(), size))
        #: what each register holds: a row, an input's entry, or a constant
        values: list[Any] = list(rows)
        self._calls: list[tuple[Callable[..., Any], tuple[Any, ...]]] = []
        for k in range(function.n_instructions()):
            code = function.instruction_id(k)
            sources = function.instruction_input(k)
            targets = function.instruction_output(k)
            if code == ca.OP_INPUT:
                values[targets[0]] = self._inputs[sources[0]][sources[1]]
            elif code == ca.OP_CONST:
                values[targets[0]] = function.instruction_constant(k)
            elif code == ca.OP_OUTPUT:
                entry = self._outputs[targets[0]][targets[1]]
                self._calls.append((np.positive, (values[sources[0]], entry)))
            else:
                arguments = [values[source] for source in sources]
                operation = OPERATIONS[code].array or _library_operation(
                    code, len(sources)
                )
                row = values[targets[0]] = rows[targets[0]]
                self._calls.append((operation, (*arguments, row)))

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        for entries, values in zip(self._inputs, inputs, strict=True):
            entries[:, : len(values)] = values.T
        with np.errstate(all="ignore"):
            for operation, arguments in self._calls:
                operation(*arguments)
        for values, entries in zip(outputs, self._outputs, strict=True):
            values[:] = entries[:, : len(values)].T


@functools.cache
def _library_operation(code: int, count: int) -> Callable[..., None]:
    """An operation on so many numbers, in the interpreter; writes its last argument."""
    symbols = [ca.SX.sym(f"x{k}", LIBRARY_POINTS) for k in range(count)]
    build = ca.SX.unary if count == 1 else ca.SX.binary
    mapped = _Mapped(ca.Function("f", symbols, [build(code, *symbols)]), 1)

    def operate(*arguments: Array) -> None:
        *sources, out = arguments
        for start in range(0, len(out), LIBRARY_POINTS):
            part = out[start : start + LIBRARY_POINTS]
            for memory, values in zip(mapped.inputs, sources, strict=True):
                is_row = np.ndim(values) == 1
                memory[0, : len(part)] = (
                    values[start : start + len(part)] if is_row else values
                )
            mapped.evaluate()
            part[:] = mapped.outputs[0][0, : len(part)]

    return operate
