"""Triangular root of errors that follow each other along chains, by a banded matrix.

A chain has the error single_i + carried_i, with `single` independent and `carried` an
Ornstein-Uhlenbeck process:

    carried_i = d_i carried_b(i) + sqrt(1 - d_i^2) a white_i,

b(i) the reading before in the chain, d_i its decay to there (0 for the first). With D
the differences x_i - d_i x_b(i), T = D C D^T relates neighbours alone, so that

    C = D^-1 T D^-T,    W = L^-1 D,    T = L L^T,    W C W^T = 1,

is linear in the number of readings. W is lower triangular: the inverse of Cholesky's
root of C. Where chains stand one after the other, T is tridiagonal; products alone need
no root of it: X^T C^-1 Y = (D X)^T T^-1 D Y.
"""

from __future__ import annotations

import functools

import numpy as np
from scipy import linalg, sparse
from scipy.linalg import lapack
from scipy.sparse import linalg as sparse_linalg

from oed.base.arrays import Array, Index

#: rows of a block
ROWS = 32


class ChainFactor:
    """Inverse of the covariance of N errors of chains that stand one after the other."""

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
            factor = lapack.dpttrf(variance, -related)
            self._variance, self._slope, failed = factor
            if failed:
                raise np.linalg.LinAlgError("the noise has no positive variance")

    @property
    def log_variances(self) -> Array:
        """Logs (N,) of the variance of each error, given those before it."""
        return np.asarray(np.log(self._variance))

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


