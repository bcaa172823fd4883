"""Criteria as cones for a conic solver, and the lines that the solver's duals imply.

The criteria enter by their hypographs (Ben-Tal and Nemirovski 2001, Lectures on Modern
Convex Optimization, chapter 4), with y for phi:

    D        log det M
    Ds       log det C,  M >= K C K^T
    A, c, I  tr(F (y^2 M^-1) F^T) <= y
    G        the same for each W_j
    E        M >= y 1
    phi_p    U_1 >= y^2 M^-1,  U_(k+1) >= U_k^2 / y,  |U_k| <= sqrt(n) y  for p = 2^k
    p = 1/2  V^2 <= M,  q tr V^-1 <= n,  y = q^2
"""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np

from oed.base import Array
from oed.design.forms import (
    Criterion,
    Determinant,
    ExtremeEigenvalues,
    LargestVariance,
    PowerMean,
    Support,
    Variance,
)

#: least share of a place in the mean variance that bounds G
LEAST_SHARE = 1e-12


class ConicCriterion:
    """log phi of one criterion, up to a constant, as a cvxpy expression of T M T^T.

    log          the expression to maximise
    constraints  that define it
    """

    def __init__(
        self, criterion: Criterion, m: Any, turn: Array, typical: Array
    ) -> None:
        """m is T M T^T for `turn` T (n, n); phi is in units of its `typical` value.

        Raises ValueError for a criterion that has no conic form here.
        """
        self.criterion, self.turn = criterion, turn
        unit = float(np.exp(criterion.value(typical)))
        self.y = cp.Variable(nonneg=True)
        self.log: Any = cp.log(self.y)
        self.constraints: list[Any] = self._formulate(criterion, m, unit)

    def _formulate(self, criterion: Criterion, m: Any, unit: float) -> list[Any]:
        if isinstance(criterion, Determinant):
            return self._determinant(criterion, m)
        if isinstance(criterion, Variance):
            return self._variances(criterion.factor[None], m, unit)
        if isinstance(criterion, LargestVariance):
            return self._variances(criterion.factors, m, unit)
        if isinstance(criterion, ExtremeEigenvalues) and criterion.concave:
            low = unit ** (1.0 / criterion.least)
            return [m >> self.y * (low * self.turn @ self.turn.T)]
        if isinstance(criterion, PowerMean) and _has_cone(criterion.p):
            return self._power_mean(criterion.p, m, np.sqrt(unit) * self.turn)
        raise ValueError(
            f"{criterion.name} has no conic form here (phi_p: p = 1/2, 1, 2, 4, 8, ...)"
        )

    def _determinant(self, criterion: Determinant, m: Any) -> list[Any]:
        if criterion.interest is None:
            self.log = cp.log_det(m) / len(self.turn)
            return []
        k = np.linalg.qr(self.turn @ criterion.interest)[0]
        c = cp.Variable((criterion.size, criterion.size), symmetric=True)
        self.log = cp.log_det(c) / criterion.size
        return [m >> k @ c @ k.T]

    def _variances(self, factors: Array, m: Any, unit: float) -> list[Any]:
        scaled = np.sqrt(unit) * self.turn
        return [cp.matrix_frac(scaled @ f.T * self.y, m) <= self.y for f in factors]

    def _power_mean(self, p: float, m: Any, turn: Array) -> list[Any]:
        n, y = len(turn), self.y
        if p == 1.0:
            return [cp.matrix_frac(turn * y / np.sqrt(n), m) <= y]
        u = cp.Variable((n, n), symmetric=True)
        if p == 0.5:
            self.log = 2.0 * cp.log(y)
            root_below = _schur(np.eye(n), turn @ u, m)
            return [root_below, cp.matrix_frac(np.eye(n) * y, u) <= n * y]
        constraints = [_schur(u, turn * y, m)]
        for _ in range(int(np.log2(p)) - 1):
            u, last = cp.Variable((n, n), symmetric=True), u
            constraints.append(_schur(u, last, y * np.eye(n)))
        return [*constraints, cp.norm(u, "fro") <= np.sqrt(n) * y]

    def support(self, m: Array) -> Support:
        """A line above log phi (for E and O3, above log l_min) near M.

        Where phi has kinks, the solver's dual selects the line.
        """
        duals = [c.dual_value for c in self.constraints]
        known = bool(duals) and duals[0] is not None
        if isinstance(self.criterion, ExtremeEigenvalues):
            if known:
                return Support(0.0, dual_root(self.turn.T @ duals[0] @ self.turn))
            return Support(0.0, np.asarray(np.linalg.eigh(m)[1][:, :1]))
        if isinstance(self.criterion, LargestVariance) and known:
            shares = np.maximum(np.array(duals, dtype=float).reshape(-1), LEAST_SHARE)
            roots = np.sqrt(shares / shares.sum())[:, None, None]
            mean = Variance((self.criterion.factors * roots).reshape(-1, len(m)))
            return mean.support(m)
        return self.criterion.support(m)


def _has_cone(p: float) -> bool:
    return p == 0.5 or float(np.log2(p)).is_integer()


def _schur(corner: Any, side: Any, other: Any) -> Any:
    """corner >= side^T other^-1 side, by Schur's complement."""
    return cp.bmat([[corner, side.T], [side, other]]) >> 0


def dual_root(dual: Array) -> Array:
    """R (n, n) with R R^T the dual made symmetric, semidefinite and of trace 1."""
    eigenvalues, eigenvectors = np.linalg.eigh(0.5 * (dual + dual.T))
    eigenvalues = np.maximum(eigenvalues, 0.0)
    return np.asarray(eigenvectors * np.sqrt(eigenvalues / eigenvalues.sum()))
