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

    inverse  (N, N) sparse, R^-1: lower triangular within each reading
    carried  share f
    reach    of what is carried along, in readings
    place    (N,) number of each reading in its run; its channels have the same
    shared   (N, K), S; a column may serve every run, whose errors are independent
    """

    inverse: sparse.csr_array
    carried: float
    reach: float
    place: Array
    shared: Array

    def unmixing(self, order: Index) -> tuple[Array, sparse.csr_array | None]:
        """Diagonal D (k,) of R = U D, and U^-1 (k, k), of readings in an order.

        None where U is 1: no channels have common sources. Where an error is carried
        along, D is 1 and U is R.
        """
        inverse = sparse.csr_array(self.inverse[order][:, order])
        if self.carried:
            return np.ones(len(order)), inverse
        diagonal = 1.0 / inverse.diagonal()
        if inverse.nnz == len(order):
            return diagonal, None
        return diagonal, sparse.csr_array(sparse.diags_array(diagonal) @ inverse)
