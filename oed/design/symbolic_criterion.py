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

import dataclasses
from typing import Any, Literal

import casadi as ca
import numpy as np
from scipy import linalg

from oed.base.arrays import Array

#: eigenvalues of a weight below this share of the largest count as zero
NEGLIGIBLE = 1e-14
#: directions of interest may leave the estimable subspace by this share of their size
OUTSIDE = 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class SymbolicCriterion:
    """A criterion with a numeric value and a CasADi expression.

    Built by `determinant`, `variance`, `determinant_of_interest` and `power_mean`.

    name      family of the criterion
    weight    W (n, n) for "variance"; None stands for the identity
    interest  K (n, s) for "Ds"
    p         exponent for "power"
    """

    name: Literal["D", "variance", "Ds", "power"] = "D"
    weight: Array | None = None
    interest: Array | None = None
    p: int = 1

    def value(self, m: Array) -> float:
        """Criterion of M (n, n); -inf where M is singular."""
        try:
            root: Array = np.asarray(np.linalg.cholesky(m), dtype=float)
        except np.linalg.LinAlgError:
            return -np.inf
        if self.name == "D":
            return 2.0 * float(np.log(np.diag(root)).sum())
        if self.name == "Ds":
            return self._value_of_interest(root)
        if self.name == "variance":
            return -float(np.log(np.sum(np.linalg.inv(m) * self._weight(len(m)))))
        return self._power_mean(m)

    def _value_of_interest(self, root: Array) -> float:
        assert self.interest is not None
        half = linalg.solve_triangular(root, self.interest, lower=True)
        triangle = np.linalg.qr(half, mode="r")
        return -2.0 * float(np.log(np.abs(np.diag(triangle))).sum())

    def _power_mean(self, m: Array) -> float:
        eigenvalues = np.linalg.eigvalsh(m)
        smallest = eigenvalues[0]
        if smallest <= 0.0:
            return -np.inf
        power_sum = np.sum((smallest / eigenvalues) ** self.p)
        return float(np.log(smallest) - np.log(power_sum) / self.p)

    def expression(self, m: Any) -> Any:
        """The criterion of an SX matrix (n, n)."""
        upper = ca.chol(m)  # M = R^T R
        if self.name == "D":
            return 2.0 * ca.sum1(ca.log(ca.diag(upper)))
        if self.name == "Ds":
            return self._expression_of_interest(m, upper)
        if self.name == "variance":
            factor = ca.DM(_factor(self._weight(m.shape[0])))
            return -ca.log(ca.sumsqr(ca.solve(upper.T, factor)))
        return self._expression_of_power_mean(upper)

    def _expression_of_interest(self, m: Any, upper: Any) -> Any:
        assert self.interest is not None
        nuisance = ca.DM(self._nuisance_basis(m.shape[0]))
        gram = self.interest.T @ self.interest
        log_det_gram = float(np.linalg.slogdet(gram)[1])
        log_det_nuisance: Any = 0.0
        if nuisance.shape[1]:
            nuisance_root = ca.chol(nuisance.T @ m @ nuisance)
            log_det_nuisance = ca.sum1(ca.log(ca.diag(nuisance_root)))
        log_det = ca.sum1(ca.log(ca.diag(upper)))
        return 2.0 * (log_det - log_det_nuisance) - log_det_gram

    def _expression_of_power_mean(self, upper: Any) -> Any:
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

    def restrict(self, basis: Array) -> SymbolicCriterion:
        """The criterion of B^T M B for orthonormal columns B (n, r).

        Raises ValueError where K leaves the basis: the readings cannot determine it.
        """
        weight = self.weight
        if self.name == "variance":
            weight = basis.T @ self._weight(len(basis)) @ basis
        if self.interest is None:
            return dataclasses.replace(self, weight=weight)
        inside = basis.T @ self.interest
        outside = basis @ inside - self.interest
        if np.linalg.norm(outside) > OUTSIDE * np.linalg.norm(self.interest):
            raise ValueError(
                "the readings do not determine the directions of interest: choose other"
                " directions or readings"
            )
        return dataclasses.replace(self, interest=inside)

    def _weight(self, n: int) -> Array:
        return np.eye(n) if self.weight is None else self.weight

    def _nuisance_basis(self, n: int) -> Array:
        assert self.interest is not None
        return np.asarray(linalg.null_space(self.interest.T)).reshape(n, -1)


def determinant() -> SymbolicCriterion:
    """D: log det M."""
    return SymbolicCriterion("D")


def variance(weight: Array | None = None) -> SymbolicCriterion:
    """-log tr(W M^-1) for a positive semidefinite W (n, n); A where W is None."""
    matrix = None if weight is None else np.asarray(weight, dtype=float)
    return SymbolicCriterion("variance", weight=matrix)


def determinant_of_interest(interest: Array) -> SymbolicCriterion:
    """Ds: the confidence volume of K^T theta, K (n, s); the rest are nuisances."""
    return SymbolicCriterion("Ds", interest=np.asarray(interest, dtype=float))


def power_mean(p: int) -> SymbolicCriterion:
    """-(1/p) log tr M^-p. Raises ValueError for p below 1."""
    if p < 1:
        raise ValueError(f"the power criterion needs p >= 1, not {p}")
    return SymbolicCriterion("power", p=int(p))


def _factor(weight: Array) -> Array:
    """F (n, r) with F F^T = W."""
    eigenvalues, eigenvectors = np.linalg.eigh(weight)
    positive = eigenvalues > NEGLIGIBLE * eigenvalues[-1]
    return np.asarray(eigenvectors[:, positive] * np.sqrt(eigenvalues[positive]))
