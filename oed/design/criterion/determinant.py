"""D and Ds: the volume of the confidence ellipsoid, of all parameters or of those of
interest.

With K (n, s) the directions of interest and P = K^T M^-1 K their covariance, phi =
det(P)^(-1/s); K = 1 gives D. The others are nuisances (a cup's place, a registration):
they are profiled out. With S = M^-1 K P^-1 K^T M^-1 / s,

    d log phi / dw_i = tr(S A_i),      -d2 log phi / dw_i dw_j = 2 tr(A_i M^-1 A_j S) -
                                       s tr(A_i S A_j S).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array
from oed.design.criterion.protocol import Criterion, Support, inverse, pairs, products


@dataclasses.dataclass(frozen=True, eq=False)
class Determinant:
    """D over `directions`, or Ds of the columns of `interest` (n, s).

    told: log det of the information about what is of interest; with the name "O1", O1
    of the readings.
    """

    directions: int
    interest: Array | None = None
    name: str = "D"
    concave: bool = True
    smooth: bool = True

    @property
    def size(self) -> int:
        """Directions judged."""
        return self.directions if self.interest is None else int(self.interest.shape[1])

    def value(self, m: Array) -> float:
        """log det(P) / -s."""
        sign, whole = np.linalg.slogdet(m)
        if sign <= 0:
            return -np.inf
        if self.interest is None:
            return float(whole) / self.directions
        sign, told = np.linalg.slogdet(self.interest.T @ inverse(m) @ self.interest)
        return -float(told) / self.size if sign > 0 else -np.inf

    def support(self, m: Array) -> Support:
        """Root M^-1 K P^-1/2 / sqrt(s)."""
        half = np.linalg.inv(np.linalg.cholesky(m)).T
        if self.interest is None:
            return Support(
                2.0 * float(-np.log(np.diag(half)).sum()) / self.directions,
                half / np.sqrt(self.directions),
            )
        seen = half.T @ self.interest  # M^-1 K = half half^T K
        triangle = np.linalg.qr(seen, mode="r")  # P = triangle^T triangle
        told = -2.0 * float(np.log(np.abs(np.diag(triangle))).sum()) / self.size
        return Support(told, half @ seen @ np.linalg.inv(triangle) / np.sqrt(self.size))

    def curvature(self, m: Array, blocks: Array) -> Array:
        """2 tr(A_i M^-1 A_j S) - s tr(A_i S A_j S)."""
        if self.interest is None:
            flat = (
                blocks.reshape(-1, blocks.shape[2])
                @ np.linalg.inv(np.linalg.cholesky(m)).T
            )
            return (
                pairs(flat.reshape(blocks.shape), np.eye(len(m)), np.eye(len(m)))
                / self.directions
            )
        root = self.support(m).root
        s = root @ root.T
        return 2.0 * pairs(blocks, inverse(m), s) - self.size * pairs(blocks, s, s)

    def added(self, m: Array, blocks: Array) -> Array:
        """log det(1 + X M^-1 X^T) more; less what the nuisances take of it."""
        inverted = inverse(m)
        gain = _log_det(blocks, inverted)
        if self.interest is not None:
            root = self.support(m).root * np.sqrt(self.size)
            gain = gain - _log_det(blocks, inverted - root @ root.T)
        return np.asarray(self.value(m) + gain / self.size)

    def told(self, value: float, readings: int) -> float:
        """log det, or O1 = exp(value / 2) / sqrt(m)."""
        return (
            float(np.exp(value / 2.0) / np.sqrt(readings))
            if self.name == "O1"
            else value * self.size
        )

    def within(self, basis: Array) -> Criterion:
        """The directions of interest that the basis sees."""
        if self.interest is None:
            return dataclasses.replace(self, directions=basis.shape[1])
        return dataclasses.replace(
            self, directions=basis.shape[1], interest=estimable(self.interest, basis)
        )

    def ladder(self) -> tuple[Criterion, ...]:
        """Itself."""
        return (self,)


def estimable(interest: Array, basis: Array) -> Array:
    """Directions K c, in the basis B (n, r), that lie in it. Raises ValueError where
    none does.
    """
    outside = interest - basis @ (basis.T @ interest)
    _, s, vt = np.linalg.svd(outside, full_matrices=True)
    size = np.linalg.norm(interest, 2)
    kept = vt[np.append(s, np.zeros(len(vt) - len(s))) <= 1e-8 * size].T
    inside: Array = basis.T @ interest @ kept
    if not inside.size or np.linalg.matrix_rank(inside) < inside.shape[1]:
        raise ValueError(
            "no reading sees the directions of interest: choose others, or give more"
            " candidates"
        )
    return inside


def _log_det(blocks: Array, matrix: Array) -> Array:
    """log det(1 + X P X^T) (C,)."""
    if blocks.shape[1] == 1:
        rows = blocks[:, 0]
        return np.asarray(
            np.log1p(
                np.maximum(np.einsum("ij,ij->i", rows @ matrix, rows), -1.0 + 1e-300)
            )
        )
    return np.asarray(
        np.linalg.slogdet(products(blocks, matrix) + np.eye(blocks.shape[1]))[1]
    )
