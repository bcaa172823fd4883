"""Criteria of the eigenvalues of M: power means (O5) and the extreme ones (E, O3, kappa, O2, O4).

The power mean is phi_p = (tr M^-p / n)^(-1/p). p = 1 is A, the least eigenvalue (E)
dominates a large p, so a growing p leads from A to E without the kinks of E, and p = 1/2
is the observability index O5 = 1 / sum(1 / sigma_i). With eigenvalues l of
M = V diag(l) V^T, tau = tr M^-p and the divided differences d_kl of l^(-p-1),

    d log phi / dw_i = tr(M^(-p-1) A_i) / tau = g_i,
    -d2 log phi / dw_i dw_j = -sum_kl d_kl (V^T A_i V)_kl (V^T A_j V)_kl / tau - p g_i g_j.

tr M^-p after one row is added is exact, for all candidates at once. With A = M^-1 and
one row x added, M + x x^T has the inverse B = A - u u^T,
u = A x / sqrt(1 + x^T A x). From

    det(I - t B) = det(I - t A) (1 + s(t)),      s(t) = sum_k a_k t^(k+1),   a_k = u^T A^k u,

and -log det(I - t B) = sum_p tr(B^p) t^p / p, coefficient by coefficient,

    tr B^p = tr A^p - p c_p,      log(1 + s(t)) = sum_p c_p t^p,      c_p = a_(p-1) - sum_(k<p) (k/p) c_k a_(p-k-1).

In the eigenbasis of M the a_k of all candidates are one matrix product. After an exchange of
row i for row j, with the resolvent r_ij(t) = sum_k t^k x_i^T M^-(k+1) x_j,

    det(M' - t 1) / det(M - t 1) = (1 - r_ii(t)) (1 + r_jj(t)) + r_ij(t)^2 = q(t),
    tr M'^-p = tr M^-p - p [t^p] log q(t).

The extreme eigenvalues give log phi = a log l_min - b log l_max. With b = 0 it is
concave, because l_min(M') <= z^T M' z for any unit z. With b > 0 it is not;
`oed.design.condition` has bounds for it. Their values after adding a block are computed
for a shortlist of candidates. A candidate's rank is its reduction of tr M^-1; where the
largest eigenvalue counts, a second rank takes off the rise of that eigenvalue.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from oed.base import Array
from oed.design.forms.protocol import (
    Criterion,
    Support,
    is_positive_definite,
    weight_gradient,
)
from oed.design.forms.variance import variance_reduction
from oed.design.pairs import Pairs

#: decimal digits of 16 that the power series may lose; beyond, the eigenvalues of a
#: shortlist are computed
MAX_LOST_DIGITS = 8.0
#: eigenvalues of less relative distance count as equal: the root of the rounding, where a
#: difference over the distance is as wrong as the derivative
EQUAL_TOLERANCE = 1e-7
#: powers of the continuation, each twice the one before: E follows within log(n) / 16
POWERS = (1.0, 2.0, 4.0, 8.0, 16.0)
#: power that stands for the least eigenvalue where poses are polished: higher ones bend
#: so sharply that IPOPT's quasi-Newton matrix does not follow
POLISHED_POWER = 8.0
#: powers that guide a search for the least eigenvalue: each costs a product of all pairs
GUIDING_POWERS = (1.0, 2.0, 4.0)
#: power of the means whose gradient stands for those of the extreme eigenvalues
GRADIENT_POWER = 4.0
SHORTLIST_SIZE = 24  #: number of candidates whose eigenvalues are computed
#: eigenvalues of the ranks are raised to at least this share of the largest: below,
#: squares of their reciprocals would be rounding alone
RANK_FLOOR = 1e-9
SINGULAR_FACTOR = 1e-9  #: factor of det M below which an exchange counts as singular
#: stands for the trace after such an exchange: more than any other
SINGULAR_TRACE = 1e200
SINGULAR_TOLERANCE = 1e-15  #: an eigenvalue below this share of the largest is rounding


@dataclasses.dataclass(frozen=True, eq=False)
class PowerMean(Criterion):
    """phi_p for p > 0 over `directions`; its conventional value is phi."""

    p: float = 1.0
    directions: int = 1
    name: str = "phi_p"
    spectral = True

    def value(self, m: Array) -> float:
        """-log(tr M^-p / n) / p."""
        if not is_positive_definite(m):
            return -np.inf
        eigenvalues = np.asarray(np.linalg.eigvalsh(m), dtype=float)
        return float(self.eigenvalue_log_phi(eigenvalues[None])[0])

    def eigenvalue_log_phi(self, eigenvalues: Array) -> Array:
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
        return Support(float(self.eigenvalue_log_phi(eigenvalues[None])[0]), root)

    def curvature(self, m: Array, blocks: Array) -> Array:
        """Divided differences of l^(-p-1), in the eigenbasis of M."""
        eigenvalues, eigenvectors = np.linalg.eigh(m)
        relative = eigenvalues / eigenvalues[0]
        differences = self._divided_differences(relative)
        turned = blocks @ eigenvectors
        products = np.einsum("ckn,ckm->cnm", turned, turned)
        rows = (products * np.sqrt(-differences)).reshape(len(blocks), -1)
        tau = float(np.sum(relative**-self.p)) * eigenvalues[0] ** 2
        g = weight_gradient(blocks, self.support(m).root)
        return np.asarray(rows @ rows.T / tau - self.p * np.outer(g, g))

    def _divided_differences(self, relative: Array) -> Array:
        """d_kl (n, n); the derivative where two eigenvalues are equal."""
        across = relative[:, None] - relative[None, :]
        powers = relative ** (-self.p - 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            differences = (powers[:, None] - powers[None, :]) / across
        middle = 0.5 * (relative[:, None] + relative[None, :])
        derivative = -(self.p + 1) * middle ** (-self.p - 2)
        return np.where(
            np.abs(across) < EQUAL_TOLERANCE * middle, derivative, differences
        )

    def values_after_adding(self, m: Array, blocks: Array) -> Array:
        """By the power series where it is exact enough, else by a shortlist."""
        eigenvalues, eigenvectors = np.linalg.eigh(m)
        if not float(self.p).is_integer() or blocks.shape[1] > 1:
            rank = rank_by_variance(eigenvalues, eigenvectors, blocks)
            return evaluate_shortlist(self.eigenvalue_log_phi, m, blocks, rank)
        floored = np.maximum(eigenvalues, 1e-12 * eigenvalues[-1])
        least = floored[0]
        traces = trace_after_adding(floored, eigenvectors, blocks[:, 0], int(self.p))
        log_mean = np.log(np.maximum(traces, 1e-300) / len(eigenvalues))
        values = np.log(least) - log_mean / self.p
        # the sum of powers falls from l_1^-p to at least l_2^-p: digits in between
        # are lost
        second = floored[min(1, len(floored) - 1)]
        if self.p * np.log10(second / least) < MAX_LOST_DIGITS:
            return np.asarray(values)
        return evaluate_shortlist(self.eigenvalue_log_phi, m, blocks, values)

    def exchange_values(self, pairs: Pairs) -> Array:
        """By the power series for single rows and whole powers, else by a shortlist."""
        if not float(self.p).is_integer() or pairs.blocks.shape[1] > 1:
            return super().exchange_values(pairs)
        return -traces_after_exchange(pairs, int(self.p))

    def conventional_value(self, value: float, readings: int) -> float:
        """phi."""
        return float(np.exp(value))

    def restrict(self, basis: Array) -> Criterion:
        """The same mean over the directions of the basis."""
        return dataclasses.replace(self, directions=basis.shape[1])

    def continuation(self) -> tuple[Criterion, ...]:
        """Lower powers first."""
        return (*(PowerMean(q) for q in POWERS if q < self.p), self)

    @property
    def polished(self) -> Criterion | None:
        """Itself for whole powers, which have an expression."""
        return self if float(self.p).is_integer() else None

    def expression(self, m: Any) -> Any:
        """-(1/p) log tr M^-p."""
        import casadi as ca  # a report that lists the criteria loads no CasADi

        p = int(self.p)
        identity = ca.SX.eye(m.shape[0])
        half = ca.solve(ca.chol(m).T, identity)
        inverse = half.T @ half
        powers = [identity, inverse]
        while len(powers) <= (p + 1) // 2:
            powers.append(powers[-1] @ inverse)
        # tr M^-p as the inner product of the two halves of the power
        trace = ca.sum1(ca.vec(powers[p // 2] * powers[p - p // 2]))
        return -ca.log(trace) / self.p


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


def traces_after_exchange(pairs: Pairs, p: int) -> Array:
    """l^p tr M'^-p (N, C) of all exchanges of rows, or SINGULAR_TRACE; l the least."""
    eigenvalues, vectors = np.linalg.eigh(pairs.m)
    eigenvalues = np.maximum(eigenvalues, RANK_FLOOR * eigenvalues[-1])
    to_white = vectors / np.sqrt(eigenvalues)
    chosen, others = pairs.chosen[:, 0] @ to_white, pairs.blocks[:, 0] @ to_white
    relative = eigenvalues[0] / eigenvalues
    q = _determinant_series(chosen, others, relative, p)
    regular = q[0] > SINGULAR_FACTOR
    factor = np.where(regular, q[0], 1.0)
    sums: list[Array] = []  # of powers of what det M' adds to tr M^-p
    scaled = [term / factor for term in q[1:]]
    for order, term in enumerate(scaled, start=1):
        power_sum = order * term
        for k, earlier in enumerate(sums, start=1):
            power_sum -= earlier * scaled[order - k - 1]
        sums.append(power_sum)
    traces = np.sum(relative**p) - sums[-1]
    return np.where(regular & (traces > 0.0), traces, SINGULAR_TRACE)


