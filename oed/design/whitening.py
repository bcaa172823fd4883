"""Coordinates in which the candidates are well conditioned, and what rounding costs.

Where columns differ by orders of magnitude, or nearly depend on each other, the
information matrix has the square of the rows' condition number, and its factorisation
loses that many digits. With the singular value decomposition X = U S V^T of all rows,
the coordinates T = V S^-1 turn X into U, whose condition number is 1. A determinant
changes by a factor that is known.

The products X T are rounded. Entry by entry, the error is at most

    |fl(x T) - x T| <= gamma |x| |T|,    gamma = n u / (1 - n u)

(Higham 2002, *Accuracy and Stability of Numerical Algorithms*, section 3.1), and a
certificate allows for it (`oed.design.objective`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oed.base import Array
from oed.design.blocks import ILL_CONDITION, RANK_TOLERANCE, Spectrum, spectrum

#: unit roundoff
UNIT_ROUNDOFF = float(np.finfo(float).eps) / 2
#: rows whose products are bounded at a time
CANDIDATES_AT_ONCE = 65536


class Rounding(NamedTuple):
    """Errors of the data of a relaxation.

    rows   largest error of a block (k, n), in the Frobenius norm
    prior  of the prior information, in the Frobenius norm
    """

    rows: float = 0.0
    prior: float = 0.0

    def rounding_of_basis(self, basis: Array) -> Rounding:
        """The errors of blocks and prior in coordinates of a basis (n, r)."""
        size = float(np.linalg.norm(basis, 2))
        return Rounding(self.rows * size, self.prior * size**2)

    def plus(self, other: Rounding) -> Rounding:
        """Both errors together."""
        return Rounding(self.rows + other.rows, self.prior + other.prior)


#: data without error
NO_ROUNDING = Rounding()


class WhiteCandidates(NamedTuple):
    """Candidates in new coordinates.

    blocks    (C, k, r)
    basis     (n, r) T: directions that rows or prior determine, to orthonormal rows
    prior     (r, r) prior information
    rounding  of both
    """

    blocks: Array
    basis: Array
    prior: Array
    rounding: Rounding


def gamma(terms: int) -> float:
    """Relative error of a sum of products with so many terms, at most."""
    return terms * UNIT_ROUNDOFF / (1.0 - terms * UNIT_ROUNDOFF)


def whiten(
    blocks: Array,
    prior: Array | None,
    tolerance: float = 1e-6,
    of_all: Spectrum | None = None,
) -> WhiteCandidates:
    """The blocks (C, k, n) in coordinates where all rows and the prior together have 1.

    Directions with singular values of at most `tolerance` of the largest are left out.
    `of_all` is the spectrum of blocks and prior, where it is known.
    """
    values, directions = spectrum(blocks, prior) if of_all is None else of_all
    visible = values > max(tolerance, RANK_TOLERANCE * len(directions)) * values[0]
    basis = directions[:, visible] / values[visible]
    r = basis.shape[1]
    if prior is None:
        white_prior, prior_error = np.zeros((r, r)), 0.0
    else:
        white_prior = basis.T @ prior @ basis
        white_prior = 0.5 * (white_prior + white_prior.T)
        sizes = np.abs(basis).T @ np.abs(prior) @ np.abs(basis)
        prior_error = gamma(2 * len(prior) + 2) * float(np.linalg.norm(sizes))
    rounding = Rounding(_largest_error(blocks, basis), prior_error)
    return WhiteCandidates(blocks @ basis, basis, white_prior, rounding)


def _largest_error(blocks: Array, basis: Array) -> float:
    """Largest error of a block times the basis, in the Frobenius norm."""
    sizes, largest = np.abs(basis), 0.0
    for start in range(0, len(blocks), CANDIDATES_AT_ONCE):
        products = np.abs(blocks[start : start + CANDIDATES_AT_ONCE]) @ sizes
        squares = np.einsum("ckn,ckn->c", products, products)
        largest = max(largest, float(np.sqrt(squares.max())))
    return gamma(blocks.shape[2] + 1) * largest


def quotient_error(blocks: Array) -> float:
    """Largest error of blocks (C, k, n) that are a quotient, in the Frobenius norm."""
    squares = np.einsum("ckn,ckn->c", blocks, blocks)
    return gamma(3) * float(np.sqrt(squares.max()))


def is_ill_conditioned(matrix: Array) -> bool:
    """Whether an information matrix (n, n) is that of rows worse than `ILL_CONDITION`."""
    eigenvalues = np.linalg.eigvalsh(matrix)
    return bool(eigenvalues[0] * ILL_CONDITION**2 < eigenvalues[-1])
