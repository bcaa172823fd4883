"""One CasADi function over many points at once, without copies or a Python loop.

Batches of hundreds of points run as array operations (`oed.mechanism.tape`), smaller ones
in CasADi's interpreter. A function that has much to do is compiled, where this computer has
a compiler, and then runs so at all sizes (`oed.mechanism.compiled`).

`casadi.Function.map` runs one instruction tape over many columns, and its buffer
interface works in place on NumPy memory. Calls with DM matrices would spend three to
ten times as long on conversions.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import casadi as ca
import numpy as np

from oed.base import Array
from oed.mechanism.compiled import Adjoint, Evaluation, LaneJob, Newton, compiled
from oed.mechanism.graph import Graph, read_graph
from oed.mechanism.tape import (
    AdjointRows,
    ArrayAdjoint,
    ArrayNewton,
    ArrayTape,
    SolvedSystems,
)

#: Numbers of points for which a mapped function is compiled, each on first use, in half
#: a millisecond. Batches are cut into the largest; what remains is padded to the next
#: larger number, where that takes few points, and cut again otherwise.
CHUNK_SIZES = (
    *(2048, 1536, 1024, 768, 512, 384, 256, 192, 128, 96, 64),
    *(48, 32, 24, 16, 12, 8, 6, 4, 2, 1),
)
#: most points that padding may add: they take as long as another call of CasADi's
#: interpreter does
MAX_PADDING = 4
#: the same of array operations
MAX_ARRAY_PADDING = 256
#: number of points from which array operations are faster than CasADi's interpreter
MIN_ARRAY_POINTS = 192
#: environment variable that decides when functions are compiled
COMPILE_VARIABLE = "OED_COMPILE"
#: its value where no function is compiled
NEVER_COMPILE = "0"
#: its value where each function is compiled at its first call
COMPILE_AT_ONCE = "1"
#: points after which the array code has taken longer than the compilation of a long
#: function, 0.4 ms an instruction
COMPILE_POINTS = 400_000
#: points times instructions more, for the 0.1 s that the compiler takes at least
COMPILE_WORK = 100_000_000


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

    def solve(
        self,
        inputs: Sequence[Array],
        unknown: int,
        step_tolerance: float,
        longest: float,
    ) -> SolvedSystems:
        """Solve value = 0 by Newton's method, where the batch is large.

        inputs  (n, entries) or (m, n, entries); the first `unknown` of them start the
                iteration

        The outputs are value (k,) and slope (k, k) over these inputs. See `ArrayNewton`
        for the limits. In small batches nothing is solved.
        """
        shape = inputs[0].shape[:-1]
        n = math.prod(shape)
        newton = self._compiled_job(Newton, n, lambda graph: Newton.job(graph, unknown))
        if newton is not None:
            solved_systems: SolvedSystems = newton.solve(
                inputs, unknown, step_tolerance, longest
            )
            return solved_systems
        rows = [a.reshape(n, a.shape[-1]) for a in inputs]
        values = [np.array(a, dtype=float) for a in rows[:unknown]]
        solved = np.zeros(n, dtype=bool)
        near = np.zeros(n, dtype=bool)
        graph = self._graph_of_many(n)
        if graph is not None:
            self._solve_chunks(
                graph,
                rows,
                (step_tolerance, longest),
                SolvedSystems(values, solved, near),
            )
        return SolvedSystems(
            [a.reshape(*shape, -1) for a in values],
            solved.reshape(shape),
            near.reshape(shape),
        )

    def _solve_chunks(
        self,
        graph: Graph,
        inputs: Sequence[Array],
        limits: tuple[float, float],
        out: SolvedSystems,
    ) -> None:
        """Solve at points (n, entries) in chunks, written to `out`."""
        unknown = len(out.values)
        for size, chunk in _chunks(len(out.solved)):
            if size not in self._newton:
                self._newton[size] = ArrayNewton(graph, size, unknown)
            part = self._newton[size].solve([a[chunk] for a in inputs], *limits)
            out.solved[chunk], out.near[chunk] = part.solved, part.near
            for every, some in zip(out.values, part.values, strict=True):
                every[chunk] = some

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
        graph = self._graph_of_many(n)
        if graph is None:
            return rows
        for size, chunk in _chunks(n):
            if size not in self._adjoints:
                self._adjoints[size] = ArrayAdjoint(graph, size, scale)
            points = [a[chunk] for a in inputs]
            self._adjoints[size].run(points, right[chunk], rows.part(chunk))
        return rows

    @functools.cached_property
    def _function(self) -> Any:
        """Compiled on first use: many are never called."""
        name, inputs, outputs = self._definition
        dense = [ca.densify(output) for output in outputs]
        return ca.Function(name, inputs, dense, {"cse": True})

    @functools.cached_property
    def _graph(self) -> Graph | None:
        return read_graph(self._function)

    def _graph_of_many(self, points: int) -> Graph | None:
        """The graph where array operations are faster; None in CasADi's interpreter."""
        return self._graph if points >= MIN_ARRAY_POINTS else None

    def _compiled_job(
        self, kind: Any, points: int, job: Callable[[Graph], LaneJob]
    ) -> Any | None:
        """A job on this function, compiled; None while, or where, that is not to be."""
        if not self._switch.is_on(points, self._length):
            return None
        if kind not in self._compiled:
            graph = self._graph
            self._compiled[kind] = (
                None if graph is None else compiled(kind, graph, job(graph))
            )
        return self._compiled[kind]

    @functools.cached_property
    def _length(self) -> int:
        """Number of instructions."""
        length: int = self._function.n_instructions()
        return length

    def _mapped_to(self, size: int) -> _MappedFunction | ArrayTape:
        if size not in self._mapped:
            graph = self._graph_of_many(size)
            if graph is None:
                self._mapped[size] = _MappedFunction(self._function, size)
            else:
                self._mapped[size] = ArrayTape(graph, size, range(len(graph.inputs)))
        return self._mapped[size]


