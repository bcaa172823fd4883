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

from collections.abc import Sequence

import numpy as np

from oed.arrays import Array, Index, Mask
from oed.gap.data.metric import Embedding
from oed.gap.data.tail import log_tail
from oed.gap.place.regions import Region

#: share of a direction's energy that must survive the calibration, and be no other
#: column's, for it to count as a column
SURVIVES = 1e-4


class Scan:
    """Bases of regions made orthonormal in the metric.

    Regions with as many columns are computed together.
    """

    def __init__(self, embedding: Embedding, regions: Sequence[Region]) -> None:
        #: numbers of the regions (g,) and their directions (g, k, N)
        self._parts: list[tuple[Index, Array]] = []
        #: (regions,) degrees of freedom
        self.rank = np.zeros(len(regions))
        widths = np.array([region.basis.shape[1] for region in regions])
        for width in np.unique(widths):
            numbers = np.asarray(np.flatnonzero(widths == width), dtype=np.intp)
            bases = np.hstack([regions[int(k)].basis for k in numbers])
            stack = _embedded(embedding, bases)
            stack = stack.T.reshape(len(numbers), width, -1)
            directions, rank = _orthonormal(stack)
            self._parts.append((numbers, directions))
            self.rank[numbers] = rank

    def energy(self, scores: Array) -> Array:
        """Energy (regions, m) of scores (N, m) that each region explains."""
        count = scores.shape[1]
        energy = np.empty((len(self.rank), count))
        for numbers, directions in self._parts:
            flat = directions.reshape(-1, directions.shape[-1])
            squared = np.square(flat @ scores)
            by_region = squared.reshape(len(numbers), -1, count)
            energy[numbers] = by_region.sum(axis=1)
        return energy

    def energy_of(self, scores: Array) -> Array:
        """Energy (regions,) of one vector of scores (N,)."""
        return np.asarray(self.energy(scores[:, None])[:, 0])

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
    draws: Array,
    known: Mask,
) -> Array:
    """p-values (regions,) corrected for all regions of a family.

    log_p    (regions,) logarithms of their single p-values
    draws    (N, draws) scores of the bootstrap
    known    (regions,) which ask where a known effect acts: they are one family, the
             others are another
    """
    energy, corrected = scan.energy(draws), np.empty(len(log_p))
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
