"""Newton's method on many small systems of equations at once, entry by entry.

A chunk of systems takes every step together, and its memory stays in the processor's
cache. Once the last step is short, further steps keep its slopes (the chord method;
Ortega and Rheinboldt 1970, section 7.1) and evaluate the equations alone: each leaves
the same share of the error, so that two steps s1 and s2 tell the error that remains,
s2^2 / s1. A system whose steps do not tell that it is solved is returned as unsolved.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from oed.array_elimination import Elimination
from oed.array_tape import ArrayTape
from oed.arrays import Array, Mask

#: step (m, rad) after which the slopes are kept
SHORT_STEP = 1e-4
#: share of a chunk's systems that may have longer steps then
FEW = 0.02
#: most steps with new slopes, and with kept ones
NEWTON_STEPS, CHORD_STEPS = 4, 3
#: error (m, rad) that the last step may leave
REMAINING_ERROR = 1e-15


class ArrayNewton:
    """Newton's method for `size` systems of equations.

    function  SX function of value (k,) and slope (k, k) over the first `unknown` inputs
    unknown   number of leading inputs to solve for, of k entries together
    """

    def __init__(self, function: Any, size: int, unknown: int) -> None:
        self._tape = ArrayTape(function, size, unknown)
        self._value_calls = self._tape.calls_for(0)
        self._elimination = Elimination(function.numel_out(0), size)
        self.size = size
        self._unknown = self._tape.inputs[:unknown]

    def solve(
        self, inputs: Sequence[Array], step_tolerance: float, longest: float
    ) -> tuple[list[Array], Mask]:
        """Solutions near `inputs` (n, entries) of up to `size` systems, and which hold.

        step_tolerance  longest last step (m, rad)
        longest         longest step (m, rad) of a system that this method may solve
        """
        count = len(inputs[0])
        for memory, values in zip(self._tape.inputs, inputs, strict=True):
            memory[:, :count] = values.T
            memory[:, count:] = values[:1].T
        self._tape.prepare()
        before, far = self._newton_steps(count, longest)
        solved = np.zeros(count, dtype=bool)
        for _ in range(CHORD_STEPS):
            self._tape.evaluate(self._value_calls)
            after = self._step()[:count]
            with np.errstate(all="ignore"):
                solved = (after <= step_tolerance) & (
                    after**2 <= REMAINING_ERROR * before
                )
            if solved.all():
                break
            before = after
        return [memory[:, :count].T for memory in self._unknown], solved & ~far

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
            if np.mean(size > SHORT_STEP) <= FEW or far.all():
                break
        return size, far

    def _step(self) -> Array:
        """Step with the slopes at hand; its size, the largest entry, at each point."""
        step = self._elimination.solve(self._tape.outputs[0])
        first = 0
        for memory in self._unknown:
            memory -= step[first : first + len(memory)]
            first += len(memory)
        return np.asarray(np.abs(step).max(axis=0))
