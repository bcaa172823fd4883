"""Single rules of a plan: its time, its set-ups, and the distance of its readings."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from oed.base import Array, Index, Mask


@dataclasses.dataclass(frozen=True, eq=False)
class ReadingTimes:
    """Time of C candidates, s: `cost` (C,) limits no plan by itself."""

    cost: Array

    def subset(self, pool: Index) -> ReadingTimes:
        """The times of a part of the candidates."""
        return dataclasses.replace(self, cost=self.cost[pool])


@dataclasses.dataclass(frozen=True, eq=False)
class TimeBudget(ReadingTimes):
    """Time of C candidates, `cost` (C,), of which a plan may take `available`; s."""

    available: float

    def __post_init__(self) -> None:
        if not (np.asarray(self.cost) > 0).all():
            raise ValueError("a budget needs the positive cost of every candidate")

    def allows(self, seconds: Array) -> Mask:
        """Which times of plans, s, fit into the budget."""
        return np.asarray(seconds <= self.available * (1 + 1e-12))

    def total(self, candidates: Index, mounting: float = 0.0) -> float:
        """Time for readings of the candidates after mounting, s, at the most."""
        cost = self.cost[candidates]
        return float(min(self.available - mounting, cost.sum()))


@dataclasses.dataclass(frozen=True, eq=False)
class SetupLimit:
    """Set-ups of C candidates, the time to mount them, and how many there may be.

    setup    (C,) number of the set-up of each candidate
    seconds  (S,) time to mount each set-up, s, paid once; None where that is no rule
    most     number of set-ups at the most; None: any number
    mounted  set-ups that are mounted already: they cost nothing and do not count
    """

    setup: Index
    seconds: Array | None = None
    most: int | None = None
    mounted: tuple[int, ...] = ()

    @property
    def mountable(self) -> Index:
        """Set-ups that are not mounted yet."""
        return self._to_mount(self.setup)

    def most_of(self, count: int) -> int:
        """The largest number of `count` set-ups that a plan may mount."""
        return min(self.most or count, count)

    def mounting_time(self, chosen: Index) -> float:
        """Time to mount the set-ups of a plan, s."""
        return self._seconds_of(self._to_mount(self.setup[chosen]))

    def mounting_times(self, chosen: Index) -> Array:
        """Time to mount (C,), s, that each candidate adds to a plan."""
        if self.seconds is None:
            return np.zeros(len(self.setup))
        return np.where(self._unmounted(chosen), self.seconds[self.setup], 0.0)

    def additions(self, chosen: Index) -> Mask:
        """Which of the candidates (C,) may join a plan."""
        free = np.ones(len(self.setup), dtype=bool)
        if self.most is None or len(self._to_mount(self.setup[chosen])) < self.most:
            return free
        return free & ~self._unmounted(chosen)

    def combinations(
        self, names: Index, sizes: Sequence[int]
    ) -> Iterator[tuple[Index, float]]:
        """Candidates of each combination of some set-ups, and its time to mount, s."""
        for size in sizes:
            for combination in itertools.combinations(names, size):
                allowed = [*combination, *self.mounted]
                candidates = np.flatnonzero(np.isin(self.setup, allowed))
                yield candidates, self._seconds_of(list(combination))

    def subset(self, pool: Index) -> SetupLimit:
        """The rule over a part of the candidates."""
        return dataclasses.replace(self, setup=self.setup[pool])

    def _seconds_of(self, setups: Index | list[int]) -> float:
        if self.seconds is None:
            return 0.0
        return float(self.seconds[setups].sum())

    def _to_mount(self, setups: Index) -> Index:
        """Set-ups of these, ascending, that are not mounted."""
        return np.setdiff1d(setups, np.array(self.mounted, dtype=np.intp))

    def _unmounted(self, chosen: Index) -> Mask:
        """Candidates whose set-up a plan does not mount."""
        mounted = np.array(self.mounted, dtype=np.intp)
        present = np.append(self._to_mount(self.setup[chosen]), mounted)
        return ~np.isin(self.setup, present)


@dataclasses.dataclass(frozen=True, eq=False)
class DistanceLimit:
    """Least distance of two readings of one set-up.

    position  (C, d) of each candidate, in units of its own
    least     least distance
    """

    position: Array
    least: float

    def too_near(self, member: int) -> Mask:
        """Candidates (C,) too near to one of them, whatever their set-up."""
        distance = np.linalg.norm(self.position - self.position[member], axis=1)
        return np.asarray(distance < self.least * (1 - 1e-9))

    def subset(self, pool: Index) -> DistanceLimit:
        """The rule over a part of the candidates."""
        return DistanceLimit(self.position[pool], self.least)