class BandedFactor:
    """Root of the covariance of N errors along chains."""

    def __init__(
        self, before: Index, decay: Array, single: Array, fresh: Array
    ) -> None:
        """Factor the covariance.

        before  (N,) the reading before in the chain; itself for the first
        decay   (N,) what stays of what is carried there; 0 for the first
        single  (N,) variances of what is not carried
        fresh   (N,) variances of what joins it: a^2 (1 - d^2)

        Raises LinAlgError where the covariance is not positive definite.
        """
        self._before, self._decay = before, decay
        band = _band_of_chains(before, decay, single, fresh)
        self._band = linalg.cholesky_banded(band, lower=True, check_finite=False)
        #: log determinant of the covariance
        self.log_det = 2.0 * float(np.log(self._band[0]).sum())

    def whiten(self, values: Array) -> Array:
        """W Y (N, m), for Y (N, m).

        Row after row is slow where rows are short, and column after column where they
        are long: a block of rows is a product with a small matrix.
        """
        white = np.empty(values.shape)
        width, first = self._width, 0
        stack = np.zeros((ROWS + 2 * width, values.shape[1]))
        for matrix in self._blocks:
            last = min(first + ROWS, len(values))
            count, tail = last - first, max(first - width, 0)
            stack[:count] = values[first:last]
            stack[ROWS : ROWS + first - tail] = values[tail:first]
            stack[ROWS + width : ROWS + width + first - tail] = white[tail:first]
            np.matmul(matrix[:count], stack, out=white[first:last])
            first = last
        return white

    @functools.cached_property
    def _blocks(self) -> Array:
        """Matrices (B, ROWS, ROWS + 2 w) of blocks of rows.

        They take a block's values, the w values before it and these whitened to the
        block whitened: y = L^-1 (D x - D' x' - L' y').
        """
        size, width = len(self._decay), self._width
        count = -(-size // ROWS)
        padded = np.zeros((width + 1, count * ROWS))
        padded[0, size:] = 1.0
        padded[:, :size] = self._band
        roots = padded.reshape(width + 1, count, ROWS)
        decay = np.zeros(count * ROWS)
        decay[:size] = self._decay
        gap = np.zeros(count * ROWS, dtype=np.intp)
        gap[:size] = np.arange(size) - self._before
        right = np.zeros((count, ROWS, ROWS + 2 * width))
        right[:, np.arange(ROWS), np.arange(ROWS)] = 1.0
        block, row = np.divmod(np.flatnonzero(decay), ROWS)
        # what lies before the block stands after its own values, in order
        at = row - gap[decay != 0.0]
        right[block, row, np.where(at < 0, ROWS + at + width, at)] = -decay[
            decay != 0.0
        ]
        for k in range(1, width + 1):
            before = roots[
                k, :-1, ROWS - k :
            ]  # L of rows 0 ... k - 1 of the next block
            for i in range(k):
                right[1:, i, ROWS + width + width - k + i] -= before[:, i]
        for i in range(ROWS):
            for k in range(1, min(i, width) + 1):
                right[:, i] -= roots[k, :, i - k, None] * right[:, i - k]
            right[:, i] /= roots[0, :, i, None]
        return right

    @property
    def _width(self) -> int:
        return len(self._band) - 1

    def unwhiten(self, values: Array) -> Array:
        """W^-1 Y (N, m), for Y (N, m): errors of covariance C from white ones."""
        band, size = self._band, len(self._decay)
        steps = range(min(len(band), size))
        errors = np.zeros_like(values)
        for k in steps:
            errors[k:] += band[k, : size - k, None] * values[: size - k]
        return np.asarray(sparse_linalg.spsolve_triangular(self._differences, errors))

    def whiten_back(self, values: Array) -> Array:
        """W^T Y (N, m), for Y (N, m)."""
        solved = self._solve(np.array(values, order="F"), "T")
        return np.asarray(self._differences.T @ solved)

    def precision_diagonal(self) -> Array:
        """Diagonal (N,) of C^-1 = D^T T^-1 D."""
        inverse = _banded_inverse(self._band)
        diagonal = inverse[0].copy()
        rows = np.flatnonzero(self._decay)
        at, decay = self._before[rows], self._decay[rows]
        np.add.at(diagonal, at, decay**2 * inverse[0, rows])
        np.add.at(diagonal, at, -2.0 * decay * inverse[rows - at, at])
        return np.asarray(diagonal)

    def _solve(self, values: Array, trans: str) -> Array:
        """L^-1 Y or L^-T Y, in the memory of Y (N, m), which is in Fortran order."""
        if len(self._band) == 1:
            values /= self._band[0, :, None]
            return values
        if not values.shape[1]:
            return values
        solved, _ = lapack.dtbtrs(
            self._band, values, uplo="L", trans=trans, overwrite_b=True
        )
        return np.asarray(solved)

    @property
    def _differences(self) -> sparse.csr_array:
        """D (N, N)."""
        return _differences(self._before, self._decay)


def _differences(before: Index, decay: Array) -> sparse.csr_array:
    size = len(decay)
    rows = np.flatnonzero(decay)
    matrix = sparse.coo_array((-decay[rows], (rows, before[rows])), shape=(size, size))
    return sparse.csr_array(matrix + sparse.eye_array(size))


def sums_along_chains(before: Index, decay: Array, values: Array) -> Array:
    """D^-T Y (N, m), for Y (N, m): what each fresh error adds to sums of the errors."""
    differences = _differences(before, decay).T.tocsr()
    solved = sparse_linalg.spsolve_triangular(
        differences, values, lower=False, unit_diagonal=True
    )
    return np.asarray(solved)


def _band_of_chains(
    before: Index, decay: Array, variance: Array, fresh: Array
) -> Array:
    """T in LAPACK's lower band storage, for independent errors of single readings."""
    size = len(decay)
    rows = np.flatnonzero(decay)
    at = before[rows]
    width = int((rows - at).max(initial=0))
    band = np.zeros((width + 1, size))
    band[0] = variance + fresh
    band[0, rows] += decay[rows] ** 2 * variance[at]
    band[rows - at, at] = -decay[rows] * variance[at]
    return band


def along_chains(decay: Array, fresh: Array) -> Array:
    """Errors e_k = d_k e_k-1 + fresh_k (N,), of decays (N,): 0 for the first of a chain."""
    band = np.vstack([np.ones(len(decay)), -np.append(decay[1:], 0.0)])
    errors, _ = lapack.dtbtrs(band, fresh[:, None], uplo="L", diag="U")
    return np.asarray(errors[:, 0])


def _banded_inverse(band: Array) -> Array:
    """Diagonals (b + 1, N) of (L L^T)^-1, for L in lower band storage (b + 1, N).

    From the last reading on (Takahashi, Fagan and Chin 1973): with Z the inverse,
    Z_ij = [i = j] / L_ii^2 - sum_k>i L_ki Z_kj / L_ii for j >= i.
    """
    width, size = len(band) - 1, band.shape[1]
    inverse = np.zeros_like(band)
    after = np.zeros((width, width))  # Z of the readings that follow
    for i in range(size - 1, -1, -1):
        weight = band[1:, i] / band[0, i]
        row = -weight @ after
        first = 1.0 / band[0, i] ** 2 - weight @ row
        inverse[0, i], inverse[1:, i] = first, row
        if width:
            after[1:, 1:] = after[:-1, :-1].copy()
            after[0, 0], after[0, 1:], after[1:, 0] = first, row[:-1], row[:-1]
    return inverse
