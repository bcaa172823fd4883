"""Robust designs: plans that are good for many machines and set-ups, not only for the
nominal one.

H depends on the parameters that are to be found, and on where a cup comes to stand.
Scenarios s = 1..S are drawn from both; each has its own rows for the same candidates.
With f_s = log phi(M_s) a plan is judged by

    "mean"   sum_s f_s / S            (pseudo-Bayesian; Chaloner and Verdinelli 1995)
    "cvar"   the mean of the worst share `level` of the f_s (Rockafellar and Uryasev
             2000)
    "worst"  min_s f_s                (minimax)

All three are min over shares l in a simplex-like set of sum_s l_s f_s, so any shares in
it and the supporting lines of the f_s give a bound (the joint one of
`oed.design.criterion.compound`). The relaxation smooths the minimum: shares
proportional to exp(-sharp f_s), capped at 1 / (level S), with `sharp` growing.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from oed.arrays import Array, Index
from oed.design import relaxation
from oed.design.blocks import as_blocks
from oed.design.criterion import Criterion
from oed.design.judge import Single
from oed.design.objective import Plain, Tangent
from oed.design.relaxation import Relaxed
from oed.design.rules import Rules
from oed.design.search import greedy, search

Risk = Literal["mean", "cvar", "worst"]
#: how sharply the smoothed minimum takes the worst scenarios, from rung to rung
SHARP = (4.0, 16.0, 64.0, 256.0, 1024.0)


@dataclasses.dataclass(frozen=True)
class RobustChoice:
    """Chosen candidates, ascending, and what they are worth, as log phi.

    value     by the risk asked for;  values (S,) of each scenario;  bound no plan's
              value exceeds it
    nominal   value of the plan found for the first scenario alone, by the same risk:
              what being robust gains
    """

    indices: Index
    risk: Risk
    value: float
    values: Array
    bound: float
    nominal: float

    @property
    def efficiency(self) -> float:
        """exp(value - bound), at the least."""
        return float(np.exp(min(self.value - self.bound, 0.0)))


def choose(
    scenarios: Array,
    criterion: Criterion,
    rules: Rules,
    rng: np.random.Generator,
    *,
    risk: Risk = "mean",
    level: float = 0.2,
    prior: Array | None = None,
    starts: int = 5,
) -> RobustChoice:
    """Choose candidates that serve all scenarios (S, C, k, n) of rows; `prior` (n, n)
    is held in each.

    The criterion must be smooth and see all n directions in every scenario (give a
    prior, or columns that are seen). Raises ValueError otherwise, or for rules other
    than a number of readings, or a budget.
    """
    if not criterion.smooth:
        raise ValueError(
            "robust designs know smooth criteria (D, Ds, A, c, I, phi_p, O5), not"
            f" {criterion.name}"
        )
    if not 0.0 < level <= 1.0:
        raise ValueError(
            f"the share of worst scenarios must lie in (0, 1], not {level}"
        )
    n = scenarios.shape[3]
    base = np.zeros((n, n)) if prior is None else prior
    parts = tuple(Plain(criterion, as_blocks(s), base) for s in scenarios)
    judge = _RobustJudge(
        tuple(Single(p.blocks, criterion, base) for p in parts), risk, level
    )
    found = _relaxed(parts, rules, risk, level)
    first = judge.parts[0]
    plans = [greedy(first, rules, first.ridge()), greedy(judge, rules, first.ridge())]
    nominal = search(first, rules, found.weights, found.slopes, plans[:1], rng, starts)
    best = search(
        judge, rules, found.weights, found.slopes, [nominal, *plans], rng, starts
    )
    values = judge.each(best)
    if not np.isfinite(values).all():
        raise ValueError(
            "some scenario leaves directions unseen: give a prior, or more readings"
        )
    return RobustChoice(
        np.sort(best),
        risk,
        judge.value(best),
        values,
        found.bound,
        judge.value(nominal),
    )


def _relaxed(
    parts: tuple[Plain, ...], rules: Rules, risk: Risk, level: float
) -> Relaxed:
    """The relaxation under the number of readings, or the budget (mounting left out),
    whichever is tighter.
    """
    best: Relaxed | None = None
    for total, cost in rules.totals(parts[0].count):
        scaled = parts if cost is None else tuple(_per(p, cost) for p in parts)
        found: Relaxed | None = None
        for sharp in SHARP[:1] if risk == "mean" else SHARP:
            objective = _Scenarios(scaled, risk, level, sharp)
            start = None if found is None else found.weights
            again = relaxation.solve(
                objective, total, 1.0 if cost is None else cost, 1e-4, start
            )
            bound = again.bound if found is None else min(again.bound, found.bound)
            found = dataclasses.replace(again, bound=bound)
        assert found is not None
        told = (
            found
            if cost is None
            else dataclasses.replace(found, weights=found.weights / cost)
        )
        best = told if best is None or told.bound < best.bound else best
    assert best is not None
    return best


def _per(part: Plain, cost: Array) -> Plain:
    return dataclasses.replace(part, blocks=part.blocks / np.sqrt(cost)[:, None, None])


def aggregated(values: Array, risk: Risk, level: float) -> Array:
    """Values (S, ...) of the scenarios as one (...)."""
    if risk == "mean":
        return np.asarray(values.mean(axis=0))
    if risk == "worst":
        return np.asarray(values.min(axis=0))
    shares = _worst_shares(len(values), level)
    with np.errstate(invalid="ignore"):
        told = np.tensordot(shares, np.sort(values, axis=0)[: len(shares)], axes=1)
    return np.where(np.isfinite(values).all(axis=0), told, -np.inf)


def _worst_shares(count: int, level: float) -> Array:
    """Shares of the worst scenarios, ascending by value: 1 / (level S) each until they
    sum to one.
    """
    most = 1.0 / (level * count)
    whole = np.minimum(most, np.maximum(1.0 - most * np.arange(count), 0.0))
    return np.asarray(whole[whole > 0])


@dataclasses.dataclass(frozen=True, eq=False)
class _RobustJudge:
    """Exchanges over all scenarios at once."""

    parts: tuple[Single, ...]
    risk: Risk
    level: float
    rungs: int = 1

    @property
    def count(self) -> int:
        return self.parts[0].count

    def each(self, chosen: Index) -> Array:
        return np.array([p.value(chosen) for p in self.parts])

    def value(self, chosen: Index) -> float:
        return float(aggregated(self.each(chosen), self.risk, self.level))

    def held(self, chosen: Index, rung: int) -> float:
        return float(
            aggregated(
                np.array([p.held(chosen, rung) for p in self.parts]),
                self.risk,
                self.level,
            )
        )

    def added(self, chosen: Index, rung: int, ridge: float | None = None) -> Array:
        table = np.array([p.added(chosen, rung, ridge) for p in self.parts])
        return aggregated(table, self.risk, self.level)

    def quick(self, chosen: Index, rung: int) -> Index | None:
        return None

    def take(self, pool: Index) -> _RobustJudge:
        return dataclasses.replace(self, parts=tuple(p.take(pool) for p in self.parts))


@dataclasses.dataclass(frozen=True, eq=False)
class _Scenarios:
    """The smoothed risk as an objective of the relaxation."""

    parts: tuple[Plain, ...]
    risk: Risk
    level: float
    sharp: float

    @property
    def count(self) -> int:
        return self.parts[0].count

    @property
    def directions(self) -> int:
        return self.parts[0].directions

    def _shares(self, values: Array) -> Array:
        """Shares of the scenarios: feasible ones, whatever the sharpness."""
        if self.risk == "mean":
            return np.full(len(values), 1.0 / len(values))
        most = 1.0 if self.risk == "worst" else 1.0 / (self.level * len(values))
        shares = np.exp(-self.sharp * (values - values.min()))
        shares /= shares.sum()
        for _ in range(
            len(values)
        ):  # what exceeds the cap goes to the others, in proportion
            full = shares >= most
            if full.all() or not (shares > most * (1 + 1e-12)).any():
                break
            rest = shares[~full].sum()
            shares = np.where(
                full, most, shares * (1.0 - most * full.sum()) / max(rest, 1e-300)
            )
        return np.asarray(np.minimum(shares, most) / np.minimum(shares, most).sum())

    def value(self, active: Index, weights: Array) -> float:
        """sum_s l_s f_s plus the entropy term that makes the shares optimal."""
        values = np.array([p.value(active, weights) for p in self.parts])
        if not np.isfinite(values).all():
            return -np.inf
        shares = self._shares(values)
        if self.risk == "mean":
            return float(shares @ values)
        held = shares[shares > 0]
        return float(shares @ values + (held @ np.log(held * len(values))) / self.sharp)

    def line(self, active: Index, weights: Array) -> Tangent:
        """The parts' lines, joined by Jensen's inequality; the value is the risk
        itself.
        """
        values = np.array([p.value(active, weights) for p in self.parts])
        shares = self._shares(values)
        offset, held, slopes = 0.0, 0.0, np.zeros(self.count)
        for part, share in zip(self.parts, shares, strict=True):
            line = part.line(active, weights)
            size = float(
                np.exp(line.value - line.offset)
            )  # <S, M> of a line that touches
            offset += share * line.value
            held += share * line.held / size
            slopes += share * line.slopes / size
        return Tangent(
            float(aggregated(values, self.risk, self.level)), slopes, held, offset
        )

    def newton(self, active: Index, weights: Array) -> tuple[Array, Array]:
        """Slopes, and curvatures with the shares' own response."""
        values = np.array([p.value(active, weights) for p in self.parts])
        shares = self._shares(values)
        told = [p.newton(active, weights) for p in self.parts]
        g = np.array([t[0] for t in told])
        curvature = np.tensordot(shares, np.array([t[1] for t in told]), axes=1)
        mean = shares @ g
        if self.risk != "mean":
            curvature = curvature + self.sharp * (
                (g.T * shares) @ g - np.outer(mean, mean)
            )
        return mean, np.asarray(curvature)

    def sample(self, chosen: Index) -> _Scenarios:
        return dataclasses.replace(
            self, parts=tuple(p.sample(chosen) for p in self.parts)
        )

    def typical(self, weights: Array) -> float:
        return self.parts[0].typical(weights)

    def ridged(self, ridge: float) -> _Scenarios:
        return dataclasses.replace(
            self, parts=tuple(p.ridged(ridge) for p in self.parts)
        )
