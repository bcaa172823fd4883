"""How well the runs of a plan tell effects apart, as a concave function of the runs'
weights.

For weights w on runs with Gram matrices M_i (of slopes H and effects' columns G,
whitened by the noise), a target t (a combination of one effect's columns) and its
nuisances E (parameters and one rival's columns) with prior P,

    lambda(w) = min_c (t + E c)^T M(w) (t + E c) + c^T P c,          M(w) = sum_i w_i M_i,

a minimum of functions linear in w: concave, with slopes v^T M_i v and curvature -2
u_i^T N^-1 u_j at the minimum, where v = t + E c, u_i = E^T M_i v and N = E^T M E + P. A
plan is judged by

    (1 - share) min over targets of log lambda  +  share log det(1 + sum_i w_i H_i^T
                                                H_i) / n,

n the parameters: T-optimality with the parameters profiled out (Atkinson and Fedorov
1975), compounded with D.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array, Index
from oed.design.objective import Tangent

#: least lambda that is told from none: its logarithm must stay finite
LEAST = 1e-9
#: how sharply the smoothed minimum takes the least targets, from level to level
SHARP = (2.0, 8.0, 32.0, 128.0, 512.0)


@dataclasses.dataclass(frozen=True)
class Target:
    """What is to be told from a rival: columns and their shares (k,); columns of the
    rival (r,) and their prior precision (r,). Columns count the effects' only.
    """

    columns: Index
    shares: Array
    rival: Index
    precision: Array


@dataclasses.dataclass(frozen=True, eq=False)
class Separation:
    """The objective over C candidate runs; an `oed.design.objective.Objective`, and a
    judge of plans for the search.

    grams    (C, m, m) with m = n + K: parameters first, then the columns of all effects
    base     (m, m) held whatever the plan: the parameters' prior, runs that are kept
    size     parameters n
    targets  at least one unless share = 1;  share of D, 0 to 1
    sharp    of the smoothed minimum, in the relaxation
    """

    grams: Array
    base: Array
    size: int
    targets: tuple[Target, ...]
    share: float
    sharp: float = SHARP[-1]

    @property
    def count(self) -> int:
        """Candidates."""
        return len(self.grams)

    @property
    def directions(self) -> int:
        """Parameters, and a direction for each target."""
        return self.size + len(self.targets)

    # -- one matrix, or many at once ---------------------------------------------------

    def lambdas(self, m: Array) -> Array:
        """lambda (T, ...) of each target for M (..., m, m)."""
        n = self.size
        half = np.linalg.solve(m[..., :n, :n], m[..., :n, n:])
        left = m[..., n:, n:] - np.swapaxes(m[..., :n, n:], -1, -2) @ half
        return np.array([self._lambda(left, t) for t in self.targets]).reshape(
            len(self.targets), *m.shape[:-2]
        )

    def _lambda(self, left: Array, t: Target) -> Array:
        own = np.einsum(
            "k,...kl,l->...",
            t.shares,
            left[..., t.columns[:, None], t.columns[None, :]],
            t.shares,
        )
        inner = left[..., t.rival[:, None], t.rival[None, :]] + np.diag(t.precision)
        cross = left[..., t.rival[:, None], t.columns[None, :]] @ t.shares
        told = np.linalg.solve(inner, cross[..., None])[..., 0]
        return np.asarray(
            np.maximum(own - np.einsum("...k,...k->...", cross, told), LEAST)
        )

    def volume(self, m: Array) -> Array:
        """log det of the parameters' information (with prior) over n, (...)."""
        return np.asarray(
            np.linalg.slogdet(m[..., : self.size, : self.size])[1] / self.size
        )

    def worth(self, m: Array, sharp: float = np.inf) -> Array:
        """The compound (...) for M (..., m, m); the minimum smoothed, from above, where
        `sharp` is finite.
        """
        total = self.share * self.volume(m)
        if self.share < 1.0:
            logs = np.log(self.lambdas(m))
            low = logs.min(axis=0)
            if np.isfinite(sharp):
                low = (
                    low - np.log(np.mean(np.exp(-sharp * (logs - low)), axis=0)) / sharp
                )
            total = total + (1.0 - self.share) * low
        return np.asarray(total)

    # -- relaxation --------------------------------------------------------------------

    def at(self, active: Index, weights: Array) -> Array:
        """M (m, m)."""
        return np.asarray(self.base + np.tensordot(weights, self.grams[active], axes=1))

    def value(self, active: Index, weights: Array) -> float:
        """The compound, smoothed."""
        return float(self.worth(self.at(active, weights), self.sharp))

    def tangent(self, active: Index, weights: Array) -> Tangent:
        """The tangent of the shares' mean of the log lambdas: above their minimum
        everywhere.
        """
        m = self.at(active, weights)
        slopes, offset = (
            self.share * self._volume_slopes(m, self.grams),
            self.share * float(self.volume(m)),
        )
        if self.share < 1.0:
            logs, table, _ = self._slopes(m, self.grams)
            shares = self._shares(logs)
            slopes = slopes + (1.0 - self.share) * shares @ table
            offset += (1.0 - self.share) * float(shares @ logs)
        return Tangent(
            float(self.worth(m)),
            slopes,
            0.0,
            offset - float(weights @ slopes[active]),
            linear=True,
        )

    def slopes_and_curvature(
        self, active: Index, weights: Array
    ) -> tuple[Array, Array]:
        """Slopes and curvature of the smoothed compound."""
        m, some = self.at(active, weights), self.grams[active]
        slopes, curvature = (
            self.share * self._volume_slopes(m, some),
            self.share * self._volume_curvature(m, some),
        )
        if self.share < 1.0:
            logs, table, curvatures = self._slopes(m, some)
            shares = self._shares(logs)
            mean = shares @ table
            bend = np.tensordot(shares, curvatures, axes=1)
            bend = bend + self.sharp * (
                (table.T * shares) @ table - np.outer(mean, mean)
            )
            slopes, curvature = (
                slopes + (1.0 - self.share) * mean,
                curvature + (1.0 - self.share) * bend,
            )
        return np.asarray(slopes), np.asarray(curvature)

    def _shares(self, logs: Array) -> Array:
        weights = np.exp(-self.sharp * (logs - logs.min()))
        return np.asarray(weights / weights.sum())

    def _volume_slopes(self, m: Array, grams: Array) -> Array:
        n = self.size
        return np.asarray(
            np.einsum("cij,ji->c", grams[:, :n, :n], np.linalg.inv(m[:n, :n])) / n
        )

    def _volume_curvature(self, m: Array, grams: Array) -> Array:
        n = self.size
        moved = np.linalg.inv(m[:n, :n]) @ grams[:, :n, :n]
        flat = moved.reshape(len(grams), -1)
        return np.asarray(flat @ np.swapaxes(moved, 1, 2).reshape(len(grams), -1).T / n)

    def _slopes(self, m: Array, grams: Array) -> tuple[Array, Array, Array]:
        """log lambda (T,), its slopes (T, C) and curvatures (T, C, C)."""
        logs, slopes, curvatures = [], [], []
        for t in self.targets:
            nuisance = np.concatenate([np.arange(self.size), self.size + t.rival])
            target = np.zeros(len(m))
            target[self.size + t.columns] = t.shares
            inner = m[np.ix_(nuisance, nuisance)] + np.diag(
                np.concatenate([np.zeros(self.size), t.precision])
            )
            inverse = np.linalg.inv(inner)
            v = target.copy()
            v[nuisance] -= inverse @ (m[nuisance] @ target)
            lam = max(float(target @ m @ v), LEAST)
            moved = grams @ v
            g = np.asarray(moved @ v / lam)
            u = moved[:, nuisance]
            logs.append(np.log(lam))
            slopes.append(g)
            curvatures.append(2.0 * u @ inverse @ u.T / lam + np.outer(g, g))
        return np.array(logs), np.array(slopes), np.array(curvatures)

    def subset(self, chosen: Index) -> Separation:
        """Over some of the candidates only."""
        return dataclasses.replace(self, grams=self.grams[chosen])

    def mean_eigenvalue(self, weights: Array) -> float:
        """Mean information on a parameter."""
        n = self.size
        total = np.tensordot(
            weights, np.trace(self.grams[:, :n, :n], axis1=1, axis2=2), axes=1
        )
        return float(total + np.trace(self.base[:n, :n])) / n

    def with_ridge(self, ridge: float) -> Separation:
        """As it is: the parameters' prior keeps everything finite."""
        return self

    # -- search ------------------------------------------------------------------------

    def of(self, chosen: Index) -> Array:
        """M (m, m) of a plan."""
        return np.asarray(self.base + self.grams[chosen].sum(axis=0))


@dataclasses.dataclass(frozen=True, eq=False)
class SeparationJudge:
    """Plans judged by the compound; level 0 smooths the minimum, so that an exchange may
    help several targets.
    """

    separation: Separation
    levels: int = 2

    @property
    def count(self) -> int:
        """Candidates."""
        return self.separation.count

    def value(self, chosen: Index) -> float:
        """The compound."""
        return float(self.separation.worth(self.separation.of(chosen)))

    def regularised_value(self, chosen: Index, level: int) -> float:
        """At a level."""
        return float(
            self.separation.worth(self.separation.of(chosen), _sharpness(level))
        )

    def values_after_adding(
        self, chosen: Index, level: int, ridge: float | None = None
    ) -> Array:
        """At a level, of the plan with each candidate (C,) added."""
        return self.separation.worth(
            self.separation.of(chosen) + self.separation.grams, _sharpness(level)
        )

    def exchange_all(self, chosen: Index, level: int) -> Index | None:
        """No faster way is known."""
        return None

    def subset(self, pool: Index) -> SeparationJudge:
        """Over some of the candidates."""
        return SeparationJudge(self.separation.subset(pool))


def _sharpness(level: int) -> float:
    return SHARP[0] if level == 0 else np.inf
