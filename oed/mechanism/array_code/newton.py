"""Newton's method on many small systems of equations at once, entry by entry.

A chunk of systems takes every step together, and its memory stays in the processor's
cache. Once the last step is short, further steps keep its slopes (the chord method;
Ortega and Rheinboldt 1970, section 7.1) and evaluate the equations alone: each leaves
the same share of the error, so that two steps s1 and s2 tell the error that remains,
s2^2 / s1. A system whose steps do not tell that it is solved is returned as unsolved;
a few that are nearly solved do not keep the others waiting.

Slopes and their factors are in single precision: a step's direction needs six digits.
The equations are in double precision, and so are the solutions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from oed.base.arrays import Array, Mask
from oed.mechanism.array_code.elimination import Elimination
from oed.mechanism.array_code.layout import Layout
from oed.mechanism.array_code.operations import memory
from oed.mechanism.array_code.tape import ArrayTape

#: step (m, rad) after which the slopes are kept
SHORT_STEP = 1e-4
#: share of a chunk's systems that may have longer steps then, or stay unsolved
FEW = 0.02
#: most steps with new slopes, and with kept ones
NEWTON_STEPS, CHORD_STEPS = 4, 3
#: error (m, rad) that the last step may leave
REMAINING_ERROR = 1e-15


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

    layout  as `layout` makes it
    angles  numbers of three unknowns in whose place slopes are over turns; a third
            output (3, 3) is then their change for turns (`oed.mechanism.twist`)
    """

    def __init__(self, layout: Layout, size: int, angles: Sequence[int] = ()) -> None:
        self._tape = ArrayTape(layout, size)
        self._value_calls = self._tape.calls_for([0])
        self._elimination = Elimination(layout.outputs[0], size, double=False)
        self._unknown = self._tape.inputs[: layout.varying]
        self._angles = list(angles)
        self._products = memory((3, 3, size), kind=np.float32)

    @staticmethod
    def layout(function: Any, unknown: int) -> Layout:
        """Layout of an SX function of value (k,) and slope (k, k).

        unknown  number of leading inputs to solve for, of k entries together
        """
        return Layout(function, unknown, single=range(1, function.n_out()))

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
            self._tape.evaluate(self._value_calls)
            after = self._step()[:count]
            with np.errstate(all="ignore"):
                near = (after <= step_tolerance) & ~far
                solved |= near & (after**2 <= REMAINING_ERROR * before)
            unsolved = count - np.count_nonzero(solved | far)
            if unsolved <= FEW * count:
                break
            before = after
        values = [unknown[:, :count].T for unknown in self._unknown]
        return SolvedSystems(values, solved, near & ~solved)

    def _newton_steps(self, count: int, longest: float) -> tuple[Array, Mask]:
        """Steps with new slopes: sizes (count,) of the last, and which were too long."""
        far = np.zeros(count, dtype=bool)
        for step in range(NEWTON_STEPS):
            self._tape.evaluate()
            slope = self._tape.outputs[1]
            if step == 0:
                self._elimination.choose_order(slope)
            self._elimination.factorise(slope)
            size = self._step()[:count]
            far |= size > longest
            long = np.count_nonzero(size > SHORT_STEP)
            if long <= FEW * count or far.all():
                break
        return size, far

    def _step(self) -> Array:
        """Step with the slopes at hand; its size, the largest entry, at each point."""
        step = self._elimination.solve(self._tape.outputs[0])
        if self._angles:
            change = self._tape.outputs[2].reshape(3, 3, -1)  # column by column
            with np.errstate(all="ignore"):  # of systems without a solution
                np.multiply(change, step[self._angles, None], out=self._products)
                step[self._angles] = self._products.sum(axis=0)
        first = 0
        for unknown in self._unknown:
            unknown -= step[first : first + len(unknown)]
            first += len(unknown)
        np.abs(step, out=step)
        return np.asarray(step.max(axis=0), dtype=float)
