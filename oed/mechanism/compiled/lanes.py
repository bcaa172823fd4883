"""Compiled functions over arrays of poses: evaluation, Newton's method, adjoints."""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from oed.base import Array, Mask
from oed.mechanism.compiled.compiler import load
from oed.mechanism.compiled.text import LaneJob, lane_text
from oed.mechanism.graph import Graph
from oed.mechanism.tape import (
    REMAINING_ERROR,
    SHORT_STEP,
    AdjointRows,
    SolvedSystems,
)

#: least number of points of a core's share: two milliseconds of work
SHARED_POINTS = 8192
#: shares begin at multiples of this: of the lanes of every processor
MOST_LANES = 8
#: most steps with new slopes, and with kept ones
NEWTON_STEPS, CHORD_STEPS = 8, 4
#: error (m, rad) after which a point takes no further step
LEAST_ERROR = 1e-17
#: instructions of the longest function that is compiled, in some ten seconds
MOST_INSTRUCTIONS = 20_000
#: states of points in newton.h
SOLVED, NEAR = 1, 2
#: words of memory in a number
WORD = 8


class _Limits(ctypes.Structure):
    """`limits` of newton.h."""

    _fields_ = (
        ("step_tolerance", ctypes.c_double),
        ("longest", ctypes.c_double),
        ("short_step", ctypes.c_double),
        ("remaining", ctypes.c_double),
        ("acceptable", ctypes.c_double),
        ("newton_steps", ctypes.c_int64),
        ("chord_steps", ctypes.c_int64),
    )


class _InputTable(NamedTuple):
    """Inputs at points, as C reads them.

    arrays  what they lie in, kept alive
    table   (inputs, 4): place, steps from row to row (outer, inner), entries
    shape   of the points: (n,), or (m, n) with the last the fastest
    """

    arrays: list[Array]
    table: Any
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))

    @property
    def inner(self) -> int:
        return max(self.shape[-1], 1)


class _Lanes:
    """A job on a function, compiled."""

    #: its function in C
    name: str

    def __init__(self, library: ctypes.CDLL, graph: Graph, constants: Array) -> None:
        self._run = getattr(library, self.name)
        self._run.restype = None
        self._constants = constants
        self._entries = list(graph.inputs)

    def _call(self, points: _InputTable, *arguments: Any) -> None:
        """Run at all points, on all cores where they are many.

        Raises ValueError for inputs of other sizes, which C would read beyond.
        """
        entries = [a.shape[-1] for a in points.arrays]
        if entries != self._entries[: len(entries)]:
            raise ValueError(f"inputs have {entries} entries, not {self._entries}")
        table, inner = _place(points.table), ctypes.c_int64(points.inner)
        constants = _place(self._constants)

        def run(first: int, end: int) -> None:
            ends = ctypes.c_int64(first), ctypes.c_int64(end)
            self._run(*ends, inner, table, constants, *arguments)

        share_points(run, points.size)


class Evaluation(_Lanes):
    """Values of a function's outputs."""

    name, job = "pkm_evaluate", LaneJob("evaluate.h", frozenset())

    def __init__(self, library: ctypes.CDLL, graph: Graph, constants: Array) -> None:
        super().__init__(library, graph, constants)
        self._sizes = [len(row) for row in graph.outputs]

    def run(self, inputs: Sequence[Array], count: int) -> list[Array]:
        """Outputs (count, entries), each column by column, at inputs (count, size)."""
        outputs = [np.empty((count, size)) for size in self._sizes]
        places = np.array([_address(a) for a in outputs], dtype=np.int64)
        self._call(_points(inputs, (count,)), _place(places))
        return outputs


class Newton(_Lanes):
    """Newton's method for value = 0."""

    name = "pkm_newton"

    def __init__(self, library: ctypes.CDLL, graph: Graph, constants: Array) -> None:
        super().__init__(library, graph, constants)
        self._rows = len(graph.outputs[0])

    @staticmethod
    def job(graph: Graph, unknown: int, angles: Sequence[int]) -> LaneJob:
        """The job on a function of value and slope; see `ArrayNewton` for the angles.

        unknown  number of leading inputs to solve for
        """
        macros = [("ROWS", len(graph.outputs[0]))]
        if angles:
            macros.append(("ANGLES", angles[0]))
        return LaneJob("newton.h", frozenset(range(unknown)), tuple(macros))

    def solve(
        self,
        inputs: Sequence[Array],
        unknown: int,
        step_tolerance: float,
        longest: float,
    ) -> SolvedSystems:
        """Solutions near `inputs` (n, entries) or (m, n, entries).

        unknown         number of leading inputs to solve for
        step_tolerance  longest last step (m, rad)
        longest         longest step (m, rad) of a system that this method may solve
        """
        shape = inputs[0].shape[:-1]
        points = _points(inputs, shape)
        solutions = np.empty((*shape, self._rows))
        states = np.empty(shape, dtype=np.uint8)
        limits = _Limits(
            step_tolerance,
            longest,
            SHORT_STEP,
            LEAST_ERROR,
            REMAINING_ERROR,
            NEWTON_STEPS,
            CHORD_STEPS,
        )
        at = ctypes.byref(limits)
        self._call(points, at, _place(solutions), _place(states))
        ends = np.cumsum([a.shape[-1] for a in inputs[:unknown]])[:-1]
        values = np.split(solutions, ends, axis=-1)
        return SolvedSystems(values, states == SOLVED, states == NEAR)


