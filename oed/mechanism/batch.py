"""One CasADi function over many points at once, without copies or a Python loop.

A compiled function is taken where it is known to be there, and made beside the work
once that has lasted a while; all ways lead to the same digits.
"""

import functools
import math
import os
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from oed.base import Array, Index
from oed.mechanism import systems
from oed.mechanism.compiled import (
    MAX_INSTRUCTIONS,
    Adjoint,
    CompiledText,
    Evaluation,
    Newton,
    compiled_text,
    lane_text,
)
from oed.mechanism.graph import Graph, read_graph
from oed.mechanism.systems import AdjointRows, SolvedSystems
from oed.mechanism.tape import ArrayTape, Interpreter

#: number of points from which array operations are faster than CasADi's interpreter
MIN_ARRAY_POINTS = 192
#: points of systems that are solved together without a compiler, in a few megabytes
BLOCK_POINTS = 4096
#: environment variable that decides when functions are compiled
COMPILE_VARIABLE = "OED_COMPILE"
NEVER_COMPILE = "0"  #: its value where no function is compiled
COMPILE_AT_ONCE = "1"  #: its value where each function is compiled at its first call
INTERPRETER_SECONDS = 5e-9  #: time of an instruction at a point in the interpreter, s
ARRAY_SECONDS = 1e-9  #: the same of array operations
CALL_SECONDS = 20e-6  #: time of any call that is not compiled, s
#: time in which an instruction is written as C, to see whether it is compiled already, s
WRITING_SECONDS = 10e-6
COMPILER_SECONDS = 0.4e-3  #: time in which the compiler compiles it, s
COMPILER_START = 0.1  #: time that the compiler takes at least, s
#: share of its compilation's time after which a function is compiled beside the work:
#: later runs find it
BESIDE_SHARE = 0.1
NEWTON_EVALUATIONS = 5  #: evaluations in which Newton's method ends, about


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
        self._setting = _setting()
        self._jobs: dict[type, CompiledJob] = {}
        self._outputs_alone: dict[int, PlainFunction] = {}

    def __call__(self, *arrays: Array) -> list[Array]:
        """Evaluate at n points: arrays (n, size) or (size,), one for each input.

        A single point of one input goes with all n of the others. Returns one array
        for each output: (n, rows) for a column, (n, rows, columns) for a matrix.
        """
        n = max([a.shape[0] for a in arrays if a.ndim == 2], default=1)
        evaluation = self._job(Evaluation, n, 1)
        run = self._plain.run if evaluation is None else evaluation.run
        outputs = run(arrays, n)
        return [_shaped(a, *s) for a, s in zip(outputs, self._shapes, strict=True)]

    def solve(
        self, inputs: Sequence[Array], step_tolerance: float, longest: float
    ) -> SolvedSystems:
        """Solve value = 0 over the first input by Newton's method.

        inputs  (n, entries) or (m, n, entries); or with one point, or one of m, for all

        The outputs are value (k,) and slope (k, k). See `systems.solve` for the limits.
        """
        shape = inputs[0].shape[:-1]
        job = self._job(Newton, math.prod(shape), NEWTON_EVALUATIONS)
        if job is not None:
            solutions: SolvedSystems = job.solve(inputs, step_tolerance, longest)
            return solutions
        wide = [np.broadcast_to(a, (*shape, a.shape[-1])) for a in inputs]
        rows = [a.reshape(-1, a.shape[-1]) for a in wide]
        limits = step_tolerance, longest
        parts = [
            self._solve_block([a[first : first + BLOCK_POINTS] for a in rows], *limits)
            for first in range(0, max(len(rows[0]), 1), BLOCK_POINTS)
        ]
        values, solved, near = map(np.concatenate, zip(*parts, strict=True))
        return SolvedSystems(
            values.reshape(inputs[0].shape), solved.reshape(shape), near.reshape(shape)
        )

    def _solve_block(
        self, inputs: Sequence[Array], step_tolerance: float, longest: float
    ) -> SolvedSystems:
        """As `solve`, not compiled, at points (n, entries)."""
        start, *others = inputs

        def equations(z: Array, points: Index) -> tuple[Array, Array]:
            outputs = self._plain.run([z, *(a[points] for a in others)], len(z))
            value, slope = map(_shaped, outputs, *zip(*self._shapes, strict=True))
            return value, slope

        def values(z: Array, points: Index) -> Array:
            return self._alone(0, [z, *(a[points] for a in others)])

        return systems.solve(equations, values, start, step_tolerance, longest)

    def pull_back(
        self, inputs: Sequence[Array], right: Array, scale: Array
    ) -> AdjointRows:
        """Rows at n points by adjoints; see `systems.adjoint_rows`.

        The outputs are a matrix (k, k), and a row that is linear in the last input
        (k,); `inputs` (n, entries) are the others.

        right  (n, channels, k) right sides
        scale  (k,) units of the matrix's columns
        """
        n, channels, k = right.shape
        job = self._job(Adjoint, n, 1 + channels)
        if job is not None:
            rows: AdjointRows = job.run(inputs, right, scale)
            return rows
        matrices = self._alone(0, [*inputs, np.zeros((n, k))]).reshape(n, k, k)
        return systems.adjoint_rows(
            matrices.transpose(0, 2, 1),
            lambda x: self._alone(1, [*inputs, x]),
            right,
            scale,
        )

    @functools.cached_property
    def _function(self) -> Any:
        """Made on first use: many are never called."""
        name, inputs, outputs = self._definition
        dense = [ca.densify(output) for output in outputs]
        return ca.Function(name, inputs, dense, {"cse": True})

    @functools.cached_property
    def _plain(self) -> "PlainFunction":
        return PlainFunction(self._function)

    def _alone(self, number: int, inputs: Sequence[Array]) -> Array:
        """One output (n, entries) at inputs (n, entries), column by column."""
        if number not in self._outputs_alone:
            name, symbols, outputs = self._definition
            dense = [ca.densify(outputs[number])]
            function = ca.Function(f"{name}_{number}", symbols, dense, {"cse": True})
            self._outputs_alone[number] = PlainFunction(function)
        return self._outputs_alone[number].run(inputs, len(inputs[0]))[0]

    def _job(self, kind: Any, points: int, evaluations: int) -> Any | None:
        """A job on this function, compiled; None while, or where, that is not to be."""
        job = self._jobs.get(kind)
        if job is None:
            job = self._jobs[kind] = CompiledJob(kind, self._function, self._setting)
        return job.ready or job.after(points * evaluations)


