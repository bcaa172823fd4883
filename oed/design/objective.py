"""What weights on candidates are judged by: one criterion of one information matrix, or
several at once.

An objective is concave in the weights w. `Plain` is log phi(M0 + sum w_i A_i).
`oed.design.robust` has those of several machines at once. All the relaxation needs is
here: values, slopes, curvatures, and the bound that slopes give.
"""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from oed.arrays import Array, Index
from oed.design.blocks import information
from oed.design.criterion.protocol import Criterion, slopes


@dataclasses.dataclass(frozen=True)
class Tangent:
    """A line above the objective: every plan w' has a value of at most bound(sum_i w'_i
    slopes_i).

    value   the objective at the weights where the line was drawn
    slopes  (C,) along each candidate's weight, for all candidates
    """

    value: float
    slopes: Array
    held: float
    offset: float
    straight: bool = False

    def bound(self, carried: float) -> float:
        """offset + log(held + carried), or, straight, offset + held + carried."""
        if self.straight:
            return self.offset + self.held + carried
        return self.offset + float(np.log(max(self.held + carried, 1e-300)))


class Objective(Protocol):
    """A concave function of the candidates' weights. Weights are given for an active
    set of candidates.
    """

    @property
    def count(self) -> int: ...

    @property
    def directions(self) -> int: ...

    def value(self, active: Index, weights: Array) -> float:
        """At weights on the active candidates; -inf where a direction is unseen."""
        ...

    def line(self, active: Index, weights: Array) -> Tangent:
        """A line above the objective that touches it at the weights (nearly, where it
        is smoothed).
        """
        ...

    def newton(self, active: Index, weights: Array) -> tuple[Array, Array]:
        """Slopes (A,) and curvature (A, A) over the active candidates."""
        ...

    def sample(self, chosen: Index) -> Objective:
        """Over some of the candidates only."""
        ...

    def typical(self, weights: Array) -> float:
        """Size of the information at weights on all candidates, for a ridge."""
        ...

    def ridged(self, ridge: float) -> Objective:
        """With ridge * 1 added to the information held."""
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class Plain:
    """log phi(M0 + sum_i w_i X_i^T X_i) for blocks (C, k, n) and M0 `base` (n, n)."""

    criterion: Criterion
    blocks: Array
    base: Array

    @property
    def count(self) -> int:
        """Candidates."""
        return len(self.blocks)

    @property
    def directions(self) -> int:
        """Columns."""
        return int(self.blocks.shape[2])

    def at(self, active: Index, weights: Array) -> Array:
        """M (n, n)."""
        return np.asarray(self.base + information(self.blocks[active], weights))

    def value(self, active: Index, weights: Array) -> float:
        """log phi(M)."""
        return self.criterion.value(self.at(active, weights))

    def line(self, active: Index, weights: Array) -> Tangent:
        """The criterion's supporting line."""
        m = self.at(active, weights)
        value, root = self.criterion.support(m)
        held = float(np.sum((self.base @ root) * root))
        return Tangent(self.criterion.value(m), slopes(self.blocks, root), held, value)

    def newton(self, active: Index, weights: Array) -> tuple[Array, Array]:
        """Slopes and curvature of log phi."""
        m = self.at(active, weights)
        some = self.blocks[active]
        return slopes(some, self.criterion.support(m).root), self.criterion.curvature(
            m, some
        )

    def sample(self, chosen: Index) -> Plain:
        """Over some of the candidates only."""
        return dataclasses.replace(self, blocks=self.blocks[chosen])

    def typical(self, weights: Array) -> float:
        """Mean eigenvalue."""
        total = float(np.einsum("ckn,ckn,c->", self.blocks, self.blocks, weights))
        return float((total + np.trace(self.base)) / self.directions)

    def ridged(self, ridge: float) -> Plain:
        """With ridge * 1 held."""
        return dataclasses.replace(
            self, base=self.base + ridge * np.eye(len(self.base))
        )
