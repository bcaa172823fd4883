"""Roots of errors along chains and of errors that segments share, in linear time.

A chain has the error white_i + correlated_i, the first independent, the second an
Ornstein-Uhlenbeck process:

    correlated_i = d_i correlated_(i-1) + sqrt(1 - d_i^2) a e_i,

d_i its decay from the reading before (0 for the first). Chains stand one after the other.
With D the differences x_i - d_i x_(i-1), T = D C D^T relates neighbours alone, so that

    C = D^-1 T D^-T,    W = V^-1/2 L^-1 D,    T = L V L^T,    W C W^T = 1,

L unit lower bidiagonal and V diagonal. W is lower triangular: the inverse of Cholesky's
root of C.

Errors U that the readings of a segment share, beside white ones, are taken out one
column u after another: with c_i = 1 + sum_j<=i u_j^2 over the segment,

    y_i = sqrt(c_i-1 / c_i) (x_i - u_i / c_i-1 sum_j<i u_j x_j)

is white where x has the covariance I + u u^T. It is the inverse of Cholesky's root, and
costs a running sum. Inner products alone need no root: the Woodbury identity takes the
columns out, segment by segment.
"""

import functools
from collections.abc import Iterable, Iterator

import numpy as np
import scipy

from oed.base import Array, Index

BLOCK_ROWS = 32  #: rows of a block that are whitened by one product
#: columns up to which LAPACK, column after column, takes less time than blocks
MAX_SINGLE_COLUMNS = 8