class PlainFunction:
    """A function that is not compiled, over many points."""

    def __init__(self, function: Any) -> None:
        self._interpreter = Interpreter(function)
        self._entries = [function.numel_out(i) for i in range(function.n_out())]
        self._function = function

    @functools.cached_property
    def _tape(self) -> ArrayTape | None:
        tape = ArrayTape(self._function)
        return tape if tape.is_known else None

    def run(self, inputs: Sequence[Array], n: int) -> list[Array]:
        """Outputs (n, entries) at inputs (n, entries), or one point of some for all."""
        wide = [
            a if a.ndim == 2 and len(a) == n else np.broadcast_to(a, (n, a.shape[-1]))
            for a in inputs
        ]
        outputs = [np.empty((n, entries)) for entries in self._entries]
        tape = self._tape if n >= MIN_ARRAY_POINTS else None
        (tape or self._interpreter).run(wide, outputs)
        return outputs


def _shaped(values: Array, rows: int, columns: int) -> Array:
    """Values (n, rows * columns), stored column by column, as (n, rows, columns)."""
    if columns == 1:
        return values
    return values.reshape(len(values), columns, rows).transpose(0, 2, 1)


class CompileSettingError(ValueError):
    """The environment variable has a value that says nothing."""


class CompiledJob:
    """A job on a function, compiled once that pays.

    The environment variable `OED_COMPILE` is 0 for never and 1 for at the first call.
    Otherwise an earlier file is looked for once the work has lasted about as long as the
    look takes, and a new one is made once later runs, or the rest of this one, will gain
    by it. Work is counted in instructions: times would say little on a loaded computer.
    """

    def __init__(self, kind: Any, function: Any, setting: str) -> None:
        self._kind, self._function, self._setting = kind, function, setting
        self._length = function.n_instructions()
        #: the compiled job, once it is there
        self.ready: Any | None = None
        self._is_over = setting == NEVER_COMPILE
        self._is_asked = False
        self._text: CompiledText | None = None
        #: graph and constants, for the job
        self._arguments: tuple[Graph, Array]
        #: time of the work so far, s
        self._spent = 0.0

    def after(self, evaluations: int) -> Any | None:
        """The compiled job, if it is to do so many evaluations; else None."""
        if self._is_over:
            return None
        is_long = evaluations >= MIN_ARRAY_POINTS
        instruction = ARRAY_SECONDS if is_long else INTERPRETER_SECONDS
        seconds = CALL_SECONDS + evaluations * self._length * instruction
        self._spent += seconds
        at_once = self._setting == COMPILE_AT_ONCE
        if self._text is None:
            if not at_once and self._spent < WRITING_SECONDS * self._length:
                return None
            self._text = self._look()
        if self._text is None:
            self._is_over = True
        else:
            self._advance(self._text, math.inf if at_once else seconds)
        return self.ready

    def _look(self) -> CompiledText | None:
        """The text of the job, with an earlier file; None where it cannot be compiled."""
        graph = read_graph(self._function)
        if graph is None or len(graph.nodes) > MAX_INSTRUCTIONS:
            return None
        text, constants = lane_text(graph, self._kind.job(graph))
        self._arguments = graph, constants
        return compiled_text(text)

    def _advance(self, text: CompiledText, seconds: float) -> None:
        """Take what is there; have it made if it is not, for work of some time."""
        compilation = COMPILER_START + COMPILER_SECONDS * self._length
        if not text.is_done:
            if seconds > compilation:
                text.make()
            elif not self._is_asked and self._spent > BESIDE_SHARE * compilation:
                text.make_beside()
                self._is_asked = True
        if text.is_done:
            self._is_over = True
            if text.functions is not None:
                self.ready = self._kind(text.functions, *self._arguments)


def _setting() -> str:
    """NEVER_COMPILE, COMPILE_AT_ONCE, or empty: once it pays. Raises CompileSettingError."""
    setting = os.environ.get(COMPILE_VARIABLE, "").strip()
    if setting not in ("", NEVER_COMPILE, COMPILE_AT_ONCE):
        raise CompileSettingError(
            f"the environment variable {COMPILE_VARIABLE} is {setting!r}: write {NEVER_COMPILE} for never,"
            f" {COMPILE_AT_ONCE} for at once, or unset it"
        )
    return setting
