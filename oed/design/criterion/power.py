"""phi_p: the power mean of the eigenvalues, phi = (tr M^-p / n)^(-1/p).

p = 1 is A, the least eigenvalue (E) dominates a large p, and p = 1/2 is the
observability index O5 = 1 / sum(1 / sigma_i). With eigenvalues l of
M = V diag(l) V^T, tau = tr M^-p and the divided differences d_kl of l^(-p-1),

    d log phi / dw_i = tr(M^(-p-1) A_i) / tau = g_i,
    -d2 log phi / dw_i dw_j = -sum_kl d_kl (V^T A_i V)_kl (V^T A_j V)_kl / tau - p g_i g_j.

tr M^-p after one row is added is exact, for all candidates at once. With A = M^-1 and
one row x added, M + x x^T has the inverse B = A - u u^T,
u = A x / sqrt(1 + x^T A x). From

    det(I - t B) = det(I - t A) (1 + s(t)),      s(t) = sum_k a_k t^(k+1),   a_k = u^T A^k u,

and -log det(I - t B) = sum_p tr(B^p) t^p / p, coefficient by coefficient,

    tr B^p = tr A^p - p c_p,      log(1 + s(t)) = sum_p c_p t^p,      c_p = a_(p-1) - sum_(k<p) (k/p) c_k a_(p-k-1).

In the eigenbasis of M the a_k of all candidates are one matrix product. p = 1 gives the
A criterion. The least eigenvalue dominates a large p, so a growing p leads from A to E
without the kinks of E.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Array
from oed.design.criterion.protocol import (
    Criterion,
    Support,
    is_positive_definite,
    slopes,
)
from oed.design.criterion.shortlist import evaluate_shortlist, rank_by_variance

#: digits that the power series may lose; beyond, a shortlist's eigenvalues are computed
DIGITS = 8.0
#: eigenvalues of relative distance below this count as equal
EQUAL = 1e-7
#: powers of the continuation
POWERS = (1, 2, 4, 8, 16)


@dataclasses.dataclass(frozen=True, eq=False)
class PowerMean:
    """phi_p for p > 0.

    Its conventional value is phi, or, with the name "O5", O5 over `directions`.
    """

    p: float = 1.0
    directions: int = 1
    name: str = "phi_p"
    concave: bool = True
    smooth: bool = True

    def value(self, m: Array) -> float:
        """-log(tr M^-p / n) / p."""
        if not is_positive_definite(m):
            return -np.inf
        eigenvalues = np.asarray(np.linalg.eigvalsh(m), dtype=float)
        return float(self.of_eigenvalues(eigenvalues[None])[0])

    def of_eigenvalues(self, eigenvalues: Array) -> Array:
        """log phi (C,) from ascending eigenvalues (C, n)."""
        least = np.maximum(eigenvalues[:, :1], 1e-300)
        powers = (np.maximum(eigenvalues, 1e-300) / least) ** -self.p
        log_mean = np.log(np.mean(powers, axis=1))
        return np.asarray(np.log(least[:, 0]) - log_mean / self.p)

    def support(self, m: Array) -> Support:
        """Root V l^(-(p+1)/2) / sqrt(tau)."""
        eigenvalues, eigenvectors = np.linalg.eigh(m)
        eigenvalues = np.maximum(eigenvalues, 1e-300)
        powers = (eigenvalues[0] / eigenvalues) ** self.p
        root = eigenvectors * np.sqrt(powers / powers.sum() / eigenvalues)
        return Support(float(self.of_eigenvalues(eigenvalues[None])[0]), root)

    def curvature(self, m: Array, blocks: Array) -> Array:
        """Divided differences of l^(-p-1), in the eigenbasis of M."""
        eigenvalues, eigenvectors = np.linalg.eigh(m)
        relative = eigenvalues / eigenvalues[0]
        differences = self._divided_differences(relative)
        turned = blocks @ eigenvectors
        products = np.einsum("ckn,ckm->cnm", turned, turned)
        rows = (products * np.sqrt(-differences)).reshape(len(blocks), -1)
        tau = float(np.sum(relative**-self.p)) * eigenvalues[0] ** 2
        g = slopes(blocks, self.support(m).root)
        return np.asarray(rows @ rows.T / tau - self.p * np.outer(g, g))

    def _divided_differences(self, relative: Array) -> Array:
        """d_kl (n, n); the derivative where two eigenvalues are equal."""
        across = relative[:, None] - relative[None, :]
        powers = relative ** (-self.p - 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            differences = (powers[:, None] - powers[None, :]) / across
        middle = 0.5 * (relative[:, None] + relative[None, :])
        derivative = -(self.p + 1) * middle ** (-self.p - 2)
        return np.where(np.abs(across) < EQUAL * middle, derivative, differences)

    def values_after_adding(self, m: Array, blocks: Array) -> Array:
        """By the power series where it is exact enough, else by a shortlist."""
        eigenvalues, eigenvectors = np.linalg.eigh(m)
        if not float(self.p).is_integer() or blocks.shape[1] > 1:
            rank = rank_by_variance(eigenvalues, eigenvectors, blocks)
            return evaluate_shortlist(self.of_eigenvalues, m, blocks, rank)
        floored = np.maximum(eigenvalues, 1e-12 * eigenvalues[-1])
        least = floored[0]
        traces = trace_after_adding(floored, eigenvectors, blocks[:, 0], int(self.p))
        log_mean = np.log(np.maximum(traces, 1e-300) / len(eigenvalues))
        values = np.log(least) - log_mean / self.p
        # the sum of powers falls from l_1^-p to at least l_2^-p: digits in between
        # are lost
        second = floored[min(1, len(floored) - 1)]
        if self.p * np.log10(second / least) < DIGITS:
            return np.asarray(values)
        digits_lost = self.p * (float(values.max()) - np.log(least)) / np.log(10.0)
        if digits_lost < DIGITS:
            return np.asarray(values)
        return evaluate_shortlist(self.of_eigenvalues, m, blocks, values)

    def conventional_value(self, value: float, readings: int) -> float:
        """phi, or O5 = sqrt(phi) / n."""
        if self.name == "O5":
            return float(np.exp(value / 2.0)) / self.directions
        return float(np.exp(value))

    def restrict(self, basis: Array) -> Criterion:
        """The same mean over the directions of the basis."""
        return dataclasses.replace(self, directions=basis.shape[1])

    def continuation(self) -> tuple[Criterion, ...]:
        """Lower powers first."""
        return (*(PowerMean(float(q)) for q in POWERS if q < self.p), self)


# -- traces of powers ------------------------------------------------------------------


def trace_after_adding(
    eigenvalues: Array, eigenvectors: Array, rows: Array, p: int
) -> Array:
    """tr (M + x x^T)^-p for each row x of (C, n), up to the factor max(eigenvalues^-p).

    eigenvalues (n,) and eigenvectors (n, n) are those of M, positive definite.
    """
    inverse = 1.0 / eigenvalues
    scale = float(inverse.max())
    relative = inverse / scale
    projected = rows @ eigenvectors
    norm = 1.0 + (projected * projected) @ inverse
    weight = (projected * inverse) ** 2 / (norm * scale)[:, None]
    a = (weight @ relative[:, None] ** np.arange(p)).T
    mc = np.empty((p, len(rows)))  # mc[m - 1] = m c_m
    for m in range(1, p + 1):
        earlier = np.einsum("kc,kc->c", mc[: m - 1], a[: m - 1][::-1])
        mc[m - 1] = m * a[m - 1] - earlier
    return np.asarray(np.sum(relative**p) - mc[p - 1])
