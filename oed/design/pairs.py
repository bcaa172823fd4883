"""All exchanges of a chosen candidate for another one, by formulas of low rank.

Taking block i out of a plan with M, and block j in, changes M^-1 = P. With

    D_ij = X_i P X_j^T,    R_i = (1 - D_ii)^(-1/2) X_i P,    G_ij = R_i X_j^T,

the information without block i has the inverse P + R_i^T R_i (Woodbury), and

    det M'    = det M det(1 - D_ii) det(1 + L_ij),          L_ij = D_jj + G_ij^T G_ij,
    tr(W P')  = tr(W P) + tr V_i - tr((1 + L_ij)^-1 N_ij),

Fedorov's exchange (1972). With T = P W P the other terms are

    U_i = (1 - D_ii)^(-1/2) X_i T,    V_i = (1 - D_ii)^(-1/2) X_i T X_i^T (1 - D_ii)^(-1/2),
    N_ij = X_j T X_j^T + G^T U_i X_j^T + (U_i X_j^T)^T G + G^T V_i G.

For single rows the factor of det M is q = (1 - d_ii)(1 + d_jj) + d_ij^2, which loses no digits
where a plan is nearly singular without row i, and, with s_ij = x_i^T T x_j,

    tr(W P') = tr(W P) - ((1 - d_ii) s_jj + 2 d_ij s_ij - (1 + d_jj) s_ii) / q.
"""

from typing import NamedTuple

import numpy as np

from oed.base import Array

#: eigenvalues of 1 - D_ii, and factors of det M, are raised to at least this
SINGULAR_SHARE = 1e-12


class Pairs(NamedTuple):
    """A plan with the candidates that may come into it."""

    m: Array  #: (n, n) information of the plan, positive definite
    chosen: Array  #: (N, k, n) blocks of the plan
    blocks: Array  #: (C, k, n) candidates

    def information_after(self, pair: int) -> Array:
        """M' (n, n) after an exchange, by its number in a table (N, C)."""
        position, block = divmod(pair, len(self.blocks))
        leaving, coming = self.chosen[position], self.blocks[block]
        return np.asarray(self.m - leaving.T @ leaving + coming.T @ coming)

    def factors(self, inverse: Array) -> Array:
        """det M' / det M (N, C), for the inverse (n, n) of M, or of a part of M."""
        if self.blocks.shape[1] == 1:
            rows, others = self.chosen[:, 0], self.blocks[:, 0]
            return _Crossed.of(rows, others, inverse).determinant()
        leaving = _Leaving.of(self.chosen, inverse)
        grown = np.linalg.det(leaving.sums(self.blocks, inverse))
        return np.asarray(leaving.shares[:, None] * grown)

    def reductions(self, inverse: Array, weighted: Array) -> Array:
        """tr(W P) - tr(W P') (N, C), for T `weighted` (n, n), symmetric."""
        if self.blocks.shape[1] == 1:
            return self._row_reductions(inverse, weighted)
        leaving = _Leaving.of(self.chosen, inverse)
        sums = leaving.sums(self.blocks, inverse)
        terms, lost = leaving.weighted_sums(self.chosen, self.blocks, weighted)
        solved = np.linalg.solve(sums, terms)
        return np.asarray(np.trace(solved, axis1=2, axis2=3)) - lost[:, None]

    def _row_reductions(self, inverse: Array, weighted: Array) -> Array:
        rows, others = self.chosen[:, 0], self.blocks[:, 0]
        d = _Crossed.of(rows, others, inverse)
        s = _Crossed.of(rows, others, weighted)
        total = np.outer(1.0 - d.rows, s.others) + 2.0 * d.cross * s.cross
        total -= np.outer(s.rows, 1.0 + d.others)
        return np.asarray(total / d.determinant())


class _Crossed(NamedTuple):
    """Products of rows (N, n) and others (C, n) by a symmetric matrix."""

    rows: Array  #: (N,) x_i^T P x_i
    others: Array  #: (C,) x_j^T P x_j
    cross: Array  #: (N, C) x_i^T P x_j

    @classmethod
    def of(cls, rows: Array, others: Array, matrix: Array) -> "_Crossed":
        sides = rows @ matrix
        forms = np.einsum("ij,ij->i", others @ matrix, others)
        return cls(np.einsum("ij,ij->i", sides, rows), forms, sides @ others.T)

    def determinant(self) -> Array:
        """(1 - d_ii)(1 + d_jj) + d_ij^2 (N, C)."""
        factors = self.cross**2
        factors += (1.0 - self.rows)[:, None] * (1.0 + self.others)
        return np.maximum(factors, SINGULAR_SHARE)


class _Leaving(NamedTuple):
    """The blocks of a plan, as each of them leaves."""

    rows: Array  #: (N k, n) of all R_i
    roots: Array  #: (N, k, k) (1 - D_ii)^(-1/2)
    shares: Array  #: (N,) det(1 - D_ii)

    @classmethod
    def of(cls, chosen: Array, inverse: Array) -> "_Leaving":
        """The blocks (N, k, n) of a plan."""
        sides = chosen @ inverse
        remaining = np.eye(chosen.shape[1]) - sides @ np.swapaxes(chosen, 1, 2)
        shares, vectors = np.linalg.eigh(remaining)
        shares = np.maximum(shares, SINGULAR_SHARE)
        turned = np.swapaxes(vectors, 1, 2)
        roots = (vectors / np.sqrt(shares)[:, None, :]) @ turned
        rows = (roots @ sides).reshape(-1, inverse.shape[0])
        return cls(rows, roots, np.prod(shares, axis=1))

    def crossed(self, blocks: Array, rows: Array) -> Array:
        """Products (N, C, k, k) of `rows` (N k, n) with the blocks (C, k, n)."""
        count, k, n = blocks.shape
        products = rows @ blocks.reshape(-1, n).T
        return products.reshape(-1, k, count, k).transpose(0, 2, 1, 3)

    def sums(self, blocks: Array, inverse: Array) -> Array:
        """1 + L_ij (N, C, k, k)."""
        g = self.crossed(blocks, self.rows)
        coming = blocks @ inverse @ np.swapaxes(blocks, 1, 2) + np.eye(blocks.shape[1])
        return np.swapaxes(g, 2, 3) @ g + coming

    def weighted_sums(
        self, chosen: Array, blocks: Array, weighted: Array
    ) -> tuple[Array, Array]:
        """N_ij (N, C, k, k), and tr V_i (N,)."""
        sides = self.roots @ chosen @ weighted
        v = sides @ np.swapaxes(chosen, 1, 2) @ self.roots
        g = self.crossed(blocks, self.rows)
        h = self.crossed(blocks, sides.reshape(-1, weighted.shape[0]))
        mixed = np.swapaxes(g, 2, 3) @ (h + 0.5 * v[:, None] @ g)
        coming = blocks @ weighted @ np.swapaxes(blocks, 1, 2)
        total = coming + mixed + np.swapaxes(mixed, 2, 3)
        return total, np.trace(v, axis1=1, axis2=2)
