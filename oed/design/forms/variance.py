"""A, c, I and G: a mean of variances, or the largest one.

A, c, I: t = tr(W M^-1), phi = 1 / t. W = F^T F is the identity for A and one row c for c.
For I it is the mean of J^T J over workspace poses, with J (k, n) the gradients of the
pose components of interest (home-referenced, absolute or best-fit, `oed.accuracy`).
With S = M^-1 W M^-1 / t,

    d log phi / dw_i = tr(S A_i) = g_i,
    -d2 log phi / dw_i dw_j = 2 tr(A_i M^-1 A_j S) - g_i g_j.

G: the largest predicted variance over the workspace, phi = 1 / max_j t_j. t_j = tr(W_j
M^-1) is the variance at place j. Any weights lambda_j that sum to one give max_j t_j >=
tr(sum_j lambda_j W_j M^-1), so a supporting line of that mean variance bounds G. A
sharpness q smooths the maximum as (sum_j t_j^q)^(1/q). With pi_j = t_j^q / sum_j t_j^q,

    -d2 log phi / dw_i dw_j = sum_j pi_j C_j + q Cov_pi(g)

over the gradients g_j and curvatures C_j of the single variances.
"""

import dataclasses
from typing import Any

import numpy as np

from oed.base import Array, Index
from oed.design.forms.protocol import (
    Criterion,
    Support,
    inner_products,
    is_positive_definite,
    pairwise_traces,
    quadratic_forms,
    weight_gradient,
)
from oed.design.pairs import Pairs
from oed.linear_algebra import symmetric_inverse

#: exponents that lead from the mean variance to the largest, whose error is then
#: log(J) / 256
SHARPNESS = (1.0, 4.0, 16.0, 64.0, 256.0)
RANK_TOLERANCE = 1e-14  #: eigenvalues of W below this share of the largest are rounding


@dataclasses.dataclass(frozen=True, eq=False)
class Variance(Criterion):
    """Mean of the variances of the rows of `factor` F (r, n): W = F^T F.

    Its conventional value is -tr(W M^-1).
    """

    factor: Array
    name: str = "I"

    def value(self, m: Array) -> float:
        """-log tr(W M^-1)."""
        if not is_positive_definite(m):
            return -np.inf
        return -float(
            np.log(np.sum((self.factor @ symmetric_inverse(m)) * self.factor))
        )

    def support(self, m: Array) -> Support:
        """Root M^-1 F^T / sqrt(t): for every R (n, r), 1 / t' <= tr(R^T M' R) / tr(F
        R)^2 (Cauchy and Schwarz), so that no rounding brings the line below phi.
        """
        half = np.linalg.inv(np.linalg.cholesky(m))
        projected = half @ self.factor.T
        t = float(np.sum(projected * projected))
        root = half.T @ projected / np.sqrt(t)
        return Support(-2.0 * float(np.log(np.sum(self.factor.T * root))), root)

    def curvature(self, m: Array, blocks: Array) -> Array:
        """2 tr(A_i M^-1 A_j S) - g_i g_j."""
        root = self.support(m).root
        g = weight_gradient(blocks, root)
        traces = 2.0 * pairwise_traces(blocks, symmetric_inverse(m), root @ root.T)
        return traces - np.outer(g, g)

    def values_after_adding(self, m: Array, blocks: Array) -> Array:
        """t less tr((1 + X M^-1 X^T)^-1 X M^-1 W M^-1 X^T)."""
        inverted = symmetric_inverse(m)
        projected = inverted @ self.factor.T
        t = float(np.sum(projected * self.factor.T))
        reduction = variance_reduction(blocks, inverted, projected @ projected.T)
        return -np.log(np.maximum(t - reduction, 1e-300))

    def exchange_values(self, pairs: Pairs) -> Array:
        """By how much each exchange lowers the mean variance."""
        inverse = symmetric_inverse(pairs.m)
        side = inverse @ self.factor.T
        return pairs.reductions(inverse, side @ side.T)

    def conventional_value(self, value: float, readings: int) -> float:
        """-tr(W M^-1)."""
        return -float(np.exp(-value))

    def restrict(self, basis: Array) -> Criterion:
        """The variances of the part of each row in the basis."""
        return dataclasses.replace(self, factor=self.factor @ basis)

    def profile_others(self, columns: Index, total: int) -> Criterion:
        """The same variances, of some of the columns."""
        return dataclasses.replace(self, factor=_spread(self.factor, columns, total))

    @property
    def polished(self) -> Criterion:
        """Itself."""
        return self

    def expression(self, m: Any) -> Any:
        """-log |L^-1 G|^2 with M = L L^T and W = G G^T."""
        import casadi as ca  # a report that lists the criteria loads no CasADi

        factor = ca.DM(_square_root(self.factor.T @ self.factor))
        return -ca.log(ca.sumsqr(ca.solve(ca.chol(m).T, factor)))


def _square_root(weight: Array) -> Array:
    """G (n, r) with G G^T = W, of as few columns as W has rank."""
    eigenvalues, eigenvectors = np.linalg.eigh(weight)
    positive = eigenvalues > RANK_TOLERANCE * eigenvalues[-1]
    return np.asarray(eigenvectors[:, positive] * np.sqrt(eigenvalues[positive]))


