"""A CasADi function as array operations on many points, and its systems of equations.

CasADi interprets its instructions point by point. For hundreds of points, the same
instructions run faster one after the other, each as a NumPy operation over all points:
the interpreter's cost is then shared by the points, and the processor's vector units
work.

Newton's method and adjoints work on the same memory, where each entry of all points is
one row. Matrices are eliminated in the order of rows that partial pivoting takes at one
point, for all. At other points it may be a poor one: Newton's method measures the error
by its further steps, adjoints by their residual.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from oed.base import Array, Mask
from oed.mechanism.graph import OPERATIONS, Graph

#: bytes of a line of the processor's cache, or a multiple
CACHE_LINE = 64
#: step (m, rad) after which the slopes are kept
SHORT_STEP = 1e-4
#: share of a chunk's systems that may have longer steps then, or stay unsolved
UNSOLVED_SHARE = 0.02
#: most steps with new slopes
NEWTON_STEPS = 4
#: most steps with kept slopes
CHORD_STEPS = 3
#: error (m, rad) that the last step may leave
REMAINING_ERROR = 1e-15
#: residual of an adjoint over its largest product with an entry of the matrix
RESIDUAL_TOLERANCE = 1e-14
#: what writes its last argument from the others, and these arguments
Call = tuple[Any, tuple[Any, ...]]


def memory(
    shape: tuple[int, ...], fill: float = 0.0, kind: DTypeLike = np.float64
) -> Any:
    """An array that starts with a line of the processor's cache.

    Its vector units then read and write whole lines, a fifth faster.
    """
    count = math.prod(shape)
    numbers = np.full(count + CACHE_LINE, fill, dtype=kind)
    first = -(numbers.ctypes.data // numbers.itemsize) % CACHE_LINE
    return numbers[first : first + count].reshape(shape)


class ArrayTape:
    """A function at `size` points, on memory of its own.

    Where some inputs stay the same from one evaluation to the next, as joints and
    parameters do in Newton's method, what depends on them alone is evaluated once.

    varying  numbers of the inputs that change between evaluations

    Attributes:

    inputs   for each input, the memory (entries, size)
    outputs  for each output, the memory (entries, size), column by column of a matrix
    """

    def __init__(self, graph: Graph, size: int, varying: Collection[int]) -> None:
        # ones: unused points of a short batch must stay clear of singular values
        self.inputs = [memory((entries, size), 1.0) for entries in graph.inputs]
        self.outputs = [memory((len(row), size)) for row in graph.outputs]
        varied = graph.varying(varying)
        first = graph.needed(graph.outputs[0]) & varied
        order = _order(graph, varied, first)
        values_of = self._place_given(graph)
        copies = self._place_outputs(graph, values_of)
        for number, values in _place_computed(graph, order, varied, values_of, size):
            values_of[number] = values

        def call(number: int) -> Call:
            node = graph.nodes[number]
            assert node.operation is not None
            sources = [values_of[source] for source in node.sources]
            return OPERATIONS[node.operation].array, (*sources, values_of[number])

        self._fixed = [call(n) for n in order if n not in varied]
        self._first = [call(n) for n in order if n in first]
        self._rest = [call(n) for n in order if n in varied and n not in first]
        for number, entry in copies:
            varied_calls = self._first if number in first else self._rest
            calls = varied_calls if number in varied else self._fixed
            calls.append((np.positive, (values_of[number], entry)))

    def _place_given(self, graph: Graph) -> dict[int, Any]:
        """Values of constants and of the inputs' entries, by node."""
        values_of: dict[int, Any] = {}
        for number, node in enumerate(graph.nodes):
            if node.constant is not None:
                values_of[number] = np.array(node.constant)
            elif node.entry is not None:
                values_of[number] = self.inputs[node.entry[0]][node.entry[1]]
        return values_of

    def _place_outputs(
        self, graph: Graph, values_of: dict[int, Any]
    ) -> list[tuple[int, Array]]:
        """Give each output's node its entry; where it has a place, return a copy to make."""
        copies = []
        for row, entries in zip(graph.outputs, self.outputs, strict=True):
            for number, entry in zip(row, entries, strict=True):
                if number in values_of:
                    copies.append((number, entry))
                else:
                    values_of[number] = entry
        return copies

    def load(self, inputs: Sequence[Array]) -> None:
        """Copy leading inputs of up to `size` points (n, entries).

        Points that are left over repeat the first. What does not vary is evaluated.
        """
        for entries, values in zip(self.inputs, inputs, strict=False):
            entries[:, : len(values)] = values.T
            entries[:, len(values) :] = values[:1].T
        _make(self._fixed)

    def evaluate(self) -> None:
        """Compute `outputs` from `inputs`."""
        _make(self._first)
        _make(self._rest)

    def evaluate_first(self) -> None:
        """Compute the first output alone."""
        _make(self._first)

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Evaluate up to `size` points (n, entries); writes `outputs` in place."""
        self.load(inputs)
        self.evaluate()
        for values, entries in zip(outputs, self.outputs, strict=True):
            values[:] = entries[:, : len(values)].T


def _order(graph: Graph, varied: set[int], first: set[int]) -> list[int]:
    """Computed nodes that outputs need: fixed ones, those of the first output, the rest."""
    needed = graph.needed([number for row in graph.outputs for number in row])
    computed = [n for n in needed if graph.nodes[n].operation is not None]
    return sorted(computed, key=lambda n: (n in varied, n not in first, n))


def _place_computed(
    graph: Graph,
    order: Sequence[int],
    varied: set[int],
    values_of: dict[int, Any],
    size: int,
) -> Iterable[tuple[int, Array]]:
    """Rows of memory for the nodes without a place: what one leaves, the next takes.

    So few rows are in use and stay in the processor's cache. What does not vary and
    varying nodes take lasts: many evaluations read it.
    """
    last_use = {
        source: k for k, n in enumerate(order) for source in graph.nodes[n].sources
    }
    rows: dict[int, int] = {}
    free: list[int] = []
    count = 0
    for k, number in enumerate(order):
        if number not in values_of:
            if free:
                rows[number] = free.pop()
            else:
                rows[number] = count
                count += 1
        for source in set(graph.nodes[number].sources) & rows.keys():
            lasts = number in varied and source not in varied
            if last_use[source] == k and not lasts:
                free.append(rows[source])
    work = memory((count, size))
    return [(number, work[row]) for number, row in rows.items()]


def _make(calls: Sequence[Call]) -> None:
    """Make the calls; values without a result, as of sqrt(-1), become NaN."""
    with np.errstate(all="ignore"):
        for operation, arguments in calls:
            operation(*arguments)


class Elimination:
    """Factors of matrices (rows, rows, size), on memory of its own.

    kind  precision of factors and solutions
    """

    def __init__(self, rows: int, size: int, kind: DTypeLike = np.float64) -> None:
        self._order = list(range(rows))
        self._factors = memory((rows, rows, size), kind=kind)
        self._solution = memory((rows, size), kind=kind)
        self._products = memory((rows, rows, size), kind=kind)

    def choose_order(self, matrices: Array) -> None:
        """Take the order of rows from the first matrix; see `factorise`."""
        self._order = _pivot_order(matrices[:, :, 0].tolist())

    def factorise(self, matrices: Array) -> None:
        """Factors L U: L below, U above, and one over U's entries on the diagonal."""
        factors, products = self._factors, self._products
        with np.errstate(all="ignore"):
            for row, k in enumerate(self._order):
                factors[row] = matrices[k]
            for k in range(len(factors)):
                pivot, below = factors[k, k], factors[k + 1 :, k]
                np.reciprocal(pivot, out=pivot)
                below *= pivot
                product = products[k + 1 :, k + 1 :]
                np.multiply(below[:, None], factors[k, k + 1 :], out=product)
                factors[k + 1 :, k + 1 :] -= product

    def inverse_determinants(self) -> Array:
        """One over the determinants (size,) of the factorised matrices, up to signs."""
        return np.asarray(
            np.prod([row[k] for k, row in enumerate(self._factors)], axis=0)
        )

    def solve(self, right: Array) -> Array:
        """Solutions (rows, size) of the factorised matrices at right sides.

        They lie in memory that the next call overwrites.
        """
        factors, products = self._factors, self._products[0]
        solution: Array = self._solution
        with np.errstate(all="ignore"):
            for row, k in enumerate(self._order):
                solution[row] = right[k]
            for k in range(len(factors)):
                np.multiply(factors[k + 1 :, k], solution[k], out=products[k + 1 :])
                solution[k + 1 :] -= products[k + 1 :]
            for k in reversed(range(len(factors))):
                solution[k] *= factors[k, k]
                np.multiply(factors[:k, k], solution[k], out=products[:k])
                solution[:k] -= products[:k]
        return solution


