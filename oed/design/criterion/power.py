"""phi_p: the power mean of the eigenvalues, phi = (tr M^-p / n)^(-1/p).

p = 1 is A, a large p is led by the least eigenvalue (E), p = 1/2 is the observability
index O5 = 1 / sum(1 / sigma_i). With eigenvalues l of M = V diag(l) V^T, tau = tr M^-p
and the divided differences d_kl of l^(-p-1),

    d log phi / dw_i = tr(M^(-p-1) A_i) / tau = g_i, -d2 log phi / dw_i dw_j = -sum_kl
    d_kl (V^T A_i V)_kl (V^T A_j V)_kl / tau - p g_i g_j.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array
from oed.design.criterion.protocol import Criterion, Support, positive, slopes
from oed.design.criterion.shortlist import exactly, ranked
from oed.design.power import after_adding

#: digits that the power series may lose; beyond, eigenvalues are computed for a
#: shortlist
DIGITS = 8.0


@dataclasses.dataclass(frozen=True, eq=False)
class Power:
    """phi_p for p > 0. told: phi, or, with the name "O5", O5 over `directions`."""

    p: float = 1.0
    directions: int = 1
    name: str = "phi_p"
    concave: bool = True
    smooth: bool = True

    def value(self, m: Array) -> float:
        """-log(tr M^-p / n) / p."""
        return (
            float(self.of(np.asarray(np.linalg.eigvalsh(m), dtype=float)[None])[0])
            if positive(m)
            else -np.inf
        )

    def of(self, values: Array) -> Array:
        """log phi (C,) from eigenvalues (C, n)."""
        least = np.maximum(values[:, :1], 1e-300)
        mean = np.mean((np.maximum(values, 1e-300) / least) ** -self.p, axis=1)
        return np.asarray(np.log(least[:, 0]) - np.log(mean) / self.p)

    def support(self, m: Array) -> Support:
        """Root V l^(-(p+1)/2) / sqrt(tau)."""
        values, vectors = np.linalg.eigh(m)
        values = np.maximum(values, 1e-300)
        share = (values[0] / values) ** self.p
        root = vectors * np.sqrt(share / share.sum() / values)
        return Support(float(self.of(values[None])[0]), root)

    def curvature(self, m: Array, blocks: Array) -> Array:
        """Divided differences of l^(-p-1), in the eigenbasis of M."""
        values, vectors = np.linalg.eigh(m)
        x = values / values[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            difference = (x[:, None] ** (-self.p - 1) - x[None, :] ** (-self.p - 1)) / (
                x[:, None] - x[None, :]
            )
        middle = 0.5 * (x[:, None] + x[None, :])
        close = np.abs(x[:, None] - x[None, :]) < 1e-7 * middle
        difference = np.where(
            close, -(self.p + 1) * middle ** (-self.p - 2), difference
        )
        turned = blocks @ vectors
        a = np.einsum("ckn,ckm->cnm", turned, turned, optimize=True) * np.sqrt(
            -difference
        )
        flat = a.reshape(len(blocks), -1)
        tau = float(np.sum(x**-self.p)) * values[0] ** 2
        g = slopes(blocks, self.support(m).root)
        return np.asarray(flat @ flat.T / tau - self.p * np.outer(g, g))

    def added(self, m: Array, blocks: Array) -> Array:
        """By the power series where it is exact enough, else by eigenvalues of a
        shortlist.
        """
        values, vectors = np.linalg.eigh(m)
        if not float(self.p).is_integer() or blocks.shape[1] > 1:
            return exactly(self.of, m, blocks, ranked(values, vectors, blocks))
        floor = np.maximum(values, 1e-12 * values[-1])
        told = after_adding(floor, vectors, blocks[:, 0], int(self.p))
        found = (
            np.log(floor[0]) - np.log(np.maximum(told, 1e-300) / len(values)) / self.p
        )
        # the sum of powers falls from l_1^-p to at least l_2^-p: the digits between are
        # lost
        if self.p * np.log10(floor[min(1, len(floor) - 1)] / floor[0]) < DIGITS:
            return np.asarray(found)
        top = float(found.max())
        lost = self.p * (top - np.log(floor[0])) / np.log(10.0)
        return (
            np.asarray(found) if lost < DIGITS else exactly(self.of, m, blocks, found)
        )

    def told(self, value: float, readings: int) -> float:
        """phi, or O5 = sqrt(phi) / n."""
        return (
            float(np.exp(value / 2.0)) / self.directions
            if self.name == "O5"
            else float(np.exp(value))
        )

    def within(self, basis: Array) -> Criterion:
        """The same mean over the directions seen."""
        return dataclasses.replace(self, directions=basis.shape[1])

    def ladder(self) -> tuple[Criterion, ...]:
        """Lower powers first."""
        return (*(Power(float(q)) for q in (1, 2, 4, 8, 16) if q < self.p), self)
