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

import dataclasses
from typing import NamedTuple

import numpy as np

from oed.base import Array, Index, Mask

# Candidates as blocks X_i of k whitened, scaled rows with information X_i^T X_i.

#: rows beyond which a QR factorisation precedes the singular value decomposition
QR_ROWS = 20000
#: condition number of the rows from which an information matrix loses digits that a
#: certificate needs
ILL_CONDITION = 1e3
#: share of the largest singular value, a row or column, up to which one is rounding
RANK_TOLERANCE = float(np.finfo(float).eps)


def block_array(rows: Array) -> Array:
    """Candidates (C, n) as finite blocks (C, k, n). Raises ValueError for others."""
    blocks = rows[:, None, :] if rows.ndim == 2 else rows
    if blocks.ndim != 3 or not blocks.size:
        raise ValueError(
            f"candidates must be rows (C, n) or blocks (C, k, n), not of shape {rows.shape}"
        )
    finite = np.isfinite(blocks).all(axis=(1, 2))
    if not finite.all():
        first_bad = np.flatnonzero(~finite)[:5].tolist()
        raise ValueError(f"candidates number {first_bad} are not finite")
    return np.ascontiguousarray(blocks, dtype=float)


def information(blocks: Array, weights: Array | None = None) -> Array:
    """sum_i w_i X_i^T X_i (n, n)."""
    rows = blocks.reshape(-1, blocks.shape[2])
    if weights is None:
        return rows.T @ rows
    row_weights = np.repeat(weights, blocks.shape[1])[:, None]
    return (rows * row_weights).T @ rows


class Spectrum(NamedTuple):
    """Singular values (r,), largest first, and directions (n, r) of candidates and prior."""

    values: Array
    directions: Array

    def visible(self, tolerance: float) -> Mask:
        """Directions (r,) above the tolerance, a share of the largest."""
        return np.asarray(self.values > tolerance * self.values[0])

    def is_ill_conditioned(self, tolerance: float) -> bool:
        """Whether an information matrix of the visible directions would lose digits."""
        least = self.values[self.visible(tolerance)][-1]
        return bool(least * ILL_CONDITION < self.values[0])

    def weak(self, tolerance: float) -> int:
        """Number of directions that are not above the tolerance, and not rounding."""
        rounding = RANK_TOLERANCE * max(self.directions.shape)
        return int(np.sum(self.visible(rounding) & ~self.visible(tolerance)))


