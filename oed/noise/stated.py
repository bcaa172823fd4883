"""Stated errors that are not independent: of channels, of a run, carried along it.

In units of each reading's stated noise, the readings of a run have the correlation

    R [ (1 - f) 1 + f exp(-|k - l| / reach) ] R^T + S S^T,

R relates the channels of a reading (common sources), f is the share that is carried
along (k, l count the readings of a run), and S are the errors that a run shares.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import sparse

from oed.base.arrays import Array, Index


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class StatedErrors:
    """Stated errors of N readings.

    root     (N, N) sparse, R: lower triangular within each reading
    inverse  (N, N) sparse, R^-1
    carried  share f
    reach    of what is carried along, in readings
    place    (N,) number of each reading in its run; its channels have the same
    line     (N,) channel of each reading, whose carried error is its own
    shared   (N, K), S; a column may serve every run, whose errors are independent
    """

    root: sparse.csr_array
    inverse: sparse.csr_array
    carried: float
    reach: float
    place: Array
    line: Index
    shared: Array

    def correlation(self, members: Index) -> Array:
        """Correlation (k, k) of readings of one run."""
        root = self.root[members][:, members].toarray()
        distance = np.abs(self.place[members, None] - self.place[members])
        same = self.line[members, None] == self.line[members]
        along = self.carried * np.exp(-distance / self.reach) * same
        along += (1.0 - self.carried) * np.eye(len(members))
        shared = self.shared[members]
        return np.asarray(root @ along @ root.T + shared @ shared.T)

    def single(self, order: Index, root: Array) -> Array | sparse.csr_array:
        """Covariance of V^1/2 R x of independent x, with V^1/2 the `root` (k,).

        Variances (k,) where R is diagonal, or sparse (k, k), of readings in an order.
        Nothing is carried along.
        """
        mixing = sparse.diags_array(root) @ self.root[order][:, order]
        if mixing.nnz == len(order):
            return mixing.diagonal() ** 2
        return sparse.csr_array(mixing @ mixing.T)

    def unmix(self, order: Index, root: Array) -> sparse.csr_array:
        """(V^1/2 R)^-1 (k, k) of readings in an order, with V^1/2 the `root` (k,)."""
        inverse = self.inverse[order][:, order]
        return sparse.csr_array(inverse @ sparse.diags_array(1.0 / root))
