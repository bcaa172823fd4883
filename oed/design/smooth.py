"""Criteria that are smooth in the information M: value, slope dvalue/dM, and the same
as a CasADi expression.

    D         log det M                              slope M^-1
    variance  -log tr(W M^-1)                        M^-1 W M^-1 / tr(W M^-1)     (A: W = 1; c: W = c c^T; I)
    Ds        -log det(K^T M^-1 K)                   M^-1 - N (N^T M N)^-1 N^T,   N spans what K leaves out
    power     -(1/p) log tr M^-p                     M^-(p+1) / tr M^-p           (towards E as p grows)

All are the larger the better, and concave in M but for scale. Source: Pukelsheim
(2006), chapters 3 and 6. With N orthonormal, det(K^T M^-1 K) = det(K^T K) det(N^T M N)
/ det M.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import casadi as ca
import numpy as np
from scipy import linalg

from oed.arrays import Array


@dataclasses.dataclass(frozen=True, eq=False)
class Smooth:
    """A smooth criterion; made by `determinant`, `variance`, `of_interest` and `power`.

    weight W (n, n) for "variance" (None: 1); interest K (n, s) for "Ds"; p for "power".
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
            return _log_det(root)
        if self.name == "Ds":
            assert self.interest is not None
            seen = linalg.solve_triangular(root, self.interest, lower=True)
            return -2.0 * float(
                np.log(np.abs(np.diag(np.linalg.qr(seen, mode="r")))).sum()
            )
        if self.name == "variance":
            return -float(np.log(np.sum(np.linalg.inv(m) * self._weight(len(m)))))
        values = np.linalg.eigvalsh(m)
        if values[0] <= 0.0:
            return -np.inf
        return float(
            np.log(values[0]) - np.log(np.sum((values[0] / values) ** self.p)) / self.p
        )

    def slope(self, m: Array) -> Array:
        """dvalue/dM (n, n), symmetric. Raises numpy's LinAlgError where M is singular."""
        inverse = np.asarray(np.linalg.inv(m))
        if self.name == "D":
            return inverse
        if self.name == "Ds":
            return inverse - self.partner(m, inverse)
        if self.name == "variance":
            return self.partner(m, inverse) / float(
                np.sum(inverse * self._weight(len(m)))
            )
        values, vectors = np.linalg.eigh(m)
        share = (values[0] / values) ** self.p
        return np.asarray((vectors * (share / values / share.sum())) @ vectors.T)

    def partner(self, m: Array, inverse: Array) -> Array:
        """The second matrix (n, n) beside M^-1 that an exact exchange needs: see
        `oed.design.continuous`.
        """
        if self.name == "Ds":
            rest = self._rest(len(m))
            return np.asarray(rest @ np.linalg.solve(rest.T @ m @ rest, rest.T))
        if self.name == "variance":
            return np.asarray(inverse @ self._weight(len(m)) @ inverse)
        return np.zeros_like(m)

    def expression(self, m: Any) -> Any:
        """The criterion of an SX matrix (n, n)."""
        n = m.shape[0]
        upper = ca.chol(m)  # M = R^T R
        if self.name == "D":
            return 2.0 * ca.sum1(ca.log(ca.diag(upper)))
        if self.name == "Ds":
            rest = ca.DM(self._rest(n))
            assert self.interest is not None
            scale = float(np.linalg.slogdet(self.interest.T @ self.interest)[1])
            hidden = (
                ca.sum1(ca.log(ca.diag(ca.chol(rest.T @ m @ rest))))
                if rest.shape[1]
                else 0.0
            )
            return 2.0 * (ca.sum1(ca.log(ca.diag(upper))) - hidden) - scale
        if self.name == "variance":
            seen = ca.solve(upper.T, ca.DM(_root(self._weight(n))))
            return -ca.log(ca.sumsqr(seen))
        half = ca.solve(upper.T, ca.SX.eye(n))
        inverse = half.T @ half
        powers = [ca.SX.eye(n), inverse]
        while len(powers) <= (self.p + 1) // 2:
            powers.append(powers[-1] @ inverse)
        return (
            -ca.log(ca.sum1(ca.vec(powers[self.p // 2] * powers[self.p - self.p // 2])))
            / self.p
        )

    def within(self, basis: Array) -> Smooth:
        """The criterion of B^T M B for orthonormal columns B (n, r): W and K are told
        in them.

        Raises ValueError where K leaves the basis: what is of interest could not be
        seen.
        """
        weight = self.weight
        if self.name == "variance":
            weight = basis.T @ self._weight(len(basis)) @ basis
        if self.interest is None:
            return dataclasses.replace(self, weight=weight)
        inside = basis.T @ self.interest
        if np.linalg.norm(basis @ inside - self.interest) > 1e-6 * np.linalg.norm(
            self.interest
        ):
            raise ValueError(
                "what is of interest is not seen by the readings: choose other"
                " directions or readings"
            )
        return dataclasses.replace(self, interest=inside)

    def _weight(self, n: int) -> Array:
        return np.eye(n) if self.weight is None else self.weight

    def _rest(self, n: int) -> Array:
        assert self.interest is not None
        return np.asarray(linalg.null_space(self.interest.T)).reshape(n, -1)


def determinant() -> Smooth:
    """D: log det M."""
    return Smooth("D")


def variance(weight: Array | None = None) -> Smooth:
    """-log tr(W M^-1), W (n, n) symmetric and not negative; A without one."""
    return Smooth(
        "variance", weight=None if weight is None else np.asarray(weight, dtype=float)
    )


def of_interest(interest: Array) -> Smooth:
    """Ds: the volume of what K^T theta, K (n, s), is known to; the other directions are
    nuisances.
    """
    return Smooth("Ds", interest=np.asarray(interest, dtype=float))


def power(p: int) -> Smooth:
    """-(1/p) log tr M^-p. Raises ValueError for p below 1."""
    if p < 1:
        raise ValueError(f"the power criterion needs p >= 1, not {p}")
    return Smooth("power", p=int(p))


def _log_det(root: Array) -> float:
    return 2.0 * float(np.log(np.diag(root)).sum())


def _root(weight: Array) -> Array:
    """F (n, r) with F F^T = W."""
    values, vectors = np.linalg.eigh(weight)
    kept = values > 1e-14 * values[-1]
    return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))
