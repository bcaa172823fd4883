"""Compound criteria: log phi = sum_k alpha_k log phi_k, a mean of efficiencies.

By Jensen's inequality

    sum_k alpha_k (v_k + log <S_k, M'>) <= sum_k alpha_k v_k + log <sum_k alpha_k S_k, M'>,

so the supports of the parts join into one.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed.base import Array
from oed.design.forms.protocol import Criterion, Support


@dataclasses.dataclass(frozen=True, eq=False)
class Compound(Criterion):
    """Criteria with positive shares that sum to 1.

    Its conventional value is the weighted log phi.
    """

    parts: tuple[Criterion, ...]
    shares: tuple[float, ...]
    name: str = "compound"

    def __post_init__(self) -> None:
        complete = len(self.parts) == len(self.shares)
        sum_is_one = abs(sum(self.shares) - 1.0) <= 1e-9
        if not complete or min(self.shares) <= 0 or not sum_is_one:
            raise ValueError(
                "a compound criterion needs one positive share a part, summing to 1,"
                f" not {self.shares}"
            )

    @property
    def concave(self) -> bool:
        """Whether every part is concave."""
        return all(part.concave for part in self.parts)

    @property
    def smooth(self) -> bool:
        """Whether every part is smooth."""
        return all(part.smooth for part in self.parts)

    @property
    def spectral(self) -> bool:
        """Whether a part is."""
        return any(part.spectral for part in self.parts)

    def value(self, m: Array) -> float:
        """Weighted mean of the parts."""
        pairs = zip(self.shares, self.parts, strict=True)
        return float(sum(share * part.value(m) for share, part in pairs))

    def support(self, m: Array) -> Support:
        """The parts' supports, joined."""
        return join_supports(self.shares, [part.support(m) for part in self.parts], m)

    def curvature(self, m: Array, blocks: Array) -> Array:
        """Weighted sum of the parts' curvatures."""
        return self._sum([part.curvature(m, blocks) for part in self.parts])

    def values_after_adding(self, m: Array, blocks: Array) -> Array:
        """Weighted sum, over the blocks for which every part is computed."""
        return self._sum([part.values_after_adding(m, blocks) for part in self.parts])

    def _sum(self, tables: Sequence[Array]) -> Array:
        pairs = zip(self.shares, tables, strict=True)
        return np.asarray(sum(share * table for share, table in pairs))

    def conventional_value(self, value: float, readings: int) -> float:
        """log phi itself."""
        return value

    def restrict(self, basis: Array) -> Criterion:
        """Each part over the basis."""
        parts = tuple(part.restrict(basis) for part in self.parts)
        return dataclasses.replace(self, parts=parts)

    def continuation(self) -> tuple[Criterion, ...]:
        """Level by level along the parts' continuations."""
        sequences = [part.continuation() for part in self.parts]
        levels = max(map(len, sequences))
        approach = []
        for level in range(levels - 1):
            # of a shorter continuation, the member that goes with a level of the longest
            shares = [(s, min(level * len(s) // levels, len(s) - 1)) for s in sequences]
            parts = tuple(sequence[k] for sequence, k in shares)
            approach.append(dataclasses.replace(self, parts=parts))
        return (*approach, self)


def join_supports(
    shares: Sequence[float], supports: Sequence[Support], m: Array
) -> Support:
    """One line above a weighted sum of criteria, from their lines."""
    value = 0.0
    roots = []
    # scaling each line to <S, M> = 1 first makes the joined one touch at M
    for share, support in zip(shares, supports, strict=True):
        size = float(np.sum((m @ support.root) * support.root))
        value += share * (support.value + float(np.log(size)))
        roots.append(np.sqrt(share / size) * support.root)
    return Support(value, np.hstack(roots))


def compound(parts: Mapping[Criterion, float]) -> Criterion:
    """A mean of criteria by their shares, which need not sum to 1."""
    total = sum(parts.values())
    return Compound(tuple(parts), tuple(s / total for s in parts.values()))
