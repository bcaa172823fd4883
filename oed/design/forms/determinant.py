"""D and Ds: the volume of the confidence ellipsoid, of all or of chosen parameters.

With K (n, s) the directions of interest and P = K^T M^-1 K their covariance,
phi = det(P)^(-1/s). K = 1 gives D. The other directions are nuisance parameters (the
place of a cup, a registration) and are profiled out. With
S = M^-1 K P^-1 K^T M^-1 / s,

    d log phi / dw_i = tr(S A_i),
    -d2 log phi / dw_i dw_j = 2 tr(A_i M^-1 A_j S) - s tr(A_i S A_j S).
"""

import dataclasses
from typing import Any

import numpy as np
import scipy

from oed.base import Array, Index
from oed.design.forms.protocol import (
    Criterion,
    Support,
    inner_products,
    pairwise_traces,
    quadratic_forms,
)
from oed.design.pairs import Pairs
from oed.linear_algebra import symmetric_inverse

#: share of its size by which a direction may leave a basis that it belongs to: far above
#: rounding, and below what a reading could determine
OUTSIDE_TOLERANCE = 1e-8


@dataclasses.dataclass(frozen=True, eq=False)
class Determinant(Criterion):
    """D over `directions`, or Ds of the columns of `interest` (n, s).

    Its conventional value is log det of the information on what is of interest.
    `log_volume` is what coordinates that are not orthonormal add to it.
    """

    directions: int
    interest: Array | None = None
    name: str = "D"
    log_volume: float = 0.0
    starts_from_own_plan = False

    @property
    def size(self) -> int:
        """Number of directions of interest."""
        return self.directions if self.interest is None else int(self.interest.shape[1])

    @property
    def log_size(self) -> int:
        """log det is log phi times the number of directions of interest."""
        return self.size

    @property
    def any_coordinates(self) -> bool:
        """D is the same plan in any coordinates."""
        return self.interest is None

    def value(self, m: Array) -> float:
        """log det(P) / -s."""
        sign, log_det = np.linalg.slogdet(m)
        if sign <= 0:
            return -np.inf
        if self.interest is None:
            return float(log_det) / self.directions
        covariance = self.interest.T @ symmetric_inverse(m) @ self.interest
        sign, log_det = np.linalg.slogdet(covariance)
        return -float(log_det) / self.size if sign > 0 else -np.inf

    def support(self, m: Array) -> Support:
        """Root M^-1 K P^-1/2 / sqrt(s): for every G (n, s), det(P')^(-1/s) <= tr(G^T M'
        G) / s / det(G^T K)^(2/s), so that no rounding brings the line below phi.
        """
        half = _half(m)
        if self.interest is None:
            log_det = 2.0 * float(-np.log(np.diag(half)).sum())
            root = half / np.sqrt(self.directions)
            return Support(log_det / self.directions, root)
        projected = half.T @ self.interest  # M^-1 K = half half^T K
        triangle = np.linalg.qr(projected, mode="r")  # P = triangle^T triangle
        side = half @ projected @ np.linalg.inv(triangle)
        log_det = -2.0 * float(np.linalg.slogdet(side.T @ self.interest)[1])
        return Support(log_det / self.size, side / np.sqrt(self.size))

    def curvature(self, m: Array, blocks: Array) -> Array:
        """2 tr(A_i M^-1 A_j S) - s tr(A_i S A_j S)."""
        if self.interest is None:
            half = _half(m)
            rows = blocks.reshape(-1, blocks.shape[2]) @ half
            whitened = rows.reshape(blocks.shape)
            identity = np.eye(len(m))
            traces = pairwise_traces(whitened, identity, identity)
            return traces / self.directions
        root = self.support(m).root
        s = root @ root.T
        first = pairwise_traces(blocks, symmetric_inverse(m), s)
        return 2.0 * first - self.size * pairwise_traces(blocks, s, s)

    def values_after_adding(self, m: Array, blocks: Array) -> Array:
        """Plus log det(1 + X M^-1 X^T), less the part that the nuisances take."""
        inverted = symmetric_inverse(m)
        gain = _log_det_gain(blocks, inverted)
        if self.interest is not None:
            root = self.support(m).root * np.sqrt(self.size)
            gain = gain - _log_det_gain(blocks, inverted - root @ root.T)
        return self.value(m) + gain / self.size

    def exchange_values(self, pairs: Pairs) -> Array:
        """The factor of det M, over that of the part that the nuisances take."""
        inverse = symmetric_inverse(pairs.m)
        factors = pairs.factors(inverse)
        if self.interest is None:
            return factors
        root = self.support(pairs.m).root * np.sqrt(self.size)
        return factors / pairs.factors(inverse - root @ root.T)

    def conventional_value(self, value: float, readings: int) -> float:
        """log det."""
        return value * self.size + self.log_volume

    def restrict(self, basis: Array) -> Criterion:
        """Directions of interest in the basis, which for D may be any."""
        directions = basis.shape[1]
        if self.interest is None:
            volume = self.log_volume - log_det_of_gram(basis)
            return dataclasses.replace(self, directions=directions, log_volume=volume)
        interest = estimable_part(self.interest, basis)
        return dataclasses.replace(self, directions=directions, interest=interest)

    def profile_others(self, columns: Index, total: int) -> Criterion:
        """Ds: the other columns are no directions of interest."""
        interest = np.zeros((total, self.size))
        interest[columns] = (
            np.eye(len(columns)) if self.interest is None else self.interest
        )
        return dataclasses.replace(self, directions=total, interest=interest)

    @property
    def polished(self) -> Criterion:
        """Itself."""
        return self

    def expression(self, m: Any) -> Any:
        """log det M; for Ds -log det(K^T M^-1 K).

        det(K^T M^-1 K) = det(K^T K) det(N^T M N) / det M, with N an orthonormal basis of
        what K leaves out.
        """
        log_det = _symbolic_log_det(m)
        if self.interest is None:
            return log_det
        nuisance = np.asarray(scipy.linalg.null_space(self.interest.T))
        nuisance = nuisance.reshape(m.shape[0], -1)
        if nuisance.shape[1]:
            log_det = log_det - _symbolic_log_det(nuisance.T @ m @ nuisance)
        gram = self.interest.T @ self.interest
        return log_det - float(np.linalg.slogdet(gram)[1])