def _chunks(n: int) -> Iterator[tuple[int, slice]]:
    """Chunks of n points, each with the size of the function that evaluates it."""
    start = 0
    while start < n:
        rest = n - start
        size = min((c for c in CHUNK_SIZES if c >= rest), default=CHUNK_SIZES[0])
        max_padding = MAX_ARRAY_PADDING if rest >= MIN_ARRAY_POINTS else MAX_PADDING
        if size - rest > max_padding:
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


class _Jobs:
    """The number of the job that this process does."""

    number = 0


def begin_job() -> None:
    """Start to count anew, for results that do not depend on the jobs before."""
    _Jobs.number += 1


class CompileSettingError(ValueError):
    """The environment variable has a value that says nothing."""


class CompileSwitch:
    """Whether a function runs compiled: at once, after enough work, or never.

    The environment variable `OED_COMPILE` is 0 for never and 1 for at once. Otherwise a
    function is compiled once its work has taken about as long as its compilation will:
    so that a job takes twice the least time at most. What counts is the number of
    points, not a time, nor whether a compiled file is there already. So the same run
    computes the same numbers again, to the last digit. Raises CompileSettingError.
    """

    def __init__(self) -> None:
        self._setting = _setting()
        self._job, self._points = _Jobs.number, 0

    def is_on(self, points: int, length: int) -> bool:
        """Whether it does now.

        points  that it is to be computed at now
        length  number of its instructions
        """
        if self._setting in (NEVER_COMPILE, COMPILE_AT_ONCE):
            return self._setting == COMPILE_AT_ONCE
        if self._job != _Jobs.number:
            self._job, self._points = _Jobs.number, 0
        self._points += points
        return (self._points - COMPILE_POINTS) * length > COMPILE_WORK


def _setting() -> str:
    """NEVER_COMPILE, COMPILE_AT_ONCE, or empty: after enough work. Raises CompileSettingError."""
    setting = os.environ.get(COMPILE_VARIABLE, "").strip()
    if setting not in ("", NEVER_COMPILE, COMPILE_AT_ONCE):
        raise CompileSettingError(
            f"the environment variable {COMPILE_VARIABLE} is {setting!r}: write {NEVER_COMPILE} for never,"
            f" {COMPILE_AT_ONCE} for at once, or unset it"
        )
    return setting
