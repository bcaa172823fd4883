"""Risk over scenarios, and its smoothed objective for the relaxation.

The mean, the conditional value at risk and the worst case are all the least of
sum_s l_s f_s over shares l in a set of simplex type. So any shares in this set, with
the supporting lines of the f_s, give a bound (joined as in
`oed.design.criterion.compound`). The relaxation smooths the least value: shares are
proportional to exp(-sharpness f_s), capped at 1 / (tail_share S).
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from oed.base.arrays import Array, Index
from oed.design.objective import RIDGE, CriterionObjective, Tangent

Risk = Literal["mean", "cvar", "worst"]


def aggregate(values: Array, risk: Risk, tail_share: float) -> Array:
    """Values (S, ...) of the scenarios combined to (...)."""
    if risk == "mean":
        return np.asarray(values.mean(axis=0))
    if risk == "worst":
        return np.asarray(values.min(axis=0))
    shares = _tail_shares(len(values), tail_share)
    worst = np.sort(values, axis=0)[: len(shares)]
    with np.errstate(invalid="ignore"):
        mean = np.tensordot(shares, worst, axes=1)
    return np.where(np.isfinite(values).all(axis=0), mean, -np.inf)


def _tail_shares(count: int, tail_share: float) -> Array:
    """Shares of the worst scenarios, ascending by value.

    1 / (tail_share S) each, until they sum to one.
    """
    most = 1.0 / (tail_share * count)
    remaining = np.maximum(1.0 - most * np.arange(count), 0.0)
    shares = np.minimum(most, remaining)
    return np.asarray(shares[shares > 0])


@dataclasses.dataclass(frozen=True, eq=False)
class RiskObjective:
    """The smoothed risk over scenarios as an objective of the relaxation."""

    scenarios: tuple[CriterionObjective, ...]
    risk: Risk
    tail_share: float
    sharpness: float

    @property
    def count(self) -> int:
        """Number of candidates."""
        return self.scenarios[0].count

    @property
    def directions(self) -> int:
        """Number of columns."""
        return self.scenarios[0].directions

    def _values(self, active: Index, weights: Array) -> Array:
        return np.array([s.value(active, weights) for s in self.scenarios])

    def _shares(self, values: Array) -> Array:
        """Feasible shares of the scenarios, whatever the sharpness."""
        if self.risk == "mean":
            return np.full(len(values), 1.0 / len(values))
        most = 1.0
        if self.risk == "cvar":
            most = 1.0 / (self.tail_share * len(values))
        shares = np.exp(-self.sharpness * (values - values.min()))
        shares /= shares.sum()
        # what exceeds the cap goes to the others, in proportion
        for _ in range(len(values)):
            full = shares >= most
            if full.all() or not (shares > most * (1 + 1e-12)).any():
                break
            others = shares[~full].sum()
            raised = shares * (1.0 - most * full.sum()) / max(others, 1e-300)
            shares = np.where(full, most, raised)
        capped = np.minimum(shares, most)
        return np.asarray(capped / capped.sum())

    def value(self, active: Index, weights: Array) -> float:
        """sum_s l_s f_s, plus the entropy term that makes the shares optimal."""
        values = self._values(active, weights)
        if not np.isfinite(values).all():
            return -np.inf
        shares = self._shares(values)
        if self.risk == "mean":
            return float(shares @ values)
        positive = shares[shares > 0]
        entropy = positive @ np.log(positive * len(values))
        return float(shares @ values + entropy / self.sharpness)

    def tangent(self, active: Index, weights: Array) -> Tangent:
        """The scenarios' lines joined by Jensen's inequality; its value is the risk."""
        values = self._values(active, weights)
        shares = self._shares(values)
        offset, base_term, slopes = 0.0, 0.0, np.zeros(self.count)
        for scenario, share in zip(self.scenarios, shares, strict=True):
            tangent = scenario.tangent(active, weights)
            # <S, M> of a line that touches
            size = float(np.exp(tangent.value - tangent.offset))
            offset += share * tangent.value
            base_term += share * tangent.base_term / size
            slopes += share * tangent.slopes / size
        risk = float(aggregate(values, self.risk, self.tail_share))
        return Tangent(risk, slopes, base_term, offset)

    def slopes_and_curvature(
        self, active: Index, weights: Array
    ) -> tuple[Array, Array]:
        """Slopes, and curvatures with the response of the shares."""
        shares = self._shares(self._values(active, weights))
        parts = [s.slopes_and_curvature(active, weights) for s in self.scenarios]
        slopes = np.array([part_slopes for part_slopes, _ in parts])
        curvatures = np.array([part_curvature for _, part_curvature in parts])
        curvature = np.tensordot(shares, curvatures, axes=1)
        mean = shares @ slopes
        if self.risk != "mean":
            covariance = (slopes.T * shares) @ slopes - np.outer(mean, mean)
            curvature = curvature + self.sharpness * covariance
        return mean, np.asarray(curvature)

    def subset(self, chosen: Index) -> RiskObjective:
        """The objective over a part of the candidates."""
        scenarios = tuple(s.subset(chosen) for s in self.scenarios)
        return dataclasses.replace(self, scenarios=scenarios)

    def regularised(self, weights: Array) -> RiskObjective:
        """The objective with the first scenario's ridge in each scenario."""
        ridge = RIDGE * self.scenarios[0].mean_eigenvalue(weights)
        scenarios = tuple(s.with_ridge(ridge) for s in self.scenarios)
        return dataclasses.replace(self, scenarios=scenarios)
