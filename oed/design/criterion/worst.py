"""G: the largest predicted variance over the workspace, t_j = tr(W_j M^-1), phi = 1 /
max_j t_j.

Any weights lambda_j that sum to one give max_j t_j >= tr(sum_j lambda_j W_j M^-1), so a
supporting line of that mean variance bounds G. `sharp` q smooths the maximum as (sum_j
t_j^q)^(1/q); with pi_j = t_j^q / sum_j t_j^q,

    -d2 log phi / dw_i dw_j = sum_j pi_j C_j + q Cov_pi(g)

over the slopes g_j and curvatures C_j of the single variances.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array
from oed.design.criterion.protocol import (
    Criterion,
    Support,
    inverse,
    pairs,
    positive,
    products,
)
from oed.design.criterion.variance import Variance

#: exponents that lead from the mean variance to the largest
SHARP = (1.0, 4.0, 16.0, 64.0, 256.0)


@dataclasses.dataclass(frozen=True, eq=False)
class Worst:
    """Minus the largest of the variances of `factors` (J, r, n): W_j = F_j^T F_j. told:
    -max_j tr(W_j M^-1).
    """

    factors: Array
    sharp: float = np.inf
    name: str = "G"
    concave: bool = True

    @property
    def smooth(self) -> bool:
        """Whether the maximum is smoothed."""
        return bool(np.isfinite(self.sharp))

    def variances(self, m: Array) -> Array:
        """t_j (J,)."""
        moved = self.factors @ inverse(m)
        return np.asarray(np.einsum("jrn,jrn->j", moved, self.factors))

    def value(self, m: Array) -> float:
        """-log of the (smoothed) largest variance."""
        return -self._largest(self.variances(m)[:, None])[0] if positive(m) else -np.inf

    def _largest(self, t: Array) -> Array:
        """Log of the (smoothed) maximum over the first axis of (J, C)."""
        logs = np.log(np.maximum(t, 1e-300))
        top = logs.max(axis=0)
        if not self.smooth:
            return np.asarray(top)
        return np.asarray(
            top + np.log(np.exp(self.sharp * (logs - top)).sum(axis=0)) / self.sharp
        )

    def _shares(self, t: Array) -> Array:
        """pi_j (J,)."""
        logs = (self.sharp if self.smooth else SHARP[-1]) * np.log(
            np.maximum(t, 1e-300)
        )
        shares = np.exp(logs - logs.max())
        return np.asarray(shares / shares.sum())

    def support(self, m: Array) -> Support:
        """That of the mean variance with weights lambda_j = pi_j / t_j, normalised."""
        t = self.variances(m)
        weights = self._shares(t) / t
        weights /= weights.sum()
        mean = Variance(
            (self.factors * np.sqrt(weights)[:, None, None]).reshape(
                -1, self.factors.shape[2]
            )
        )
        return mean.support(m)

    def curvature(self, m: Array, blocks: Array) -> Array:
        """sum_j pi_j (2 tr(A_i M^-1 A_k S_j) - g_ji g_jk) + q Cov_pi(g)."""
        t = self.variances(m)
        shares = self._shares(t)
        moved = self.factors @ inverse(m)
        s = np.einsum("j,jrn,jrm->nm", shares / t, moved, moved)
        flat = np.einsum("ckn,jrn->cjkr", blocks, moved, optimize=True)
        g = np.einsum("cjkr,cjkr->jc", flat, flat) / t[:, None]
        mean = shares @ g
        return np.asarray(
            2.0 * pairs(blocks, inverse(m), s)
            - (g.T * shares) @ g
            + self.sharp * ((g.T * shares) @ g - np.outer(mean, mean))
        )

    def added(self, m: Array, blocks: Array) -> Array:
        """Each variance less what the block saves of it."""
        inverted = inverse(m)
        moved = self.factors @ inverted
        inner = np.linalg.inv(products(blocks, inverted) + np.eye(blocks.shape[1]))
        seen = np.einsum("ckn,jrn->cjkr", blocks, moved, optimize=True)
        drop = np.einsum("cjkr,ckl,cjlr->jc", seen, inner, seen, optimize=True)
        t = np.einsum("jrn,jrn->j", moved, self.factors)
        return -self._largest(t[:, None] - drop)

    def told(self, value: float, readings: int) -> float:
        """-max_j tr(W_j M^-1)."""
        return -float(np.exp(-value))

    def within(self, basis: Array) -> Criterion:
        """The variances of what the basis sees."""
        return dataclasses.replace(self, factors=self.factors @ basis)

    def ladder(self) -> tuple[Criterion, ...]:
        """Smoothed maxima, sharper and sharper, then the maximum."""
        return (
            *(dataclasses.replace(self, sharp=q) for q in SHARP),
            dataclasses.replace(self, sharp=np.inf),
        )