def spectrum(blocks: Array, prior: Array | None) -> Spectrum:
    """Singular values and directions of all rows, and of a root of the prior."""
    rows = blocks.reshape(-1, blocks.shape[2])
    if len(rows) > QR_ROWS:
        # part by part, so that no copy of all rows is in memory
        parts = np.array_split(rows, -(-len(rows) // QR_ROWS))
        rows = np.vstack([np.linalg.qr(part, mode="r") for part in parts])
    if prior is not None:
        rows = np.vstack([rows, _root(prior)])
    _, values, vt = np.linalg.svd(rows, full_matrices=False)
    return Spectrum(values, vt.T)


def project_on_estimable(
    blocks: Array, prior: Array | None, tolerance: float = 1e-6
) -> tuple[Array, Array]:
    """Blocks in a basis (n, r) of what candidates or prior determine; the basis."""
    return project_orthonormal(blocks, spectrum(blocks, prior), tolerance)


def project_orthonormal(
    blocks: Array, of_all: Spectrum, tolerance: float
) -> tuple[Array, Array]:
    """Blocks in the directions above the tolerance, and these (n, r)."""
    basis = of_all.directions[:, of_all.visible(tolerance)]
    if basis.shape[1] == blocks.shape[2]:
        return blocks, np.eye(blocks.shape[2])
    return blocks @ basis, basis


def _root(matrix: Array) -> Array:
    """R (n, n) with R^T R = the positive semidefinite matrix."""
    eigenvalues, eigenvectors = np.linalg.eigh(matrix)
    return np.asarray(np.sqrt(np.maximum(eigenvalues, 0.0))[:, None] * eigenvectors.T)


UNIT_ROUNDOFF = float(np.finfo(float).eps) / 2  #: unit roundoff
#: number of candidates whose products are in memory at once: 500 MB of 1000 columns
CANDIDATES_AT_ONCE = 65536


class Rounding(NamedTuple):
    """Errors of the data of a relaxation."""

    rows: float = 0.0  #: largest error of a block (k, n), in the Frobenius norm
    prior: float = 0.0  #: of the prior information, in the Frobenius norm

    def rounding_of_basis(self, basis: Array) -> "Rounding":
        """The errors of blocks and prior in coordinates of a basis (n, r)."""
        size = float(np.linalg.norm(basis, 2))
        return Rounding(self.rows * size, self.prior * size**2)

    def plus(self, other: "Rounding") -> "Rounding":
        """Both errors together."""
        return Rounding(self.rows + other.rows, self.prior + other.prior)


NO_ROUNDING = Rounding()  #: data without error


class WhiteCandidates(NamedTuple):
    """Candidates in new coordinates."""

    blocks: Array  #: (C, k, r)
    #: (n, r) T: directions that rows or prior determine, to orthonormal rows
    basis: Array
    prior: Array  #: (r, r) prior information
    rounding: Rounding  #: of both


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
        white_prior = np.zeros((r, r))
        prior_error = 0.0
    else:
        white_prior = basis.T @ prior @ basis
        white_prior = 0.5 * (white_prior + white_prior.T)
        sizes = np.abs(basis).T @ np.abs(prior) @ np.abs(basis)
        prior_error = gamma(2 * len(prior) + 2) * float(np.linalg.norm(sizes))
    rounding = Rounding(_largest_error(blocks, basis), prior_error)
    return WhiteCandidates(blocks @ basis, basis, white_prior, rounding)


def _largest_error(blocks: Array, basis: Array) -> float:
    """Largest error of a block times the basis, in the Frobenius norm."""
    sizes = np.abs(basis)
    largest = 0.0
    for part in parts(len(blocks)):
        largest = max(largest, largest_norm(np.abs(blocks[part]) @ sizes))
    return gamma(blocks.shape[2] + 1) * largest


def quotient_error(blocks: Array) -> float:
    """Largest error of blocks (C, k, n) that are a quotient, in the Frobenius norm."""
    return gamma(3) * largest_norm(blocks)


def largest_norm(blocks: Array) -> float:
    """Largest Frobenius norm of blocks (C, k, n)."""
    squares = np.einsum("ckn,ckn->c", blocks, blocks)
    return float(np.sqrt(squares.max()))


def parts(count: int) -> list[slice]:
    """Parts of so many candidates whose products are in memory at once."""
    starts = range(0, count, CANDIDATES_AT_ONCE)
    return [slice(start, start + CANDIDATES_AT_ONCE) for start in starts]


def is_ill_conditioned(matrix: Array) -> bool:
    """Whether an information matrix (n, n) is that of rows worse than `ILL_CONDITION`."""
    eigenvalues = np.linalg.eigvalsh(matrix)
    return bool(eigenvalues[0] * ILL_CONDITION**2 < eigenvalues[-1])


# Equal candidates counted once, compared by a hash of their bits, which takes one pass and
# one sort. Where two different candidates have the same hash, nothing is merged.


PROJECTION_SEED = 20260101  #: seed of the hash's multipliers


@dataclasses.dataclass(frozen=True, eq=False)
class Copies:
    """Kinds of candidates."""

    first: Index  #: (U,) the first candidate of each kind, ascending
    label: Index  #: (C,) kind of each candidate
    number: Index  #: (U,) candidates of each kind

    @property
    def exist(self) -> bool:
        """Whether any two candidates are equal."""
        return len(self.first) < len(self.label)

    def different(self, kinds: Index) -> Index:
        """Different candidates (size,) of the kinds (size,), which may repeat.

        No kind may repeat more often than it has candidates. Copies take turns from kind to
        kind: a plan has all directions of travel that the design does not tell apart.
        """
        if not self.exist:
            return kinds
        by_kind = np.argsort(self.label, kind="stable")
        begin = np.cumsum(self.number) - self.number
        order = np.argsort(kinds, kind="stable")
        ordered = kinds[order]
        repeat = np.arange(len(kinds)) - np.searchsorted(ordered, ordered)
        turn = np.cumsum(np.diff(ordered, prepend=ordered[:1]) > 0)
        copy = (repeat + turn) % self.number[ordered]
        chosen = np.empty_like(kinds)
        chosen[order] = by_kind[begin[ordered] + copy]
        return chosen


def find_copies(candidates: Array) -> Copies:
    """The kinds of candidates (C, n) or blocks (C, k, n)."""
    rows = candidates.reshape(len(candidates), -1)
    _, first, label, number = np.unique(
        _hashes(rows), return_index=True, return_inverse=True, return_counts=True
    )
    if len(first) == len(rows) or not np.array_equal(rows[first[label]], rows):
        everything = np.arange(len(rows))
        return Copies(everything, everything, np.ones_like(everything))
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return Copies(first[order], rank[label], number[order])


def _hashes(rows: Array) -> Index:
    """One number (C,) a row, equal for equal rows."""
    generator = np.random.default_rng(PROJECTION_SEED)
    multipliers = generator.integers(1, 2**63, rows.shape[1], dtype=np.uint64)
    bits = np.ascontiguousarray(rows, dtype=float).view(np.uint64)
    return np.asarray(bits @ (2 * multipliers + 1))
