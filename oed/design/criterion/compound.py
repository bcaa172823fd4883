"""Compound criteria: log phi = sum_k alpha_k log phi_k, a weighted mean of
efficiencies.

By Jensen's inequality sum_k alpha_k (v_k + log <S_k, M'>) <= sum_k alpha_k v_k + log
<sum_k alpha_k S_k, M'>, so the supports join into one.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array
from oed.design.criterion.protocol import Criterion, Support


@dataclasses.dataclass(frozen=True, eq=False)
class Compound:
    """Criteria with shares (positive, sum 1). told: the weighted log phi."""

    parts: tuple[Criterion, ...]
    shares: tuple[float, ...]
    name: str = "compound"

    def __post_init__(self) -> None:
        if (
            len(self.parts) != len(self.shares)
            or min(self.shares) <= 0
            or abs(sum(self.shares) - 1.0) > 1e-9
        ):
            raise ValueError(
                "a compound criterion needs one positive share a part, summing to 1,"
                f" not {self.shares}"
            )

    @property
    def concave(self) -> bool:
        """Whether every part is."""
        return all(c.concave for c in self.parts)

    @property
    def smooth(self) -> bool:
        """Whether every part is."""
        return all(c.smooth for c in self.parts)

    def value(self, m: Array) -> float:
        """Weighted mean of the parts."""
        return float(
            sum(a * c.value(m) for a, c in zip(self.shares, self.parts, strict=True))
        )

    def support(self, m: Array) -> Support:
        """The parts' supports, joined."""
        supports = [c.support(m) for c in self.parts]
        value = sum(a * s.value for a, s in zip(self.shares, supports, strict=True))
        # each line is scaled to <S, M> = 1 first, which makes the joined one touch at M
        roots = []
        for a, s in zip(self.shares, supports, strict=True):
            size = float(np.sum((m @ s.root) * s.root))
            value += a * np.log(size)
            roots.append(np.sqrt(a / size) * s.root)
        return Support(float(value), np.hstack(roots))

    def curvature(self, m: Array, blocks: Array) -> Array:
        """Weighted sum."""
        return self._sum([c.curvature(m, blocks) for c in self.parts])

    def added(self, m: Array, blocks: Array) -> Array:
        """Weighted sum, over the blocks that all parts tell."""
        return self._sum([c.added(m, blocks) for c in self.parts])

    def _sum(self, tables: Sequence[Array]) -> Array:
        return np.asarray(sum(a * t for a, t in zip(self.shares, tables, strict=True)))

    def told(self, value: float, readings: int) -> float:
        """As it is."""
        return value

    def within(self, basis: Array) -> Criterion:
        """Each part over the directions seen."""
        return dataclasses.replace(
            self, parts=tuple(c.within(basis) for c in self.parts)
        )

    def ladder(self) -> tuple[Criterion, ...]:
        """Step by step up the parts' ladders."""
        ladders = [c.ladder() for c in self.parts]
        steps = max(map(len, ladders))
        rungs = [
            tuple(x[min(k * len(x) // steps, len(x) - 1)] for x in ladders)
            for k in range(steps - 1)
        ]
        return (*(dataclasses.replace(self, parts=r) for r in rungs), self)
