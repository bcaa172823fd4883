"""Smooth criteria as CasADi expressions of the information matrix, for polishing.

    D         log det M
    variance  -log tr(W M^-1)           A: W = 1;  c: W = c c^T;  I: W a mean over poses
    Ds        -log det(K^T M^-1 K)
    power     -(1/p) log tr M^-p        approaches E as p grows

A larger value is better. Source: Pukelsheim (2006), chapters 3 and 6. With N an
orthonormal basis of what K leaves out,

    det(K^T M^-1 K) = det(K^T K) det(N^T M N) / det M.
"""

from __future__ import annotations

import abc
import dataclasses
from typing import Any

import casadi as ca
import numpy as np
from scipy import linalg

from oed.base.arrays import Array

#: eigenvalues of a weight below this share of the largest count as zero
NEGLIGIBLE = 1e-14
#: directions of interest may leave the estimable subspace by this share of their size
OUTSIDE = 1e-6


class SymbolicCriterion(abc.ABC):
    """A criterion with a numeric value and a CasADi expression.

    Built by `determinant`, `variance`, `determinant_of_interest` and `power_mean`.
    """

    def value(self, m: Array) -> float:
        """Criterion of M (n, n); -inf where M is singular."""
        try:
            root: Array = np.asarray(np.linalg.cholesky(m), dtype=float)
        except np.linalg.LinAlgError:
            return -np.inf
        return self._value(m, root)

    def expression(self, m: Any) -> Any:
        """The criterion of an SX matrix (n, n)."""
        return self._expression(m, ca.chol(m))

    @abc.abstractmethod
    def restrict(self, basis: Array) -> SymbolicCriterion:
        """The criterion of B^T M B for orthonormal columns B (n, r).

        Raises ValueError where K leaves the basis: the readings cannot determine it.
        """

    @abc.abstractmethod
    def _value(self, m: Array, root: Array) -> float:
        """Value of M = L L^T with the triangle L, `root`."""

    @abc.abstractmethod
    def _expression(self, m: Any, upper: Any) -> Any:
        """Expression of M = R^T R with the triangle R, `upper`."""


class _Determinant(SymbolicCriterion):
    def restrict(self, basis: Array) -> SymbolicCriterion:
        return self

    def _value(self, m: Array, root: Array) -> float:
        return 2.0 * float(np.log(np.diag(root)).sum())

    def _expression(self, m: Any, upper: Any) -> Any:
        return 2.0 * ca.sum1(ca.log(ca.diag(upper)))


@dataclasses.dataclass(frozen=True, eq=False)
class _Variance(SymbolicCriterion):
    """`weight` is W (n, n); None stands for the identity."""

    weight: Array | None

    def restrict(self, basis: Array) -> SymbolicCriterion:
        return _Variance(basis.T @ self._weight(len(basis)) @ basis)

    def _value(self, m: Array, root: Array) -> float:
        return -float(np.log(np.sum(np.linalg.inv(m) * self._weight(len(m)))))

    def _expression(self, m: Any, upper: Any) -> Any:
        factor = ca.DM(_factor(self._weight(m.shape[0])))
        return -ca.log(ca.sumsqr(ca.solve(upper.T, factor)))

    def _weight(self, n: int) -> Array:
        return np.eye(n) if self.weight is None else self.weight


@dataclasses.dataclass(frozen=True, eq=False)
class _DeterminantOfInterest(SymbolicCriterion):
    """`interest` is K (n, s)."""

    interest: Array

    def restrict(self, basis: Array) -> SymbolicCriterion:
        inside = basis.T @ self.interest
        outside = basis @ inside - self.interest
        if np.linalg.norm(outside) > OUTSIDE * np.linalg.norm(self.interest):
            raise ValueError(
                "the readings do not determine the directions of interest: choose other"
                " directions or readings"
            )
        return _DeterminantOfInterest(inside)

    def _value(self, m: Array, root: Array) -> float:
        half = linalg.solve_triangular(root, self.interest, lower=True)
        triangle = np.linalg.qr(half, mode="r")
        return -2.0 * float(np.log(np.abs(np.diag(triangle))).sum())

    def _expression(self, m: Any, upper: Any) -> Any:
        nuisance = ca.DM(self._nuisance_basis(m.shape[0]))
        gram = self.interest.T @ self.interest
        log_det_gram = float(np.linalg.slogdet(gram)[1])
        log_det_nuisance: Any = 0.0
        if nuisance.shape[1]:
            nuisance_root = ca.chol(nuisance.T @ m @ nuisance)
            log_det_nuisance = ca.sum1(ca.log(ca.diag(nuisance_root)))
        log_det = ca.sum1(ca.log(ca.diag(upper)))
        return 2.0 * (log_det - log_det_nuisance) - log_det_gram

    def _nuisance_basis(self, n: int) -> Array:
        return np.asarray(linalg.null_space(self.interest.T)).reshape(n, -1)


@dataclasses.dataclass(frozen=True)
class _PowerMean(SymbolicCriterion):
    """`p` is the exponent."""

    p: int

    def restrict(self, basis: Array) -> SymbolicCriterion:
        return self

    def _value(self, m: Array, root: Array) -> float:
        eigenvalues = np.linalg.eigvalsh(m)
        smallest = eigenvalues[0]
        if smallest <= 0.0:
            return -np.inf
        power_sum = np.sum((smallest / eigenvalues) ** self.p)
        return float(np.log(smallest) - np.log(power_sum) / self.p)

    def _expression(self, m: Any, upper: Any) -> Any:
        identity = ca.SX.eye(upper.shape[0])
        half = ca.solve(upper.T, identity)
        inverse = half.T @ half
        powers = [identity, inverse]
        while len(powers) <= (self.p + 1) // 2:
            powers.append(powers[-1] @ inverse)
        # tr M^-p as the inner product of the two halves of the power
        lower_half = powers[self.p // 2]
        upper_half = powers[self.p - self.p // 2]
        trace = ca.sum1(ca.vec(lower_half * upper_half))
        return -ca.log(trace) / self.p


def determinant() -> SymbolicCriterion:
    """D: log det M."""
    return _Determinant()


def variance(weight: Array | None = None) -> SymbolicCriterion:
    """-log tr(W M^-1) for a positive semidefinite W (n, n); A where W is None."""
    return _Variance(None if weight is None else np.asarray(weight, dtype=float))


def determinant_of_interest(interest: Array) -> SymbolicCriterion:
    """Ds: the confidence volume of K^T theta, K (n, s); the rest are nuisances."""
    return _DeterminantOfInterest(np.asarray(interest, dtype=float))


def power_mean(p: int) -> SymbolicCriterion:
    """-(1/p) log tr M^-p. Raises ValueError for p below 1."""
    if p < 1:
        raise ValueError(f"the power criterion needs p >= 1, not {p}")
    return _PowerMean(int(p))


def _factor(weight: Array) -> Array:
    """F (n, r) with F F^T = W."""
    eigenvalues, eigenvectors = np.linalg.eigh(weight)
    positive = eigenvalues > NEGLIGIBLE * eigenvalues[-1]
    return np.asarray(eigenvectors[:, positive] * np.sqrt(eigenvalues[positive]))
