"""One CasADi function over many points at once, without copies or a Python loop.

Batches of hundreds of points run as array operations (`oed.mechanism.array_code.tape`), smaller ones
in CasADi's interpreter. A function that has much to do is compiled, where this computer has
a compiler, and then runs so at all sizes (`oed.mechanism.compiled`).

`casadi.Function.map` runs one instruction tape over many columns, and its buffer
interface works in place on NumPy memory. Calls with DM matrices would spend three to
ten times as long on conversions.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import casadi as ca
import numpy as np

from oed.base.arrays import Array
from oed.mechanism.array_code.adjoint import AdjointRows, ArrayAdjoint
from oed.mechanism.array_code.layout import Layout
from oed.mechanism.array_code.newton import ArrayNewton, SolvedSystems
from oed.mechanism.array_code.operations import is_supported
from oed.mechanism.array_code.tape import ArrayTape
from oed.mechanism.compiled.lanes import Adjoint, Evaluation, Newton, compiled
from oed.mechanism.compiled.switch import CompileSwitch
from oed.mechanism.compiled.text import LaneJob

#: Numbers of points for which a mapped function is compiled, each on first use, in half
#: a millisecond. Batches are cut into the largest; what remains is padded to the next
#: larger number, where that takes few points, and cut again otherwise.
CHUNK_SIZES = (
    *(2048, 1536, 1024, 768, 512, 384, 256, 192, 128, 96, 64),
    *(48, 32, 24, 16, 12, 8, 6, 4, 2, 1),
)
#: most points that padding may add: they take as long as another call does, of CasADi's
#: interpreter and of array operations
SPARE, ARRAY_SPARE = 4, 256
#: number of points from which array operations are faster than CasADi's interpreter
ARRAY_SIZE = 192


class BatchedFunction:
    """Vectorised function from SX inputs to SX outputs.

    inputs   vectors of the expression graph
    outputs  matrices or columns that depend on them
    """

    def __init__(
        self, name: str, inputs: Sequence[Any], outputs: Sequence[Any]
    ) -> None:
        self._definition = name, list(inputs), [ca.SX(output) for output in outputs]
        self._shapes = [output.shape for output in self._definition[2]]
        self._mapped: dict[int, _MappedFunction | ArrayTape] = {}
        self._layouts: dict[str, Layout] = {}
        self._newton: dict[int, ArrayNewton] = {}
        self._adjoints: dict[int, ArrayAdjoint] = {}
        self._switch = CompileSwitch()
        self._compiled: dict[type, Any] = {}

    def __call__(self, *arrays: Array) -> list[Array]:
        """Evaluate at n points: arrays (n, size) or (size,), one for each input.

        A single point of one input goes with all n of the others. Returns one array
        for each output: (n, rows) for a column, (n, rows, columns) for a matrix.
        """
        n = max([a.shape[0] for a in arrays if a.ndim == 2], default=1)
        inputs = [_repeated(a, n) for a in arrays]
        evaluation = self._compiled_job(Evaluation, n, lambda _: Evaluation.job)
        if evaluation is not None:
            outputs = evaluation.run(inputs, n)
        else:
            outputs = [np.empty((n, rows * columns)) for rows, columns in self._shapes]
            for size, chunk in _chunks(n):
                function = self._mapped_to(size)
                function.run([a[chunk] for a in inputs], [a[chunk] for a in outputs])
        return [_shaped(a, *s) for a, s in zip(outputs, self._shapes, strict=True)]

    def compiled_newton(
        self, n: int, unknown: int, angles: Sequence[int] = ()
    ) -> Newton | None:
        """Newton's method as `solve` has it, compiled; None while it is not worth it.

        n  number of points that it would solve now
        """
        newton: Newton | None = self._compiled_job(
            Newton, n, lambda function: Newton.job(function, unknown, angles)
        )
        return newton

    def solve(
        self,
        inputs: Sequence[Array],
        unknown: int,
        step_tolerance: float,
        longest: float,
        angles: Sequence[int] = (),
    ) -> SolvedSystems:
        """Solve value = 0 at n points by Newton's method, where the batch is large.

        The outputs are value (k,) and slope (k, k) over the first `unknown` inputs,
        which start the iteration. See `ArrayNewton` for `angles` and the limits. In
        small batches nothing is solved.
        """
        values = [np.array(a, dtype=float) for a in inputs[:unknown]]
        n = len(values[0])
        solutions = SolvedSystems(
            values, np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
        )
        if n < ARRAY_SIZE or not self._is_supported:
            return solutions
        layout = self._layout("newton", lambda f: ArrayNewton.layout(f, unknown))
        for size, chunk in _chunks(n):
            if size not in self._newton:
                self._newton[size] = ArrayNewton(layout, size, angles)
            at = [a[chunk] for a in inputs]
            part = self._newton[size].solve(at, step_tolerance, longest)
            solutions.solved[chunk], solutions.near[chunk] = part.solved, part.near
            for every, some in zip(values, part.values, strict=True):
                every[chunk] = some
        return solutions

    def pull_back(
        self, inputs: Sequence[Array], right: Array, scale: Array
    ) -> AdjointRows:
        """Rows at n points by adjoints, where the batch is large; see `ArrayAdjoint`.

        The outputs are a matrix (k, k), and a row that is linear in the last input
        (k,); `inputs` are the others. In small batches no row is accurate.

        right  (n, channels, k) right sides
        scale  (k,) units of the matrix's columns
        """
        n, channels, _ = right.shape
        adjoint = self._compiled_job(Adjoint, n, Adjoint.job)
        if adjoint is not None:
            compiled_rows: AdjointRows = adjoint.run(inputs, right, scale)
            return compiled_rows
        rows = AdjointRows(
            values=np.empty((n, channels, self._shapes[1][1])),
            condition=np.full(n, np.inf),
            accurate=np.zeros(n, dtype=bool),
        )
        if n < ARRAY_SIZE or not self._is_supported:
            return rows
        for size, chunk in _chunks(n):
            if size not in self._adjoints:
                self._adjoints[size] = ArrayAdjoint(
                    self._layout("all", Layout), size, scale
                )
            at = [a[chunk] for a in inputs]
            self._adjoints[size].run(at, right[chunk], rows.part(chunk))
        return rows

    @functools.cached_property
    def _function(self) -> Any:
        """Compiled on first use: many are never called."""
        name, inputs, outputs = self._definition
        dense = [ca.densify(output) for output in outputs]
        return ca.Function(name, inputs, dense, {"cse": True})

    @functools.cached_property
    def _is_supported(self) -> bool:
        return is_supported(self._function)

    def _compiled_job(
        self, kind: Any, points: int, job: Callable[[Any], LaneJob]
    ) -> Any | None:
        """A job on this function, compiled; None while, or where, that is not to be."""
        if not self._switch.is_on(points, self._length):
            return None
        if kind not in self._compiled:
            possible = self._is_supported
            function = self._function
            self._compiled[kind] = (
                compiled(kind, function, job(function)) if possible else None
            )
        return self._compiled[kind]

    @functools.cached_property
    def _length(self) -> int:
        """Number of instructions."""
        length: int = self._function.n_instructions()
        return length

    def _layout(self, kind: str, build: Callable[[Any], Layout]) -> Layout:
        """A layout, which serves all sizes."""
        if kind not in self._layouts:
            self._layouts[kind] = build(self._function)
        return self._layouts[kind]

    def _mapped_to(self, size: int) -> _MappedFunction | ArrayTape:
        if size not in self._mapped:
            if size >= ARRAY_SIZE and self._is_supported:
                self._mapped[size] = ArrayTape(self._layout("all", Layout), size)
            else:
                self._mapped[size] = _MappedFunction(self._function, size)
        return self._mapped[size]


def _chunks(n: int) -> Iterator[tuple[int, slice]]:
    """Chunks of n points, each with the size of the function that evaluates it."""
    start = 0
    while start < n:
        rest = n - start
        size = min((c for c in CHUNK_SIZES if c >= rest), default=CHUNK_SIZES[0])
        spare = ARRAY_SPARE if rest >= ARRAY_SIZE else SPARE
        if size - rest > spare:
            size = max(c for c in CHUNK_SIZES if c <= rest)
        yield size, slice(start, min(start + size, n))
        start += size


def _repeated(values: Array, n: int) -> Array:
    """Values (n, size), from as many or from one point for all."""
    if values.ndim == 2 and values.shape[0] == n:
        return values
    return np.broadcast_to(values, (n, values.shape[-1]))


def _shaped(values: Array, rows: int, columns: int) -> Array:
    """Values (n, rows * columns), stored column by column, as (n, rows, columns)."""
    if columns == 1:
        return values
    return values.reshape(len(values), columns, rows).transpose(0, 2, 1)


class _MappedFunction:
    """A function mapped to `size` points, on memory that CasADi keeps pointers to."""

    def __init__(self, function: Any, size: int) -> None:
        inputs, outputs = range(function.n_in()), range(function.n_out())
        self._buffer, self._evaluate = function.map(size).buffer()
        # Ones, not zeros: unused points of a short batch must stay clear of singular
        # values.
        self._inputs = [np.ones((size, function.numel_in(i))) for i in inputs]
        self._outputs = [np.zeros((size, function.numel_out(i))) for i in outputs]
        _attach(self._buffer.set_arg, self._inputs)
        _attach(self._buffer.set_res, self._outputs)

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Evaluate up to `size` points; writes `outputs` in place."""
        for memory, values in zip(self._inputs, inputs, strict=True):
            memory[: len(values)] = values
        self._evaluate()
        for values, memory in zip(outputs, self._outputs, strict=True):
            values[:] = memory[: len(values)]


def _attach(setter: Any, arrays: Sequence[Array]) -> None:
    for i, array in enumerate(arrays):
        if array.size:
            setter(i, memoryview(array.reshape(-1).data))
