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

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.base import Array, Index
from oed.design import Objective, PlanEvaluator, Tangent
from oed.gap.before.detect import ColumnSet
from oed.gap.data.evidence import separated
from oed.result import SeparationRecord

MIN_LAMBDA = 1e-9  #: least lambda that counts: its logarithm must stay finite
#: how sharply the smoothed minimum takes the least targets, from level to level
SMOOTHING_LEVELS = (2.0, 8.0, 32.0, 128.0, 512.0)
#: the same at the levels of an exchange search, which ends with the minimum itself
EXCHANGE_LEVELS = (SMOOTHING_LEVELS[0], np.inf)


@dataclasses.dataclass(frozen=True, eq=False)
class Target:
    """A combination of an effect's columns to be separated from a rival."""

    form: ColumnSet  #: of the effect
    shares: Array  #: (k,) of the form's columns in the combination
    words: str  #: the combination in words
    rival: ColumnSet  #: form of the rival

    @property
    def key(self) -> tuple[str, str, str]:
        """Effect, rival and combination, whatever the rival's form."""
        return self.form.effect, self.rival.effect, self.words

    def among(self, columns: Index) -> "Target":
        """The target with its columns numbered among some (k,), ascending."""
        form, rival = (
            dataclasses.replace(one, at=np.searchsorted(columns, one.at))
            for one in (self.form, self.rival)
        )
        return dataclasses.replace(self, form=form, rival=rival)


