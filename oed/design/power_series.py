"""tr M^-p after one row is added, exactly and for all candidates at once.

With A = M^-1 and one row x added, M + x x^T has the inverse B = A - u u^T,
u = A x / sqrt(1 + x^T A x). From

    det(I - t B) = det(I - t A) (1 + s(t)),      s(t) = sum_k a_k t^(k+1),   a_k = u^T A^k u,

and -log det(I - t B) = sum_p tr(B^p) t^p / p, coefficient by coefficient,

    tr B^p = tr A^p - p c_p,      log(1 + s(t)) = sum_p c_p t^p,      c_p = a_(p-1) - sum_(k<p) (k/p) c_k a_(p-k-1).

In the eigenbasis of M the a_k of all candidates are one matrix product. p = 1 gives the
A criterion. The least eigenvalue dominates a large p, so a growing p leads from A to E
without the kinks of E.
"""

from __future__ import annotations

import numpy as np

from oed.base.arrays import Array


def trace_after_adding(
    eigenvalues: Array, eigenvectors: Array, rows: Array, p: int
) -> Array:
    """tr (M + x x^T)^-p for each row x of (C, n), up to the factor max(eigenvalues^-p).

    eigenvalues (n,) and eigenvectors (n, n) are those of M, positive definite.
    """
    inverse = 1.0 / eigenvalues
    scale = float(inverse.max())
    relative = inverse / scale
    projected = rows @ eigenvectors
    norm = 1.0 + (projected * projected) @ inverse
    weight = (projected * inverse) ** 2 / (norm * scale)[:, None]
    a = (weight @ relative[:, None] ** np.arange(p)).T
    mc = np.empty((p, len(rows)))  # mc[m - 1] = m c_m
    for m in range(1, p + 1):
        earlier = np.einsum("kc,kc->c", mc[: m - 1], a[: m - 1][::-1])
        mc[m - 1] = m * a[m - 1] - earlier
    return np.asarray(np.sum(relative**p) - mc[p - 1])