def _pivot_order(rows: list[list[float]]) -> list[int]:
    """Order of the rows of a matrix by partial pivoting; any where it has a NaN.

    Of one small matrix, Python's numbers are faster than a call of LAPACK.
    """
    order = list(range(len(rows)))
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
    return order


class SolvedSystems(NamedTuple):
    """Solutions of n systems of equations.

    values  for each unknown input (n, entries)
    solved  (n,) which hold
    near    (n,) which others ended with a short step: careful steps may start there
    """

    values: list[Array]
    solved: Mask
    near: Mask


class ArrayNewton:
    """Newton's method for `size` systems of equations.

    A chunk of systems takes every step together, and its memory stays in the processor's
    cache. Once the last step is short, further steps keep its slopes (the chord method;
    Ortega and Rheinboldt 1970, section 7.1) and evaluate the equations alone: each leaves
    the same share of the error, so that two steps s1 and s2 tell the error that remains,
    s2^2 / s1. A system whose steps do not tell that it is solved is returned as unsolved;
    a few that are nearly solved do not keep the others waiting.

    Factors of slopes are in single precision: a step's direction needs six digits. The
    equations are in double precision, and so are the solutions.

    graph    of value (k,) and slope (k, k)
    unknown  number of leading inputs to solve for, of k entries together
    """

    def __init__(self, graph: Graph, size: int, unknown: int) -> None:
        rows = len(graph.outputs[0])
        self._tape = ArrayTape(graph, size, range(unknown))
        self._slope = self._tape.outputs[1].reshape(rows, rows, size).swapaxes(0, 1)
        self._elimination = Elimination(rows, size, np.float32)
        self._unknown = self._tape.inputs[:unknown]

    def solve(
        self, inputs: Sequence[Array], step_tolerance: float, longest: float
    ) -> SolvedSystems:
        """Solutions near `inputs` (n, entries) of up to `size` systems.

        step_tolerance  longest last step (m, rad)
        longest         longest step (m, rad) of a system that this method may solve
        """
        count = len(inputs[0])
        self._tape.load(inputs)
        before, far = self._newton_steps(count, longest)
        solved = np.zeros(count, dtype=bool)
        for _ in range(CHORD_STEPS):
            self._tape.evaluate_first()
            after = self._step()[:count]
            with np.errstate(all="ignore"):
                near = (after <= step_tolerance) & ~far
                solved |= near & (after**2 <= REMAINING_ERROR * before)
            unsolved = count - np.count_nonzero(solved | far)
            if unsolved <= UNSOLVED_SHARE * count:
                break
            before = after
        values = [unknown[:, :count].T for unknown in self._unknown]
        return SolvedSystems(values, solved, near & ~solved)

    def _newton_steps(self, count: int, longest: float) -> tuple[Array, Mask]:
        """Steps with new slopes: sizes (count,) of the last, and which were too long."""
        far = np.zeros(count, dtype=bool)
        for step in range(NEWTON_STEPS):
            self._tape.evaluate()
            if step == 0:
                self._elimination.choose_order(self._slope)
            self._elimination.factorise(self._slope)
            size = self._step()[:count]
            far |= size > longest
            long = np.count_nonzero(size > SHORT_STEP)
            if long <= UNSOLVED_SHARE * count or far.all():
                break
        return size, far

    def _step(self) -> Array:
        """Step with the slopes at hand; its size, the largest entry, at each point."""
        step = self._elimination.solve(self._tape.outputs[0])
        first = 0
        for unknown in self._unknown:
            unknown -= step[first : first + len(unknown)]
            first += len(unknown)
        return np.asarray(np.abs(step).max(axis=0), dtype=float)


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
    """Rows B^T lambda at `size` points, where A^T lambda = g.

    A is (k, k), B (k, m), and g (k,) a right side. Where the order of rows is a poor
    one, the residual A^T lambda - g is larger than rounding explains, and the row is
    returned as inaccurate.

    The singular values of A are known by their product, the determinant, and by their
    sum of squares. So the condition number is at most
    |A|^k (k - 1)^(-(k - 1) / 2) / |det A|, with the Frobenius norm |A|: the others than
    the smallest have the largest product where they are equal.

    graph  of A and of the row B^T lambda, which takes lambda last
    scale  (k,) units of A's columns, for the condition number
    """

    def __init__(self, graph: Graph, size: int, scale: Array) -> None:
        rows = len(scale)
        self._tape = ArrayTape(graph, size, [len(graph.inputs) - 1])
        # stored column by column, so that these are A^T
        self._matrices = self._tape.outputs[0].reshape(rows, rows, size)
        self._elimination = Elimination(rows, size)
        self._right = memory((rows, size))
        self._scale = scale
        self._volume = (rows - 1.0) ** (-(rows - 1.0) / 2.0) / np.prod(scale)

    def run(self, inputs: Sequence[Array], right: Array, out: AdjointRows) -> None:
        """Rows at up to `size` points (n, entries), written to `out`.

        right  (n, channels, k)
        """
        tape, elimination, count = self._tape, self._elimination, len(right)
        tape.load(inputs)
        elimination.choose_order(self._matrices)
        elimination.factorise(self._matrices)
        out.condition[:] = self._condition()[:count]
        out.accurate[:] = True
        for channel in range(right.shape[1]):
            self._right[:, :count] = right[:, channel].T
            tape.inputs[-1][:] = elimination.solve(self._right)
            out.accurate[:] &= self._is_accurate()[:count]
            tape.evaluate()
            out.values[:, channel] = tape.outputs[1][:, :count].T

    def _condition(self) -> Array:
        """Bounds (size,) on the condition numbers."""
        with np.errstate(all="ignore"):
            squares = np.square(self._matrices).sum(axis=1)
            norm = np.sqrt(self._scale**2 @ squares) ** len(self._scale)
            volume = self._volume * np.abs(self._elimination.inverse_determinants())
            return np.asarray(norm * volume)

    def _is_accurate(self) -> Mask:
        """Where the residuals (size,) are those of rounding."""
        with np.errstate(all="ignore"):
            products = self._matrices * self._tape.inputs[-1]
            residual = np.abs(products.sum(axis=1) - self._right).max(axis=0)
            largest = np.abs(products).max(axis=(0, 1))
            return np.asarray(residual <= RESIDUAL_TOLERANCE * largest)