class Adjoint(_Lanes):
    """Rows by adjoints; see `oed.mechanism.tape`."""

    name = "pkm_adjoint"

    def __init__(self, library: ctypes.CDLL, graph: Graph, constants: Array) -> None:
        super().__init__(library, graph, constants)
        self._columns = len(graph.outputs[1])

    @staticmethod
    def job(graph: Graph) -> LaneJob:
        """The job on a function of a matrix and a row, which takes the factors last."""
        last = len(graph.inputs) - 1
        macros = (("ROWS", graph.inputs[last]),)
        return LaneJob("adjoint.h", frozenset({last}), macros)

    def run(self, inputs: Sequence[Array], right: Array, scale: Array) -> AdjointRows:
        """Rows at n points, for right sides (n, channels, k) and units (k,)."""
        n, channels, _ = right.shape
        right = np.ascontiguousarray(right)
        scale = np.ascontiguousarray(scale)
        values = np.empty((n, channels, self._columns))
        condition = np.empty(n)
        self._call(
            _points(inputs, (n,)),
            _place(scale),
            ctypes.c_int64(channels),
            _place(right),
            _place(values),
            _place(condition),
        )
        accurate: Mask = np.isfinite(condition)
        return AdjointRows(values, condition, accurate)


def compiled(
    kind: Callable[[ctypes.CDLL, Graph, Array], Any], graph: Graph, job: LaneJob
) -> Any:
    """A job on a dense SX function, compiled; None where that cannot be."""
    if len(graph.nodes) > MOST_INSTRUCTIONS:
        return None
    written = lane_text(graph, job)
    library = load(written.text)
    return None if library is None else kind(library, graph, written.constants)


def _points(inputs: Sequence[Array], shape: tuple[int, ...]) -> _InputTable:
    """Inputs (..., entries) at points of a shape of one or two dimensions."""
    arrays = [_readable(a, shape) for a in inputs]
    table = np.zeros((len(arrays), 4), dtype=np.int64)
    for row, array in zip(table, arrays, strict=True):
        steps = [stride // WORD for stride in array.strides[:-1]]
        outer = steps[0] if len(steps) == 2 else 0
        row[:] = _address(array), outer, steps[-1], array.shape[-1]
    return _InputTable(arrays, table, shape)


def _readable(values: Array, shape: tuple[int, ...]) -> Array:
    """Doubles at every point, without copies where one row serves several."""
    values = np.asarray(values, dtype=float)
    aligned = not any(stride % WORD for stride in values.strides)
    if not (aligned and values.strides[-1] == WORD):
        values = np.ascontiguousarray(values)
    if values.shape[:-1] == shape:
        return values
    return np.broadcast_to(values, (*shape, values.shape[-1]))


def _address(array: Array) -> int:
    place: int = array.__array_interface__["data"][0]
    return place


def _place(array: Any) -> ctypes.c_void_p:
    return ctypes.c_void_p(_address(array))


def share_points(run: Callable[[int, int], None], count: int) -> None:
    """Run from 0 to `count` in as many shares as there are cores for this process."""
    shares = count // SHARED_POINTS
    cores = min(_cores(), shares) if shares > 1 else 1
    if cores < 2:
        run(0, count)
        return
    size = -(-count // (cores * MOST_LANES)) * MOST_LANES
    starts = range(0, count, size)
    threads = [
        threading.Thread(target=run, args=(start, min(start + size, count)))
        for start in starts[1:]
    ]
    for thread in threads:
        thread.start()
    try:
        run(0, min(size, count))
    finally:  # an interrupt waits: the threads write into the caller's arrays
        for thread in threads:
            thread.join()


def _cores() -> int:
    """Cores of this process, or fewer where `OMP_NUM_THREADS` states so."""
    affinity = getattr(os, "sched_getaffinity", None)
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    stated = os.environ.get("OMP_NUM_THREADS", "")
    return max(min(cores, int(stated)), 1) if stated.isdecimal() else cores
