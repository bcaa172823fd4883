"""The last poses solved for each set-up, recalled where the same are needed again.

A fit needs the slopes of the readings where it has just computed the readings: at equal
joints, parameters and starts, the poses are equal.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Array


@dataclasses.dataclass(frozen=True)
class _Solution:
    """Arguments of a forward solution, copied, and the poses."""

    arguments: tuple[Array, ...]
    x: Array


class PoseCache:
    """One solution a set-up, compared by the values of its arguments."""

    def __init__(self) -> None:
        self._solutions: dict[str, _Solution] = {}

    def recall(self, setup: str, *arguments: Array) -> Array | None:
        """Poses stored for equal arguments; None where there are none."""
        solution = self._solutions.get(setup)
        if solution is None:
            return None
        pairs = zip(solution.arguments, arguments, strict=True)
        if all(np.array_equal(stored, given) for stored, given in pairs):
            return solution.x
        return None

    def store(self, setup: str, x: Array, *arguments: Array) -> None:
        """Store poses in place of the set-up's last ones; `x` becomes read-only."""
        x.flags.writeable = False
        copies = tuple(argument.copy() for argument in arguments)
        self._solutions[setup] = _Solution(copies, x)