def _determinant_series(
    chosen: Array, others: Array, relative: Array, p: int
) -> list[Array]:
    """Coefficients (N, C) of q up to t^p, for t in units of the least eigenvalue.

    chosen (N, n) and others (C, n) are rows whitened by M; relative (n,) has the least
    eigenvalue over each one.
    """
    scales = relative[:, None] ** np.arange(p + 1)
    cross = [(chosen * scales[:, k]) @ others.T for k in range(p + 1)]
    leaving, coming = -(chosen**2) @ scales, others**2 @ scales
    leaving[:, 0] += 1.0
    coming[:, 0] += 1.0
    series = []
    for order in range(p + 1):
        term = leaving[:, : order + 1] @ coming[:, order::-1].T
        for k in range((order + 1) // 2):
            term += 2.0 * cross[k] * cross[order - k]
        if order % 2 == 0:
            term += cross[order // 2] ** 2
        series.append(term)
    return series


# -- shortlists ----------------------------------------------------------------------
def rank_by_variance(eigenvalues: Array, eigenvectors: Array, blocks: Array) -> Array:
    """Reduction of tr M^-1 by each block (C,), from the eigensystem of M."""
    floored = np.maximum(eigenvalues, RANK_FLOOR * eigenvalues[-1])
    inverted = (eigenvectors / floored) @ eigenvectors.T
    squared = (eigenvectors / floored**2) @ eigenvectors.T
    return variance_reduction(blocks, inverted, squared)


def rank_by_spread(
    eigenvalues: Array, eigenvectors: Array, blocks: Array, share: float
) -> Array:
    """As `rank_by_variance`, less a share of the rise of the largest eigenvalue."""
    floored = np.maximum(eigenvalues, RANK_FLOOR * eigenvalues[-1])
    along_largest = np.sum((blocks @ eigenvectors[:, -1]) ** 2, axis=1)
    reduction = rank_by_variance(eigenvalues, eigenvectors, blocks)
    gain = np.log1p(reduction / np.sum(1.0 / floored))
    return np.asarray(gain - share * np.log1p(along_largest / eigenvalues[-1]))


def evaluate_shortlist(
    eigenvalue_log_phi: Callable[[Array], Array], m: Array, blocks: Array, *ranks: Array
) -> Array:
    """A function of the eigenvalues of M + X_i^T X_i (C,); -inf off the shortlist.

    The shortlist holds the first candidates by each of the ranks (C,). eigenvalue_log_phi
    maps ascending eigenvalues (C, n) to values (C,).
    """
    places = max(SHORTLIST_SIZE // len(ranks), 1)
    first = [np.argsort(-rank, kind="stable")[:places] for rank in ranks]
    shortlist = np.unique(np.concatenate(first))
    added = blocks[shortlist]
    sums = m + np.einsum("ckn,ckm->cnm", added, added)
    values = np.full(len(blocks), -np.inf)
    eigenvalues = np.asarray(np.linalg.eigvalsh(sums), dtype=float)
    values[shortlist] = eigenvalue_log_phi(eigenvalues)
    return values


# -- extreme eigenvalues --------------------------------------------------------------
@dataclasses.dataclass(frozen=True, eq=False)
class ExtremeEigenvalues(Criterion):
    """a log l_min - b log l_max, with `least` a and `largest` b.

    A finite `p` smooths both ends as power means, (tr M^-p)^(-1/p) and (tr M^p)^(1/p).
    Its conventional value is phi.
    """

    least: float = 1.0
    largest: float = 0.0
    p: float = np.inf
    name: str = "E"
    smooth = False
    spectral = True

    @property
    def concave(self) -> bool:
        """Whether only the least eigenvalue counts."""
        return self.largest == 0.0

    def value(self, m: Array) -> float:
        """a log l_min - b log l_max."""
        eigenvalues = np.asarray(np.linalg.eigvalsh(m), dtype=float)
        return float(self.eigenvalue_log_phi(eigenvalues[None])[0])

    def eigenvalue_log_phi(self, eigenvalues: Array) -> Array:
        """log phi (C,) from ascending eigenvalues (C, n)."""
        smallest, top = eigenvalues[:, 0], eigenvalues[:, -1]
        regular = smallest > SINGULAR_TOLERANCE * top
        log_least = np.log(np.where(regular, smallest, 1.0))
        log_largest = np.log(np.maximum(top, 1e-300))
        if np.isfinite(self.p):
            floored = np.maximum(eigenvalues, SINGULAR_TOLERANCE * eigenvalues[:, -1:])
            low_powers = (floored / floored[:, :1]) ** -self.p
            high_powers = (floored / floored[:, -1:]) ** self.p
            log_least = log_least - np.log(np.mean(low_powers, axis=1)) / self.p
            log_largest = log_largest + np.log(np.mean(high_powers, axis=1)) / self.p
        value = self.least * log_least - self.largest * log_largest
        return np.where(regular, value, -np.inf)

    def support(self, m: Array) -> Support:
        """The line through the eigenvector of the least eigenvalue, for E alone."""
        if not self.concave or self.least != 1.0:
            raise ValueError(
                f"{self.name} has no supporting line: see oed.design.condition"
            )
        return Support(0.0, np.asarray(np.linalg.eigh(m)[1][:, :1]))

    def values_after_adding(self, m: Array, blocks: Array) -> Array:
        """By the eigenvalues of a shortlist."""
        eigenvalues, eigenvectors = np.linalg.eigh(m)
        ranks = [rank_by_variance(eigenvalues, eigenvectors, blocks)]
        if self.largest > 0.0:
            ranks.append(
                rank_by_spread(eigenvalues, eigenvectors, blocks, self.largest)
            )
        return evaluate_shortlist(self.eigenvalue_log_phi, m, blocks, *ranks)

    def conventional_value(self, value: float, readings: int) -> float:
        """phi."""
        return float(np.exp(value))

    def restrict(self, basis: Array) -> Criterion:
        """Itself: the matrix alone changes."""
        return self

    def continuation(self) -> tuple[Criterion, ...]:
        """Power means first."""
        if self.concave:
            return (*(PowerMean(p) for p in POWERS), self)
        smoothed = [dataclasses.replace(self, p=p) for p in POWERS[1:]]
        return (PowerMean(1.0), *smoothed, self)

    @property
    def ceiling(self) -> float:
        """0 for the condition number, which is at least 1."""
        return 0.0 if self.least == self.largest else np.inf

    @property
    def guides(self) -> tuple[Criterion, ...]:
        """Power means of low powers: an exchange raises one least eigenvalue of several."""
        return tuple(PowerMean(p) for p in GUIDING_POWERS) if self.concave else (self,)

    def gradient_matrix(self, m: Array) -> Array:
        """That of power means of both ends."""
        eigenvalues, vectors = np.linalg.eigh(m)
        eigenvalues = np.maximum(eigenvalues, RANK_FLOOR * eigenvalues[-1])
        power = min(self.p, GRADIENT_POWER)
        low = (eigenvalues / eigenvalues[0]) ** -power
        high = (eigenvalues / eigenvalues[-1]) ** power
        shares = self.least * low / low.sum() - self.largest * high / high.sum()
        return np.asarray((vectors * (shares / eigenvalues)) @ vectors.T)

    @property
    def polished(self) -> Criterion | None:
        """A power mean for the least eigenvalue."""
        return PowerMean(POLISHED_POWER) if self.concave else None
