"""E, O3, kappa, O2 and O4: criteria of the least and the largest eigenvalue of M.

    log phi = a log l_min - b log l_max

    E   (a, b) = (1, 0)             O2 = 1 / kappa(H)   (1/2, 1/2)
    O3  (1/2, 0), sqrt(l_min)       O4                  (1, 1/2)

With b = 0 it is concave, because l_min(M') <= z^T M' z for any unit z. With b > 0 it is
not; `oed.design.condition` has bounds for it.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Array
from oed.design.criterion.power import PowerMean
from oed.design.criterion.protocol import Criterion, Support
from oed.design.criterion.shortlist import (
    evaluate_shortlist,
    rank_by_spread,
    rank_by_variance,
)

#: powers of the smooth criteria that lead there
POWERS = (1.0, 2.0, 4.0, 8.0, 16.0)
#: an eigenvalue below this share of the largest counts as zero
SINGULAR = 1e-15


@dataclasses.dataclass(frozen=True, eq=False)
class ExtremeEigenvalues:
    """a log l_min - b log l_max, with `least` a and `largest` b.

    A finite `p` smooths both ends as power means, (tr M^-p)^(-1/p) and (tr M^p)^(1/p).
    """

    least: float = 1.0
    largest: float = 0.0
    p: float = np.inf
    name: str = "E"
    smooth: bool = False

    @property
    def concave(self) -> bool:
        """Whether only the least eigenvalue counts."""
        return self.largest == 0.0

    def value(self, m: Array) -> float:
        """a log l_min - b log l_max."""
        eigenvalues = np.asarray(np.linalg.eigvalsh(m), dtype=float)
        return float(self.of_eigenvalues(eigenvalues[None])[0])

    def of_eigenvalues(self, eigenvalues: Array) -> Array:
        """log phi (C,) from ascending eigenvalues (C, n)."""
        smallest, top = eigenvalues[:, 0], eigenvalues[:, -1]
        regular = smallest > SINGULAR * top
        log_least = np.log(np.where(regular, smallest, 1.0))
        log_largest = np.log(np.maximum(top, 1e-300))
        if np.isfinite(self.p):
            floored = np.maximum(eigenvalues, SINGULAR * eigenvalues[:, -1:])
            low_powers = (floored / floored[:, :1]) ** -self.p
            high_powers = (floored / floored[:, -1:]) ** self.p
            log_least = log_least - np.log(np.mean(low_powers, axis=1)) / self.p
            log_largest = log_largest + np.log(np.mean(high_powers, axis=1)) / self.p
        value = self.least * log_least - self.largest * log_largest
        return np.where(regular, value, -np.inf)

    def support(self, m: Array) -> Support:
        """The line through the eigenvector of the least eigenvalue, for E alone."""
        if not self.concave or self.least != 1.0:
            raise ValueError(
                f"{self.name} has no supporting line: see oed.design.condition"
            )
        return Support(0.0, np.asarray(np.linalg.eigh(m)[1][:, :1]))

    def curvature(self, m: Array, blocks: Array) -> Array:
        """Raises ValueError: the criterion is not smooth."""
        raise ValueError(f"{self.name} is not smooth: follow its continuation")

    def values_after_adding(self, m: Array, blocks: Array) -> Array:
        """By the eigenvalues of a shortlist."""
        eigenvalues, eigenvectors = np.linalg.eigh(m)
        ranks = [rank_by_variance(eigenvalues, eigenvectors, blocks)]
        if self.largest > 0.0:
            ranks.append(
                rank_by_spread(eigenvalues, eigenvectors, blocks, self.largest)
            )
        return evaluate_shortlist(self.of_eigenvalues, m, blocks, *ranks)

    def conventional_value(self, value: float, readings: int) -> float:
        """l_min, kappa, or the index."""
        return float(np.exp(-value if self.name == "kappa" else value))

    def restrict(self, basis: Array) -> Criterion:
        """Itself: the matrix alone changes."""
        return self

    def continuation(self) -> tuple[Criterion, ...]:
        """Power means first."""
        if self.concave:
            return (*(PowerMean(p) for p in POWERS), self)
        smoothed = [dataclasses.replace(self, p=p) for p in POWERS[1:]]
        return (PowerMean(1.0), *smoothed, self)
