"""Triangular root of errors that follow each other along chains, in linear time.

A chain has the error single_i + carried_i, with `single` independent and `carried` an
Ornstein-Uhlenbeck process:

    carried_i = d_i carried_(i-1) + sqrt(1 - d_i^2) a white_i,

d_i its decay from the reading before (0 for the first). Chains stand one after the other.
With D the differences x_i - d_i x_(i-1), T = D C D^T relates neighbours alone, so that

    C = D^-1 T D^-T,    W = V^-1/2 L^-1 D,    T = L V L^T,    W C W^T = 1,

L unit lower bidiagonal and V diagonal. W is lower triangular: the inverse of Cholesky's
root of C. Products alone need no root: X^T C^-1 Y = (D X)^T T^-1 D Y.
"""

from __future__ import annotations

import functools

import numpy as np
from scipy.linalg import lapack

from oed.base.arrays import Array

#: rows of a block
ROWS = 32


class ChainFactor:
    """Root of the covariance of N errors of chains that stand one after the other."""

    def __init__(self, decay: Array, single: Array, fresh: Array) -> None:
        """Factor the covariance.

        decay   (N,) what stays of what is carried in the reading before; 0 for the first
        single  (N,) variances of what is not carried
        fresh   (N,) variances of what joins it: a^2 (1 - d^2)

        Raises LinAlgError where the covariance is not positive definite.
        """
        self._decay = decay[1:]
        related = self._decay * single[:-1]
        variance = single + fresh
        variance[1:] += self._decay * related
        self._variance, self._slope = variance, -related
        if len(related):  # LAPACK takes no single reading
            self._variance, self._slope, _ = lapack.dpttrf(variance, -related)
        if not (self._variance > 0.0).all():
            raise np.linalg.LinAlgError("the noise has no positive variance")

    @property
    def log_variances(self) -> Array:
        """Logs (N,) of the variance of each error, given those before it."""
        return np.asarray(np.log(self._variance))

    @functools.cached_property
    def _root(self) -> Array:
        """V^1/2 (N, 1)."""
        return np.sqrt(self._variance)[:, None]

    def halves(self, values: Array) -> tuple[Array, Array]:
        """D Y and T^-1 D Y (N, m), for Y (N, m): their products are those of C^-1."""
        differences = np.empty_like(values)
        differences[0] = values[0]
        np.multiply(values[:-1], -self._decay[:, None], out=differences[1:])
        differences[1:] += values[1:]
        if not len(self._slope):
            return differences, differences / self._variance[:, None]
        solved, _ = lapack.dpttrs(self._variance, self._slope, differences)
        return differences, np.asarray(solved)

    def whiten(self, values: Array) -> Array:
        """W Y (N, m), for Y (N, m).

        Row after row is slow where rows are short, and column after column where they
        are long: a block of rows is a product with a small matrix.
        """
        if not self._decay.any():
            return np.asarray(values / self._root)
        white = np.empty(values.shape)
        # values of a block, then the value before it as it was and whitened
        stack = np.zeros((ROWS + 2, values.shape[1]))
        for number, matrix in enumerate(self._blocks):
            first = number * ROWS
            count = min(ROWS, len(values) - first)
            stack[:count] = values[first : first + count]
            if first:
                stack[ROWS], stack[ROWS + 1] = values[first - 1], white[first - 1]
            np.matmul(matrix[:count], stack, out=white[first : first + count])
        return white

    @functools.cached_property
    def _blocks(self) -> Array:
        """Matrices (B, ROWS, ROWS + 2) that whiten blocks of rows."""
        size = len(self._variance)
        count = -(-size // ROWS)
        decay, slope = np.zeros((2, count, ROWS))
        root = np.ones((count, ROWS))
        decay.flat[1:size], root.flat[:size] = self._decay, self._root[:, 0]
        slope.flat[1:size] = self._slope * self._root[:-1, 0]
        every, later = np.arange(ROWS), np.arange(1, ROWS)
        right = np.zeros((count, ROWS, ROWS + 2))
        right[:, every, every] = 1.0
        right[:, later, later - 1] = -decay[:, 1:]
        right[:, 0, ROWS], right[:, 0, ROWS + 1] = -decay[:, 0], -slope[:, 0]
        right[:, 0] /= root[:, :1]
        for i in later:
            right[:, i] -= slope[:, i, None] * right[:, i - 1]
            right[:, i] /= root[:, i, None]
        return right

    def whiten_back(self, values: Array) -> Array:
        """W^T Y (N, m), for Y (N, m)."""
        back = _solved(self._slope, values / self._root, "T")
        back[:-1] -= self._decay[:, None] * back[1:]
        return back

    def unwhiten(self, values: Array) -> Array:
        """W^-1 Y (N, m), for Y (N, m): errors of covariance C from white ones."""
        errors = values * self._root
        errors[1:] += self._slope[:, None] * errors[:-1]
        return _solved(-self._decay, errors, "N")

    def precision_diagonal(self) -> Array:
        """Diagonal (N,) of C^-1 = D^T T^-1 D.

        From the last reading on (Takahashi, Fagan and Chin 1973), the inverse Z of T has
        Z_ii = 1 / V_i + L_(i+1)i^2 Z_(i+1)(i+1) and Z_(i+1)i = -L_(i+1)i Z_(i+1)(i+1).
        """
        backward = np.append(0.0, self._slope[::-1] ** 2)
        inverse = along_chains(backward, 1.0 / self._variance[::-1])[::-1].copy()
        later = self._decay * inverse[1:]
        inverse[:-1] += (self._decay + 2.0 * self._slope) * later
        return np.asarray(inverse)


def _solved(below: Array, values: Array, trans: str) -> Array:
    """B^-1 Y or B^-T Y (N, m), B the unit lower bidiagonal matrix of `below` (N - 1,)."""
    if not below.any() or not values.shape[1]:
        return values
    band = np.vstack([np.ones(len(values)), np.append(below, 0.0)])
    solved, _ = lapack.dtbtrs(band, values, uplo="L", trans=trans, diag="U")
    return np.asarray(solved)


def along_chains(decay: Array, fresh: Array) -> Array:
    """Errors e_k = d_k e_k-1 + fresh_k (N,), of decays (N,): 0 for the first of a chain."""
    return _solved(-decay[1:], fresh[:, None].copy(), "N")[:, 0]


def sums_along_chains(decay: Array, values: Array) -> Array:
    """D^-T Y (N, m), for Y (N, m): what each fresh error adds to sums of the errors."""
    return _solved(-decay[1:], values, "T")
