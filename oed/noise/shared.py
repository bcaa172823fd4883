"""Errors that the readings of a segment share, beside white ones: I + U U^T.

One column u after another: with c_i = 1 + sum_j<=i u_j^2 over the segment,

    y_i = sqrt(c_i-1 / c_i) (x_i - u_i / c_i-1 sum_j<i u_j x_j)

is white where x has the covariance I + u u^T. It is the inverse of Cholesky's root, and
costs a running sum. Inner products alone need no root: the Woodbury identity takes the
columns out, segment by segment.
"""

from __future__ import annotations

import numpy as np

from oed.base.arrays import Array, Index


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
            known = 1.0 + sign * _sums_before(u[:, None] ** 2, starts)[:, 0]
            step = (u, known, known + sign * u**2)
            remaining = self._apply(step, remaining)
            self._steps.append(step)

    def whiten(self, values: Array) -> Array:
        """W Y (N, m), for Y (N, m)."""
        for step in self._steps:
            values = self._apply(step, values)
        return values

    def unwhiten(self, values: Array) -> Array:
        """W^-1 Y (N, m), for Y (N, m)."""
        for u, known, total in reversed(self._steps):
            share = self._sign * u / np.sqrt(known * total)
            drawn = _sums_before(share[:, None] * values, self._starts)
            alone = np.sqrt(total / known)[:, None] * values
            values = alone + u[:, None] * drawn
        return values

    def _apply(self, step: tuple[Array, Array, Array], values: Array) -> Array:
        u, known, total = step
        changed = _sums_before(u[:, None] * values, self._starts)
        changed *= (-self._sign * u / known)[:, None]
        changed += values
        changed *= np.sqrt(known / total)[:, None]
        return changed


class SharedProducts:
    """Woodbury's identity for I + U U^T, of N white readings in segments."""

    def __init__(self, columns: Array, starts: Index) -> None:
        """Prepare columns U (N, K); `starts` (S,) of the segments."""
        self._columns, self._starts = columns, starts
        #: (S, K, K) products U^T U of each segment
        self.inner = self.of_segments(columns)
        unit = np.eye(columns.shape[1])
        #: log determinant of the covariance
        self.log_det = float(np.linalg.slogdet(unit + self.inner)[1].sum())

    def of_segments(self, values: Array) -> Array:
        """U^T Y (S, K, m) of each segment, for Y (N, m)."""
        return np.array([u.T @ y for u, y in self._pairs(values)])

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
    roots = np.linalg.cholesky(covariance)
    half = np.linalg.solve(roots, size * products)
    *rest, segments, columns, count = half.shape
    flat = half.reshape(*rest, segments * columns, count)
    diagonals = np.diagonal(roots, axis1=-2, axis2=-1)
    removed = np.swapaxes(flat, -1, -2) @ flat
    return removed, 2.0 * np.log(diagonals).sum(axis=(-2, -1))


def _sums_before(values: Array, starts: Index) -> Array:
    """Sums (N, m) of all rows before each row of its segment."""
    sums = np.zeros_like(values)
    ends = [*starts[1:], len(values)]
    for a, b in zip(starts, ends, strict=True):
        np.cumsum(values[a : b - 1], axis=0, out=sums[a + 1 : b])
    return sums
