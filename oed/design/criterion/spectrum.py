"""E, O3, kappa, O2 and O4: criteria of the least and the largest eigenvalue of M.

log phi = a log l_min - b log l_max: E (1, 0), O3 = sqrt(l_min) (1/2, 0), O2 = 1 /
kappa(H) (1/2, 1/2), O4 (1, 1/2). With b = 0 it is concave: l_min(M') <= z^T M' z for
any unit z. With b > 0 it is not; see `oed.design.condition` for bounds.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array
from oed.design.criterion.power import Power
from oed.design.criterion.protocol import Criterion, Support
from oed.design.criterion.shortlist import exactly, ranked, spared

#: powers of the smooth criteria that lead there
POWERS = (1.0, 2.0, 4.0, 8.0, 16.0)


@dataclasses.dataclass(frozen=True, eq=False)
class Spectrum:
    """a log l_min - b log l_max; `p` smooths both ends as power means, (tr M^-p)^(-1/p)
    and (tr M^p)^(1/p).
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
        return float(self.of(np.asarray(np.linalg.eigvalsh(m), dtype=float)[None])[0])

    def of(self, values: Array) -> Array:
        """log phi (C,) from ascending eigenvalues (C, n)."""
        sound = values[:, 0] > 1e-15 * values[:, -1]
        low, high = (
            np.log(np.where(sound, values[:, 0], 1.0)),
            np.log(np.maximum(values[:, -1], 1e-300)),
        )
        if np.isfinite(self.p):
            safe = np.maximum(values, 1e-15 * values[:, -1:])
            low = (
                low - np.log(np.mean((safe / safe[:, :1]) ** -self.p, axis=1)) / self.p
            )
            high = (
                high + np.log(np.mean((safe / safe[:, -1:]) ** self.p, axis=1)) / self.p
            )
        return np.where(sound, self.least * low - self.largest * high, -np.inf)

    def support(self, m: Array) -> Support:
        """The line through the eigenvector of the least eigenvalue. Only for b = 0 and
        a = 1.
        """
        if not self.concave or self.least != 1.0:
            raise ValueError(
                f"{self.name} has no supporting line: see oed.design.condition"
            )
        return Support(0.0, np.asarray(np.linalg.eigh(m)[1][:, :1]))

    def curvature(self, m: Array, blocks: Array) -> Array:
        """None: not smooth."""
        raise ValueError(f"{self.name} is not smooth: climb its ladder")

    def added(self, m: Array, blocks: Array) -> Array:
        """By eigenvalues of a shortlist."""
        values, vectors = np.linalg.eigh(m)
        ranks = [ranked(values, vectors, blocks)]
        if self.largest > 0.0:
            ranks.append(spared(values, vectors, blocks, self.largest))
        return exactly(self.of, m, blocks, *ranks)

    def told(self, value: float, readings: int) -> float:
        """l_min, kappa, or the index."""
        return float(np.exp(-value if self.name == "kappa" else value))

    def within(self, basis: Array) -> Criterion:
        """The same over the directions seen."""
        return self

    def ladder(self) -> tuple[Criterion, ...]:
        """Power means first."""
        if self.concave:
            return (*(Power(p) for p in POWERS), self)
        return (Power(1.0), *(dataclasses.replace(self, p=p) for p in POWERS[1:]), self)
