"""What is known of a machine at some point of a plan: one covariance, or those of many
drawn machines.

While every reading can be taken, one covariance S tells all. Where readings may be
lost, machines are drawn, and each is carried on by itself: its own covariance (what the
controller believes after the readings this machine could give) and its own error (how
far its true parameters are from those believed). A machine loses readings because it is
far off, and so is farther off afterwards than its covariance says; both its next losses
and its accuracy follow from its error.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array, Mask


@dataclasses.dataclass(frozen=True, eq=False)
class Known:
    """Machines with covariances `kinds` (P, n, n), all equally likely, in tolerance
    units.

    errors  (P, n) true less believed parameters of each; None where they are N(0, kind)
    lost    (P,) which of them have lost readings
    square  (n, n) mean square of the errors, by which accuracy is judged
    """

    kinds: Array
    errors: Array | None
    lost: Mask
    square: Array

    @property
    def columns(self) -> int:
        """Parameters n."""
        return int(self.kinds.shape[1])

    def repeated(self, each: int) -> tuple[Array, Array | None, Mask]:
        """Kinds, errors and losses with every machine taken `each` times, one machine
        after the other.
        """
        errors = None if self.errors is None else np.repeat(self.errors, each, axis=0)
        return np.repeat(self.kinds, each, axis=0), errors, np.repeat(self.lost, each)

    def drawn(self, each: int, rng: np.random.Generator) -> tuple[Array, Array, Mask]:
        """The same with errors, drawn where they are not there."""
        kinds, errors, lost = self.repeated(each)
        if errors is None:
            errors = np.einsum(
                "pnm,pm->pn", roots(kinds), rng.standard_normal(kinds.shape[:2])
            )
        return kinds, errors, lost


def known(before: Array | Known) -> Known:
    """A covariance (n, n), or kinds (P, n, n), as what is known; what is known as it
    is.
    """
    if isinstance(before, Known):
        return before
    kinds = before[None] if before.ndim == 2 else before
    return Known(
        kinds, None, np.zeros(len(kinds), dtype=bool), np.asarray(kinds.mean(axis=0))
    )


def roots(covariances: Array) -> Array:
    """R (P, n, n) with R R^T = covariances, positive semidefinite up to rounding."""
    values, vectors = np.linalg.eigh(covariances)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])