def _spread(factor: Array, columns: Index, total: int) -> Array:
    """A factor (..., n) over `total` columns, zero in all but these n."""
    spread = np.zeros((*factor.shape[:-1], total))
    spread[..., columns] = factor
    return spread


def variance_reduction(blocks: Array, inverted: Array, weighted: Array) -> Array:
    """tr((1 + X P X^T)^-1 X T X^T) (C,), by which blocks lower tr(W M^-1)."""
    if blocks.shape[1] == 1:
        rows = blocks[:, 0]
        leverage = quadratic_forms(rows, inverted)
        return quadratic_forms(rows, weighted) / (1.0 + leverage)
    numerator = inner_products(blocks, weighted)
    leverage = inner_products(blocks, inverted)
    identity = np.eye(blocks.shape[1])
    solved = np.linalg.solve(leverage + identity, numerator)
    return np.asarray(np.trace(solved, axis1=1, axis2=2))


@dataclasses.dataclass(frozen=True, eq=False)
class LargestVariance(Criterion):
    """G over the variances of `factors` (J, r, n): W_j = F_j^T F_j.

    Its conventional value is -max_j tr(W_j M^-1). `sharpness` q smooths the maximum.
    """

    factors: Array
    sharpness: float = np.inf
    name: str = "G"

    @property
    def smooth(self) -> bool:
        """Whether the maximum is smoothed."""
        return bool(np.isfinite(self.sharpness))

    def variances(self, m: Array) -> Array:
        """t_j (J,)."""
        projected = self.factors @ symmetric_inverse(m)
        return np.asarray(np.einsum("jrn,jrn->j", projected, self.factors))

    def value(self, m: Array) -> float:
        """-log of the (smoothed) largest variance."""
        if not is_positive_definite(m):
            return -np.inf
        return -float(self._log_maximum(self.variances(m)[:, None])[0])

    def _log_maximum(self, variances: Array) -> Array:
        """Log of the (smoothed) maximum over the first axis of (J, C)."""
        logs = np.log(np.maximum(variances, 1e-300))
        top = logs.max(axis=0)
        if not self.smooth:
            return np.asarray(top)
        power_sum = np.exp(self.sharpness * (logs - top)).sum(axis=0)
        return np.asarray(top + np.log(power_sum) / self.sharpness)

    def _shares(self, variances: Array) -> Array:
        """pi_j (J,)."""
        sharpness = self.sharpness if self.smooth else SHARPNESS[-1]
        logs = sharpness * np.log(np.maximum(variances, 1e-300))
        shares = np.exp(logs - logs.max())
        return np.asarray(shares / shares.sum())

    def support(self, m: Array) -> Support:
        """That of the mean variance with weights lambda_j = pi_j / t_j, normalised."""
        variances = self.variances(m)
        weights = self._shares(variances) / variances
        weights /= weights.sum()
        scaled = self.factors * np.sqrt(weights)[:, None, None]
        return Variance(scaled.reshape(-1, self.factors.shape[2])).support(m)

    def curvature(self, m: Array, blocks: Array) -> Array:
        """sum_j pi_j (2 tr(A_i M^-1 A_k S_j) - g_ji g_jk) + q Cov_pi(g)."""
        variances = self.variances(m)
        shares = self._shares(variances)
        projected = self.factors @ symmetric_inverse(m)
        s = np.einsum("j,jrn,jrm->nm", shares / variances, projected, projected)
        by_block = np.einsum("ckn,jrn->cjkr", blocks, projected, optimize=True)
        gradients = np.einsum("cjkr,cjkr->jc", by_block, by_block)
        gradients = gradients / variances[:, None]
        mean = shares @ gradients
        second_moment = (gradients.T * shares) @ gradients
        covariance = second_moment - np.outer(mean, mean)
        traces = 2.0 * pairwise_traces(blocks, symmetric_inverse(m), s)
        return np.asarray(traces - second_moment + self.sharpness * covariance)

    def values_after_adding(self, m: Array, blocks: Array) -> Array:
        """Each variance less its reduction by the block."""
        inverted = symmetric_inverse(m)
        projected = self.factors @ inverted
        sums = inner_products(blocks, inverted) + np.eye(blocks.shape[1])
        inner = np.linalg.inv(sums)
        outer = np.einsum("ckn,jrn->cjkr", blocks, projected, optimize=True)
        reduction = np.einsum("cjkr,ckl,cjlr->jc", outer, inner, outer, optimize=True)
        variances = np.einsum("jrn,jrn->j", projected, self.factors)
        return -self._log_maximum(variances[:, None] - reduction)

    def conventional_value(self, value: float, readings: int) -> float:
        """-max_j tr(W_j M^-1)."""
        return -float(np.exp(-value))

    def restrict(self, basis: Array) -> Criterion:
        """The variances of what lies in the basis."""
        return dataclasses.replace(self, factors=self.factors @ basis)

    def profile_others(self, columns: Index, total: int) -> Criterion:
        """The same variances, of some of the columns."""
        return dataclasses.replace(self, factors=_spread(self.factors, columns, total))

    def continuation(self) -> tuple[Criterion, ...]:
        """Smoothed maxima of growing sharpness, then the maximum."""
        smoothed = [dataclasses.replace(self, sharpness=q) for q in SHARPNESS]
        return (*smoothed, dataclasses.replace(self, sharpness=np.inf))