@dataclasses.dataclass(frozen=True, eq=False)
class Separation(Objective):
    """The objective over C candidate runs."""

    #: (C, m, m) with m = n + K: parameters first, then the columns of all effects
    grams: Array
    #: (m, m) information whatever the plan: the parameters' prior and the runs that any
    #: plan has
    base: Array
    size: int  #: number n of parameters
    targets: tuple[Target, ...]  #: at least one
    #: log det of the parameters' coordinates: what `log_det` lacks to be that in prior
    #: standard deviations
    log_scale: float
    share: float = 0.0  #: of D in the compound, 0 to 1
    #: how sharply the smoothed minimum takes the least targets
    sharp: float = SMOOTHING_LEVELS[-1]

    @property
    def count(self) -> int:
        """Candidates."""
        return len(self.grams)

    @property
    def directions(self) -> int:
        """Parameters, and a direction for each target."""
        return self.size + len(self.targets)

    # -- one matrix, or many at once ---------------------------------------------------
    def of(self, chosen: Index) -> Array:
        """M (m, m) of a plan."""
        return np.asarray(self.base + self.grams[chosen].sum(axis=0))

    def lambdas(self, m: Array) -> Array:
        """lambda (T, ...) of each target for M (..., m, m)."""
        n = self.size
        cross = m[..., :n, n:]
        solved = np.linalg.solve(m[..., :n, :n], cross)
        profiled = m[..., n:, n:] - np.swapaxes(cross, -1, -2) @ solved
        lambdas = []
        for t in self.targets:
            left = separated(profiled, t.form.at, t.rival.at, t.rival.precision)
            lambdas.append(np.einsum("k,...kl,l->...", t.shares, left, t.shares))
        return np.maximum(lambdas, MIN_LAMBDA)

    def log_det(self, m: Array) -> Array:
        """log det (...) of the parameters' information, prior included."""
        n = self.size
        return np.asarray(np.linalg.slogdet(m[..., :n, :n])[1])

    def worth(self, m: Array, sharp: float = np.inf) -> Array:
        """The compound (...) for M (..., m, m), smoothed from above by `sharp`."""
        logs = np.log(self.lambdas(m))
        low = logs.min(axis=0)
        if np.isfinite(sharp):
            weights = np.exp(-sharp * (logs - low))
            low = low - np.log(np.mean(weights, axis=0)) / sharp
        volume = self.log_det(m) / self.size
        return np.asarray(self.share * volume + (1.0 - self.share) * low)

    def hardest(self, chosen: Index) -> list[int]:
        """For each combination and rival the target of least lambda in a plan."""
        lambdas = self.lambdas(self.of(chosen))
        alike: dict[tuple[str, str, str], list[int]] = {}
        for k, target in enumerate(self.targets):
            alike.setdefault(target.key, []).append(k)
        return [min(numbers, key=lambdas.__getitem__) for numbers in alike.values()]

    def pairs(self, chosen: Index) -> list[SeparationRecord]:
        """What a plan separates, ascending by separation.

        Each combination at one prior standard deviation of each coefficient in it, from
        each rival at its most absorbing constants.
        """
        n = self.size
        m = self.of(chosen)
        profiled = m[n:, n:] - m[n:, :n] @ np.linalg.solve(m[:n, :n], m[:n, n:])
        lambdas = self.lambdas(m)
        records = []
        for k in self.hardest(chosen):
            target = self.targets[k]
            columns = target.form.at
            energy = target.shares @ profiled[np.ix_(columns, columns)] @ target.shares
            record = SeparationRecord(
                *target.key,
                detectability=max(float(energy), 0.0) ** 0.5,
                separation=float(lambdas[k]) ** 0.5,
                before=None,
            )
            records.append(record)
        return sorted(records, key=lambda record: record.separation)

    # -- relaxation --------------------------------------------------------------------
    def at(self, active: Index, weights: Array) -> Array:
        """M (m, m)."""
        runs = np.tensordot(weights, self.grams[active], axes=1)
        return self.base + runs

    def value(self, active: Index, weights: Array) -> float:
        """The compound, smoothed."""
        return float(self.worth(self.at(active, weights), self.sharp))

    def smoothed(self, cost: Array | None, sharp: float) -> "Separation":
        """The objective over weights, or over their costs (C,), at a sharpness."""
        grams = self.grams if cost is None else self.grams / cost[:, None, None]
        return dataclasses.replace(self, grams=grams, sharp=sharp)

    def tangent(self, active: Index, weights: Array) -> Tangent:
        """The tangent of the weighted mean of log lambdas, above their minimum."""
        m = self.at(active, weights)
        logs, table, _ = self._log_lambdas(m, self.grams)
        shares = special.softmax(-self.sharp * logs)
        of_volume, _ = self._volume(m, self.grams)
        slopes = self.share * of_volume + (1.0 - self.share) * shares @ table
        volume = float(self.log_det(m) / self.size)
        height = self.share * volume + (1.0 - self.share) * float(shares @ logs)
        offset = height - float(weights @ slopes[active])
        return Tangent(float(self.worth(m)), slopes, 0.0, offset, linear=True)

    def derivatives(self, active: Index, weights: Array) -> tuple[Array, Array]:
        """Slopes and curvature of the smoothed compound."""
        m = self.at(active, weights)
        grams = self.grams[active]
        logs, table, curvatures = self._log_lambdas(m, grams)
        shares = special.softmax(-self.sharp * logs)
        mean = shares @ table
        covariance = (table.T * shares) @ table - np.outer(mean, mean)
        bend = np.tensordot(shares, curvatures, axes=1) + self.sharp * covariance
        of_volume, volume_bend = self._volume(m, grams)
        slopes = self.share * of_volume + (1.0 - self.share) * mean
        curvature = self.share * volume_bend + (1.0 - self.share) * bend
        return np.asarray(slopes), np.asarray(curvature)

    def _volume(self, m: Array, grams: Array) -> tuple[Array, Array]:
        """Slopes (C,) and curvature (C, C) of log det over n."""
        n = self.size
        relative = np.linalg.inv(m[:n, :n]) @ grams[:, :n, :n]
        flat = relative.reshape(len(grams), -1)
        transposed = np.swapaxes(relative, 1, 2).reshape(len(grams), -1)
        return np.trace(relative, axis1=1, axis2=2) / n, flat @ transposed.T / n

    def _log_lambdas(self, m: Array, grams: Array) -> tuple[Array, Array, Array]:
        """log lambda (T,), its slopes (T, C) and curvatures (T, C, C)."""
        n = self.size
        logs = []
        slopes = []
        curvatures = []
        for t in self.targets:
            nuisance = np.concatenate([np.arange(n), n + t.rival.at])
            precision = np.concatenate([np.zeros(n), t.rival.precision])
            target = np.zeros(len(m))
            target[n + t.form.at] = t.shares
            inner = m[np.ix_(nuisance, nuisance)] + np.diag(precision)
            inverse = np.linalg.inv(inner)
            v = target.copy()
            v[nuisance] -= inverse @ (m[nuisance] @ target)
            lam = max(float(target @ m @ v), MIN_LAMBDA)
            moved = grams @ v
            slope = np.asarray(moved @ v / lam)
            u = moved[:, nuisance]
            logs.append(np.log(lam))
            slopes.append(slope)
            curvatures.append(2.0 * u @ inverse @ u.T / lam + np.outer(slope, slope))
        return np.array(logs), np.array(slopes), np.array(curvatures)

    def subset(self, chosen: Index) -> "Separation":
        """Over some of the candidates only."""
        return dataclasses.replace(self, grams=self.grams[chosen])

    def with_targets(self, numbers: Sequence[int]) -> "Separation":
        """Of some of the targets only, over the columns that these have."""
        targets = [self.targets[k] for k in numbers]
        sets = [columns.at for t in targets for columns in (t.form, t.rival)]
        used = np.unique(np.concatenate(sets))
        retained = np.concatenate([np.arange(self.size), self.size + used])
        return dataclasses.replace(
            self,
            grams=self.grams[:, retained[:, None], retained],
            base=self.base[np.ix_(retained, retained)],
            targets=tuple(t.among(used) for t in targets),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class SeparationEvaluator(PlanEvaluator):
    """Values of plans by the compound.

    Level 0 smooths the minimum, so that an exchange may help several targets.
    """

    separation: Separation

    @property
    def count(self) -> int:
        """Candidates."""
        return self.separation.count

    @property
    def levels(self) -> int:
        """The smoothed minimum, and the minimum itself."""
        return 2

    def value(self, chosen: Index) -> float:
        """The compound."""
        return self.regularised_value(chosen, 1)

    def regularised_value(self, chosen: Index, level: int) -> float:
        """The compound at a level."""
        m = self.separation.of(chosen)
        return float(self.separation.worth(m, EXCHANGE_LEVELS[level]))

    def values_after_adding(
        self, chosen: Index, level: int, ridge: float | None = None
    ) -> Array:
        """The compound at a level, of the plan with each candidate (C,) added."""
        m = self.separation.of(chosen) + self.separation.grams
        return self.separation.worth(m, EXCHANGE_LEVELS[level])

    def subset(self, pool: Index) -> "SeparationEvaluator":
        """Over some of the candidates."""
        return SeparationEvaluator(self.separation.subset(pool))
