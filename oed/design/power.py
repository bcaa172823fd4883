"""tr M^-p after one candidate is added, exactly, for all candidates at once.

With A = M^-1 and one row x added, M + x x^T has the inverse B = A - u u^T, u = A x /
sqrt(1 + x^T A x). From

    det(I - t B) = det(I - t A) (1 + s(t)),      s(t) = sum_k a_k t^(k+1),   a_k = u^T A^k u,

and -log det(I - t B) = sum_p tr(B^p) t^p / p follows, coefficient by coefficient,

    tr B^p = tr A^p - p c_p,      log(1 + s(t)) = sum_p c_p t^p,      c_p = a_(p-1) - sum_(k<p) (k/p) c_k a_(p-k-1).

In the eigenbasis of M the a_k of all candidates are one matrix product. p = 1 is the
A-criterion; a large p is led by the least eigenvalue, so growing p leads from A to E
without its kinks.
"""

from __future__ import annotations

import numpy as np

from oed.arrays import Array


def after_adding(values: Array, vectors: Array, rows: Array, p: int) -> Array:
    """tr (M + x x^T)^-p (C,) for each row x of (C, n), up to the common factor
    max(values^-p).

    values, vectors: eigenvalues (n,) and eigenvectors (n, n) of M, positive definite.
    """
    inverse = 1.0 / values
    scale = float(inverse.max())
    share = inverse / scale
    along = rows @ vectors
    norm = 1.0 + (along * along) @ inverse
    weight = (along * inverse) ** 2 / (norm * scale)[:, None]
    a = (weight @ share[:, None] ** np.arange(p)).T
    b = np.empty((p, len(rows)))  # b_m = m c_m
    for m in range(1, p + 1):
        b[m - 1] = m * a[m - 1] - np.einsum("kc,kc->c", b[: m - 1], a[: m - 1][::-1])
    return np.asarray(np.sum(share**p) - b[p - 1])
