"""Scan statistic of regions: the energy of the residual that each of them explains.

Each region is a basis B (N, k) of what a fault in one place can do to the readings. Its
statistic is

    T = r^T M B (B^T M B)^-1 B^T M r,    M = (Sigma + H Lambda H^T)^-1,

a chi-square of rank(B) degrees of freedom without a gap, so that p-values compare
regions with different numbers of columns. A parametric bootstrap of the least p-value
(Westfall and Young 1993, single step) corrects them for the whole family: r* ~ N(0,
Sigma + H Lambda H^T), in which M refits the parameters each time. Beyond the
bootstrap's resolution Bonferroni's bound holds.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from oed.arrays import Array, Mask
from oed.gap.data.metric import Embedding
from oed.gap.data.tail import log_tail
from oed.gap.place.regions import Region

#: share of a direction's energy that must survive the calibration, and be no other
#: column's, for it to count as a column
SURVIVES = 1e-4
#: columns of regions that are computed together
TOGETHER = 128


class Scan:
    """Energies that regions explain, computed for a few regions at a time.

    Regions with as many columns are computed together, and their bases, which take far
    more memory than all else, are not kept.
    """

    def __init__(
        self, embedding: Embedding, regions: Iterable[Region], scores: Array
    ) -> None:
        """Scan the regions for scores (N, m), of one set of readings a column."""
        self._embedding, self._scores = embedding, scores
        #: the regions, without their bases
        self.regions: list[Region] = []
        ranks: list[float] = []
        energies: list[Array] = []
        waiting: dict[int, list[tuple[int, Array]]] = {}
        for number, region in enumerate(regions):
            self.regions.append(region.without_basis())
            ranks.append(0.0)
            energies.append(np.zeros(scores.shape[1]))
            width = region.basis.shape[1]
            alike = waiting.setdefault(width, [])
            alike.append((number, region.basis))
            if len(alike) * width >= TOGETHER:
                self._compute(waiting.pop(width), energies, ranks)
        for alike in waiting.values():
            self._compute(alike, energies, ranks)
        #: (regions, m)
        self.energy = np.array(energies).reshape(-1, scores.shape[1])
        #: (regions,) degrees of freedom
        self.rank = np.array(ranks)

    def _compute(
        self,
        alike: Sequence[tuple[int, Array]],
        energies: list[Array],
        ranks: list[float],
    ) -> None:
        """Energies and ranks of regions, by their numbers and bases (N, k)."""
        stack = _embedded(self._embedding, np.hstack([basis for _, basis in alike]))
        stack = stack.T.reshape(len(alike), -1, len(stack))
        directions, rank = _orthonormal(stack)
        squared = np.square(directions.reshape(-1, stack.shape[2]) @ self._scores)
        by_region = squared.reshape(len(alike), -1, squared.shape[1]).sum(axis=1)
        for (number, _), energy, degrees in zip(alike, by_region, rank, strict=True):
            energies[number], ranks[number] = energy, float(degrees)

    def log_least(self, energy: Array, family: Mask) -> Array:
        """Log (m,) of the least p-value of a family (regions,) at energies (regions, m)."""
        ranks = np.unique(self.rank[family])
        largest = []
        for rank in ranks:
            alike = family & (self.rank == rank)
            largest.append(energy[alike].max(axis=0))
        tails = log_tail(np.array(largest), ranks[:, None])
        return np.asarray(tails.min(axis=0))


def _embedded(embedding: Embedding, bases: Array) -> Array:
    """Columns in the embedding, of unit length before the parameters absorb."""
    white = embedding.whiten(bases)
    size = np.linalg.norm(white, axis=0)
    return embedding.absorb(white) / np.where(size > 0.0, size, 1.0)


def _orthonormal(stack: Array) -> tuple[Array, Array]:
    """Orthonormal directions (g, k, N) of bases (g, k, N), and their ranks (g,).

    Directions that do not survive are zero.
    """
    gram = stack @ stack.transpose(0, 2, 1)
    values, vectors = np.linalg.eigh(gram)
    survives = values > SURVIVES
    roots = np.sqrt(np.where(survives, values, 1.0))
    factor = np.where(survives, 1.0 / roots, 0.0)
    turned = (vectors * factor[:, None, :]).transpose(0, 2, 1)
    return turned @ stack, survives.sum(axis=1)


def corrected_p_values(
    log_p: Array,
    scan: Scan,
    energy: Array,
    known: Mask,
) -> Array:
    """p-values (regions,) corrected for all regions of a family.

    log_p    (regions,) logarithms of their single p-values
    energy   (regions, draws) of the scores of the bootstrap
    known    (regions,) which ask where a known effect acts: they are one family, the
             others are another
    """
    corrected = np.empty(len(log_p))
    for family in (known, ~known):
        if family.any():
            least = scan.log_least(energy, family)
            corrected[family] = _against_least(log_p[family], least)
    return corrected


def _against_least(log_p: Array, least: Array) -> Array:
    """p-values (regions,) of one family against the bootstrap's least ones.

    Both arguments are logarithms: (regions,) single p-values, (draws,) least ones.
    """
    below = np.searchsorted(np.sort(least), log_p, side="right")
    by_bootstrap = (1.0 + below) / (len(least) + 1.0)
    log_bound = np.minimum(log_p + np.log(len(log_p)), 0.0)
    with np.errstate(under="ignore"):
        return np.asarray(np.minimum(by_bootstrap, np.exp(log_bound)))