class ChainFactor:
    """Root of the covariance of N errors of chains that stand one after the other."""

    def __init__(self, decay: Array, single: Array, fresh: Array) -> None:
        """Factor the covariance.

        decay   (N,) correlation with the error of the reading before; 0 for the first
        single  (N,) variances of the white part
        fresh   (N,) variances of what joins it: a^2 (1 - d^2)

        Raises LinAlgError where the covariance is not positive definite.
        """
        self._decay = decay[1:]
        related = self._decay * single[:-1]
        variance = single + fresh
        variance[1:] += self._decay * related
        self._variance, self._slope = variance, -related
        if len(related):  # LAPACK takes no single reading
            factors = scipy.linalg.lapack.dpttrf(variance, -related)
            self._variance, self._slope, _ = factors
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

    def whiten(self, values: Array) -> Array:
        """W Y (N, m), for Y (N, m).

        Row after row is slow where rows are short, and column after column where they
        are long: a block of rows is a product with a small matrix.
        """
        if not self._decay.any():
            return np.asarray(values / self._root)
        if values.shape[1] <= MAX_SINGLE_COLUMNS:
            changed = values.copy()
            changed[1:] -= self._decay[:, None] * values[:-1]
            return np.asarray(_solved(self._slope, changed, "N") / self._root)
        white = np.empty(values.shape)
        # values of a block, then the value before it as it was and whitened
        stack = np.zeros((BLOCK_ROWS + 2, values.shape[1]))
        for number, matrix in enumerate(self._blocks):
            first = number * BLOCK_ROWS
            count = min(BLOCK_ROWS, len(values) - first)
            stack[:count] = values[first : first + count]
            if first:
                stack[BLOCK_ROWS] = values[first - 1]
                stack[BLOCK_ROWS + 1] = white[first - 1]
            np.matmul(matrix[:count], stack, out=white[first : first + count])
        return white

    def whiten_chains(self, values: Array) -> Array:
        """The same of chains (C, T, m) of equal length, short rows all together."""
        chains, length, count = values.shape
        if length > BLOCK_ROWS:
            rows = values.reshape(chains * length, count)
            return self.whiten(rows).reshape(values.shape)
        decay, slope = np.zeros((2, chains, length, 1))
        decay.flat[1:], slope.flat[1:] = self._decay, self._slope
        white = values.copy()
        white[:, 1:] -= decay[:, 1:] * values[:, :-1]
        for k in range(1, length):
            white[:, k] -= slope[:, k] * white[:, k - 1]
        white /= self._root.reshape(chains, length, 1)
        return white

    def whiten_in_turn(self, parts: Iterable[Array]) -> Iterator[Array]:
        """W Y by parts (n, m) of long rows of Y, each overwritten."""
        decay, slope = np.append(0.0, self._decay), np.append(0.0, self._slope)
        before, last = np.zeros((2, 1))
        start = 0
        is_correlated = bool(self._decay.any())
        for values in parts:
            rows = slice(start, start + len(values))
            start = rows.stop
            if is_correlated:
                end = values[-1].copy()
                values[1:] -= decay[rows, None][1:] * values[:-1]
                values[0] -= decay[rows.start] * before
                before = end
                for value, factor in zip(values, slope[rows], strict=True):
                    value -= factor * last
                    last = value
                last = last.copy()
            values /= self._root[rows]
            yield values

    @functools.cached_property
    def _blocks(self) -> Array:
        """Matrices (B, BLOCK_ROWS, BLOCK_ROWS + 2) that whiten blocks of rows."""
        size = len(self._variance)
        count = -(-size // BLOCK_ROWS)
        decay, slope = np.zeros((2, count, BLOCK_ROWS))
        root = np.ones((count, BLOCK_ROWS))
        decay.flat[1:size], root.flat[:size] = self._decay, self._root[:, 0]
        slope.flat[1:size] = self._slope * self._root[:-1, 0]
        every, later = np.arange(BLOCK_ROWS), np.arange(1, BLOCK_ROWS)
        right = np.zeros((count, BLOCK_ROWS, BLOCK_ROWS + 2))
        right[:, every, every] = 1.0
        right[:, later, later - 1] = -decay[:, 1:]
        right[:, 0, BLOCK_ROWS] = -decay[:, 0]
        right[:, 0, BLOCK_ROWS + 1] = -slope[:, 0]
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
        inverse = chain_errors(backward, 1.0 / self._variance[::-1])[::-1].copy()
        later = self._decay * inverse[1:]
        inverse[:-1] += (self._decay + 2.0 * self._slope) * later
        return np.asarray(inverse)


def _solved(below: Array, values: Array, trans: str) -> Array:
    """B^-1 Y or B^-T Y (N, m), B the unit lower bidiagonal matrix of `below` (N - 1,)."""
    if not below.any() or not values.shape[1]:
        return values
    band = np.vstack([np.ones(len(values)), np.append(below, 0.0)])
    solved, _ = scipy.linalg.lapack.dtbtrs(
        band, values, uplo="L", trans=trans, diag="U"
    )
    return np.asarray(solved)


def chain_errors(decay: Array, fresh: Array) -> Array:
    """Errors e_k = d_k e_k-1 + fresh_k (N,), of decays (N,): 0 for the first of a chain."""
    return _solved(-decay[1:], fresh[:, None].copy(), "N")[:, 0]


def chain_sums(decay: Array, values: Array) -> Array:
    """D^-T Y (N, m), for Y (N, m): what each fresh error adds to sums of the errors."""
    return _solved(-decay[1:], values, "T")


class SharedFactor:
    """Lower triangular root of I + U U^T within each segment of N white readings."""

    def __init__(self, columns: Array, starts: Index, sign: float = 1.0) -> None:
        """Factor the covariance of columns U (N, K); `starts` (S,) of the segments.

        With the sign -1 it is that of I - U U^T.
        """
        self._starts, self._sign = starts, sign
        self._steps: list[tuple[Array, Array, Array]] = []
        remaining = columns
        for k in range(columns.shape[1]):
            u = remaining[:, k]
            if not u.any():
                continue
            before = 1.0 + sign * _sums_before(u[:, None] ** 2, starts)[:, 0]
            step = (u, before, before + sign * u**2)
            remaining = self._apply(step, remaining)
            self._steps.append(step)

    def whiten(self, values: Array) -> Array:
        """W Y (N, m), for Y (N, m)."""
        for step in self._steps:
            values = self._apply(step, values)
        return values

    def unwhiten(self, values: Array) -> Array:
        """W^-1 Y (N, m), for Y (N, m)."""
        for u, before, total in reversed(self._steps):
            share = self._sign * u / np.sqrt(before * total)
            drawn = _sums_before(share[:, None] * values, self._starts)
            alone = np.sqrt(total / before)[:, None] * values
            values = alone + u[:, None] * drawn
        return values

    def _apply(self, step: tuple[Array, Array, Array], values: Array) -> Array:
        u, before, total = step
        changed = _sums_before(u[:, None] * values, self._starts)
        changed *= (-self._sign * u / before)[:, None]
        changed += values
        changed *= np.sqrt(before / total)[:, None]
        return changed


class SharedProducts:
    """Woodbury's identity for I + U U^T, of N white readings in segments."""

    def __init__(self, columns: Array, starts: Index) -> None:
        """Prepare columns U (N, K); `starts` (S,) of the segments."""
        self._columns, self._starts = columns, starts
        #: (S, K, K) products U^T U of each segment
        self.inner = np.array([u.T @ u for u, _ in self._pairs(columns)])
        unit = np.eye(columns.shape[1])
        #: log determinant of the covariance
        self.log_det = float(np.linalg.slogdet(unit + self.inner)[1].sum())

    def root(self) -> Array:
        """V (N, K) with (I + U U^T)^-1 = I - V V^T within each segment."""
        size = self._columns.shape[1]
        factors = np.linalg.cholesky(np.eye(size) + self.inner)
        inverses = np.linalg.inv(factors).transpose(0, 2, 1)
        parts = zip(self._pairs(self._columns), inverses, strict=True)
        return np.concatenate([u @ inverse for (u, _), inverse in parts])

    def shared_part(self, values: Array) -> Array:
        """V V^T Y (N, m), for Y (N, m)."""
        roots = zip(self._pairs(values), self._pairs(self.root()), strict=True)
        return np.concatenate([v @ (v.T @ y) for (_, y), (_, v) in roots])

    def whiten(self, values: Array) -> Array:
        """W Y (N, m), in the memory of Y (N, m), with W = (I + U U^T)^-1/2 symmetric."""
        sizes, vectors = np.linalg.eigh(self.inner)
        sizes = np.maximum(sizes, 0.0)
        root = np.sqrt(1.0 + sizes)
        # (1 / root - 1) / sizes, without its difference
        change = vectors * (-1.0 / (root * (1.0 + root)))[:, None]
        sides = zip(self._pairs(values), change, vectors, strict=True)
        for (u, y), scaled, basis in sides:
            y += (u @ scaled) @ ((u @ basis).T @ y)
        return values

    def _pairs(self, values: Array) -> list[tuple[Array, Array]]:
        """Columns and values of each segment."""
        ends = [*self._starts[1:], len(values)]
        bounds = zip(self._starts, ends, strict=True)
        return [(self._columns[a:b], values[a:b]) for a, b in bounds]


def taken_out(inner: Array, products: Array, amounts: Array) -> tuple[Array, Array]:
    """What shared errors U diag(amounts) take out of a Gram matrix, and log determinants.

    inner     (..., S, K, K) products U^T U of each segment
    products  (..., S, K, m) products U^T Y
    amounts   (..., K) sizes of the columns

    The first result is (..., m, m), to be subtracted from Y^T Y; the second (...).
    """
    size = amounts[..., None, :, None]
    covariance = np.eye(inner.shape[-1]) + size * inner * np.swapaxes(size, -1, -2)
    roots = np.asarray(np.linalg.cholesky(covariance), dtype=float)
    half = _solved_small(roots, size * products)
    *rest, segments, columns, count = half.shape
    flat = half.reshape(*rest, segments * columns, count)
    diagonals = np.diagonal(roots, axis1=-2, axis2=-1)
    removed = np.swapaxes(flat, -1, -2) @ flat
    return removed, 2.0 * np.log(diagonals).sum(axis=(-2, -1))


def _solved_small(matrices: Array, values: Array) -> Array:
    """A^-1 Y (..., K, m) of matrices A (..., K, K); by inverses where Y has more columns.

    NumPy copies the columns of each Y for LAPACK: eight times the work where K is small.
    """
    if matrices.shape[-1] < values.shape[-1]:
        return np.asarray(np.linalg.inv(matrices) @ values)
    return np.asarray(np.linalg.solve(matrices, values))


def _sums_before(values: Array, starts: Index) -> Array:
    """Sums (N, m) of all rows before each row of its segment."""
    sums = np.zeros_like(values)
    ends = [*starts[1:], len(values)]
    for a, b in zip(starts, ends, strict=True):
        np.cumsum(values[a : b - 1], axis=0, out=sums[a + 1 : b])
    return sums