def log_det_of_gram(basis: Array) -> float:
    """log det(B^T B) of columns B (n, r) that are orthogonal but for rounding."""
    lengths = np.linalg.norm(basis, axis=0)
    angles = np.linalg.svd(basis / lengths, compute_uv=False)
    return 2.0 * float(np.log(lengths).sum() + np.log(angles).sum())


def _symbolic_log_det(m: Any) -> Any:
    """log det of a CasADi SX matrix (n, n)."""
    import casadi as ca  # a report that lists the criteria loads no CasADi

    return 2.0 * ca.sum1(ca.log(ca.diag(ca.chol(m))))


def _half(m: Array) -> Array:
    """The upper triangle R with R R^T = M^-1."""
    return np.triu(np.linalg.inv(np.linalg.cholesky(m)).T)


def estimable_part(interest: Array, basis: Array) -> Array:
    """Directions K c in a basis (n, r), expressed in it. Raises ValueError for none."""
    outside = interest - basis @ (basis.T @ interest)
    _, distances, vt = np.linalg.svd(outside, full_matrices=False)
    inside_combinations = vt[
        distances <= OUTSIDE_TOLERANCE * np.linalg.norm(interest, 2)
    ].T
    inside: Array = basis.T @ interest @ inside_combinations
    if not inside.size or np.linalg.matrix_rank(inside) < inside.shape[1]:
        raise ValueError(
            "no reading determines the directions of interest: choose others, or give"
            " more candidates"
        )
    return inside


def _log_det_gain(blocks: Array, matrix: Array) -> Array:
    """log det(1 + X P X^T) (C,)."""
    if blocks.shape[1] == 1:
        quadratic = quadratic_forms(blocks[:, 0], matrix)
        return np.log1p(np.maximum(quadratic, -1.0 + 1e-300))
    sums = inner_products(blocks, matrix) + np.eye(blocks.shape[1])
    return np.asarray(np.linalg.slogdet(sums)[1])
