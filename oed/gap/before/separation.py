"""Separation of effects by the runs of a plan, as a concave function of their weights.

For weights w on runs with Gram matrices M_i (of slopes H and effects' columns G,
whitened by the noise), a target t (a combination of one effect's columns) and its
nuisances E (parameters and one rival's columns) with prior P,

    lambda(w) = min_c (t + E c)^T M(w) (t + E c) + c^T P c,    M(w) = sum_i w_i M_i,

a minimum of functions linear in w: concave, with slopes v^T M_i v and curvature -2
u_i^T N^-1 u_j at the minimum, where v = t + E c, u_i = E^T M_i v and N = E^T M E + P. A
plan is judged by

    (1 - share) min over targets of log lambda
        + share log det(1 + sum_i w_i H_i^T H_i) / n,

n the parameters: T-optimality with the parameters profiled out (Atkinson and Fedorov
1975), compounded with D.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array, Index
from oed.design.objective import Tangent

#: least lambda that counts: its logarithm must stay finite
LEAST = 1e-9
#: how sharply the smoothed minimum takes the least targets, from level to level
SHARP = (2.0, 8.0, 32.0, 128.0, 512.0)


@dataclasses.dataclass(frozen=True)
class Target:
    """A combination of an effect's columns to be separated from a rival.

    columns      (k,) of the effect
    shares       (k,) of these columns in the combination
    rival        (r,) columns of the rival
    precision    (r,) prior precision of these columns

    Columns count those of effects only.
    """

    columns: Index
    shares: Array
    rival: Index
    precision: Array


@dataclasses.dataclass(frozen=True, eq=False)
class Separation:
    """The objective over C candidate runs (`oed.design.objective.Objective`).

    grams      (C, m, m) with m = n + K: parameters first, then the columns of all
               effects
    base       (m, m) information whatever the plan: the parameters' prior and the runs
               that any plan has
    size       number n of parameters
    targets    at least one unless share = 1
    share      of D in the compound, 0 to 1
    sharp      how sharply the smoothed minimum takes the least targets
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
        effects, cross = m[..., n:, n:], m[..., :n, n:]
        solved = np.linalg.solve(m[..., :n, :n], cross)
        profiled = effects - np.swapaxes(cross, -1, -2) @ solved
        lambdas = np.array([self._lambda(profiled, t) for t in self.targets])
        return lambdas.reshape(len(self.targets), *m.shape[:-2])

    def _lambda(self, profiled: Array, t: Target) -> Array:
        """lambda (...) of a target, the parameters profiled out of (..., K, K)."""
        block = profiled[..., t.columns[:, None], t.columns[None, :]]
        whole = np.einsum("k,...kl,l->...", t.shares, block, t.shares)
        inner = profiled[..., t.rival[:, None], t.rival[None, :]]
        inner = inner + np.diag(t.precision)
        cross = profiled[..., t.rival[:, None], t.columns[None, :]] @ t.shares
        solved = np.linalg.solve(inner, cross[..., None])[..., 0]
        absorbed = np.einsum("...k,...k->...", cross, solved)
        return np.asarray(np.maximum(whole - absorbed, LEAST))

    def volume(self, m: Array) -> Array:
        """log det of the parameters' information (with prior) over n, (...)."""
        n = self.size
        return np.asarray(np.linalg.slogdet(m[..., :n, :n])[1] / n)

    def worth(self, m: Array, sharp: float = np.inf) -> Array:
        """The compound (...) for M (..., m, m).

        Where `sharp` is finite the minimum is smoothed, from above.
        """
        total = self.share * self.volume(m)
        if self.share < 1.0:
            logs = np.log(self.lambdas(m))
            low = logs.min(axis=0)
            if np.isfinite(sharp):
                weights = np.exp(-sharp * (logs - low))
                low = low - np.log(np.mean(weights, axis=0)) / sharp
            total = total + (1.0 - self.share) * low
        return np.asarray(total)

    # -- relaxation --------------------------------------------------------------------

    def at(self, active: Index, weights: Array) -> Array:
        """M (m, m)."""
        runs = np.tensordot(weights, self.grams[active], axes=1)
        return np.asarray(self.base + runs)

    def value(self, active: Index, weights: Array) -> float:
        """The compound, smoothed."""
        return float(self.worth(self.at(active, weights), self.sharp))

    def tangent(self, active: Index, weights: Array) -> Tangent:
        """The tangent of the weighted mean of the log lambdas.

        It lies above their minimum everywhere.
        """
        m = self.at(active, weights)
        slopes = self.share * self._volume_slopes(m, self.grams)
        offset = self.share * float(self.volume(m))
        if self.share < 1.0:
            logs, table, _ = self._slopes(m, self.grams)
            shares = self._shares(logs)
            slopes = slopes + (1.0 - self.share) * shares @ table
            offset += (1.0 - self.share) * float(shares @ logs)
        offset -= float(weights @ slopes[active])
        return Tangent(float(self.worth(m)), slopes, 0.0, offset, linear=True)

    def slopes_and_curvature(
        self,
        active: Index,
        weights: Array,
    ) -> tuple[Array, Array]:
        """Slopes and curvature of the smoothed compound."""
        m, grams = self.at(active, weights), self.grams[active]
        slopes = self.share * self._volume_slopes(m, grams)
        curvature = self.share * self._volume_curvature(m, grams)
        if self.share < 1.0:
            logs, table, curvatures = self._slopes(m, grams)
            shares = self._shares(logs)
            mean = shares @ table
            covariance = (table.T * shares) @ table - np.outer(mean, mean)
            bend = np.tensordot(shares, curvatures, axes=1)
            bend = bend + self.sharp * covariance
            slopes = slopes + (1.0 - self.share) * mean
            curvature = curvature + (1.0 - self.share) * bend
        return np.asarray(slopes), np.asarray(curvature)

    def _shares(self, logs: Array) -> Array:
        """Weights (T,) of the targets in the smoothed minimum."""
        weights = np.exp(-self.sharp * (logs - logs.min()))
        return np.asarray(weights / weights.sum())

    def _volume_slopes(self, m: Array, grams: Array) -> Array:
        n = self.size
        inverse = np.linalg.inv(m[:n, :n])
        return np.asarray(np.einsum("cij,ji->c", grams[:, :n, :n], inverse) / n)

    def _volume_curvature(self, m: Array, grams: Array) -> Array:
        n = self.size
        relative = np.linalg.inv(m[:n, :n]) @ grams[:, :n, :n]
        flat = relative.reshape(len(grams), -1)
        transposed = np.swapaxes(relative, 1, 2).reshape(len(grams), -1)
        return np.asarray(flat @ transposed.T / n)

    def _slopes(self, m: Array, grams: Array) -> tuple[Array, Array, Array]:
        """log lambda (T,), its slopes (T, C) and curvatures (T, C, C)."""
        logs, slopes, curvatures = [], [], []
        for t in self.targets:
            n = self.size
            nuisance = np.concatenate([np.arange(n), n + t.rival])
            target = np.zeros(len(m))
            target[n + t.columns] = t.shares
            precision = np.concatenate([np.zeros(n), t.precision])
            inner = m[np.ix_(nuisance, nuisance)] + np.diag(precision)
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
        traces = np.trace(self.grams[:, :n, :n], axis1=1, axis2=2)
        total = np.tensordot(weights, traces, axes=1)
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
    """Judge of plans by the compound.

    Level 0 smooths the minimum, so that an exchange may help several targets.
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
        m = self.separation.of(chosen)
        return float(self.separation.worth(m, _sharpness(level)))

    def values_after_adding(
        self,
        chosen: Index,
        level: int,
        ridge: float | None = None,
    ) -> Array:
        """At a level, of the plan with each candidate (C,) added."""
        m = self.separation.of(chosen) + self.separation.grams
        return self.separation.worth(m, _sharpness(level))

    def exchange_all(self, chosen: Index, level: int) -> Index | None:
        """No faster way is known."""
        return None

    def search_plans(
        self, starts: Index, steps: int, rng: np.random.Generator
    ) -> Index | None:
        """No search of its own."""
        return None

    def subset(self, pool: Index) -> SeparationJudge:
        """Over some of the candidates."""
        return SeparationJudge(self.separation.subset(pool))


def _sharpness(level: int) -> float:
    return SHARP[0] if level == 0 else np.inf
