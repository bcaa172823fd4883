"""Robust designs: plans that serve many machines and set-ups, not the nominal one alone.

H depends on the unknown parameters, and on the place of a cup. Scenarios s = 1..S are
drawn from both; each has its own rows for the same candidates. With f_s = log phi(M_s),
a plan is valued by

    "mean"   sum_s f_s / S                         pseudo-Bayesian (Chaloner and
                                                   Verdinelli 1995)
    "cvar"   the mean of the worst share of f_s    Rockafellar and Uryasev (2000)
    "worst"  min_s f_s                             minimax

The mean, the conditional value at risk and the worst case are all the least of
sum_s l_s f_s over shares l in a set of simplex type. So any shares in this set, with
the supporting lines of the f_s, give a bound (joined as in
`oed.design.forms.compound`). The relaxation smooths the least value: shares are
proportional to exp(-sharpness f_s), capped at 1 / (tail_share S).
"""

import dataclasses
from typing import Literal

import numpy as np

from oed.base import Array, Index
from oed.design.blocks import block_array
from oed.design.catalogue import CRITERIA
from oed.design.evaluator import CriterionEvaluator, PlanEvaluator
from oed.design.forms import Criterion
from oed.design.objective import RIDGE_SHARE, CriterionObjective, Tangent
from oed.design.rules import Rules
from oed.design.search import search, select_greedily
from oed.result import RobustSummary

#: sharpness of the smoothed minimum over scenarios, from level to level
SHARPNESS = (4.0, 16.0, 64.0, 256.0, 1024.0)
GAP_TOLERANCE = 1e-4  #: duality gap of the relaxation, in log phi

__all__ = ["Risk", "RobustChoice", "aggregate", "choose"]
Risk = Literal["mean", "cvar", "worst"]


@dataclasses.dataclass(frozen=True)
class RobustChoice:
    """Chosen candidates (n,), ascending, and their values; `nominal` is the plan for the
    first scenario alone.
    """

    indices: Index
    summary: RobustSummary


def choose(
    scenarios: Array,
    criterion: Criterion,
    rules: Rules,
    rng: np.random.Generator,
    *,
    risk: Risk = "mean",
    tail_share: float = 0.2,
    prior: Array | None = None,
    rounds: int = 5,
) -> RobustChoice:
    """Chooses candidates that serve all scenarios (S, C, k, n) of rows.

    tail_share  share of the worst scenarios, for "cvar"
    prior       (n, n) prior information, in each scenario
    rounds      rounds of local search

    The criterion must be smooth, and all n directions must be determined in every
    scenario (by a prior, or by the columns). Raises ValueError otherwise.
    """
    _check(criterion, tail_share)
    n = scenarios.shape[3]
    base = np.zeros((n, n)) if prior is None else prior
    blocks = [block_array(scenario) for scenario in scenarios]
    objectives = tuple(CriterionObjective(criterion, b, base) for b in blocks)
    evaluators = tuple(CriterionEvaluator(b, criterion, base) for b in blocks)
    robust = _ScenarioEvaluator(evaluators, risk, tail_share)
    nominal = evaluators[0]

    def objective(cost: Array | None, sharpness: float) -> RiskObjective:
        parts = objectives
        if cost is not None:
            parts = tuple(o.over_costs(cost) for o in objectives)
        return RiskObjective(parts, risk, tail_share, sharpness)

    levels = SHARPNESS[:1] if risk == "mean" else SHARPNESS
    optimum = rules.relax(len(blocks[0]), objective, levels, lambda _: GAP_TOLERANCE)
    guide = optimum.weights, optimum.gradient
    ridge = nominal.ridge()
    nominal_start = select_greedily(nominal, rules, ridge)
    robust_start = select_greedily(robust, rules, ridge)
    nominal_plan = search(nominal, rules, *guide, [nominal_start], rng, rounds)
    starts = [nominal_plan, nominal_start, robust_start]
    best = search(robust, rules, *guide, starts, rng, rounds)
    values = robust.scenario_values(best)
    if not np.isfinite(values).all():
        raise ValueError(
            "a scenario leaves directions undetermined: give a prior, or more readings"
        )
    value = robust.value(best)
    summary = RobustSummary(
        risk=risk,
        level=tail_share,
        scenarios=len(scenarios),
        value=value,
        bound=float(optimum.bound),
        efficiency=float(np.exp(min(value - optimum.bound, 0.0))),
        nominal=robust.value(nominal_plan),
        values=values.tolist(),
        nominal_values=robust.scenario_values(nominal_plan).tolist(),
    )
    return RobustChoice(np.sort(best), summary)


def _check(criterion: Criterion, tail_share: float) -> None:
    """Raises ValueError as `choose`, for what needs no scenarios."""
    if not criterion.smooth:
        raise ValueError(
            "a robust design needs a smooth criterion"
            f" ({', '.join(CRITERIA.smooth)}), not {criterion.name}"
        )
    if not 0.0 < tail_share <= 1.0:
        raise ValueError(
            f"the share of worst scenarios must lie in (0, 1], not {tail_share}"
        )


@dataclasses.dataclass(frozen=True, eq=False)
class _ScenarioEvaluator(PlanEvaluator):
    """Values of plans by the risk over all scenarios."""

    scenarios: tuple[CriterionEvaluator, ...]
    risk: Risk
    tail_share: float
    levels: int = 1

    @property
    def count(self) -> int:
        return self.scenarios[0].count

    def scenario_values(self, chosen: Index) -> Array:
        """log phi (S,) in each scenario."""
        return np.array([s.value(chosen) for s in self.scenarios])

    def _aggregate(self, values: Array) -> Array:
        return aggregate(values, self.risk, self.tail_share)

    def value(self, chosen: Index) -> float:
        return float(self._aggregate(self.scenario_values(chosen)))

    def regularised_value(self, chosen: Index, level: int) -> float:
        values = [s.regularised_value(chosen, level) for s in self.scenarios]
        return float(self._aggregate(np.array(values)))

    def values_after_adding(
        self, chosen: Index, level: int, ridge: float | None = None
    ) -> Array:
        tables = [s.values_after_adding(chosen, level, ridge) for s in self.scenarios]
        return self._aggregate(np.array(tables))

    def subset(self, pool: Index) -> "_ScenarioEvaluator":
        scenarios = tuple(s.subset(pool) for s in self.scenarios)
        return dataclasses.replace(self, scenarios=scenarios)


# -- scenarios as one objective --------------------------------------------------------
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
    """Shares 1 / (tail_share S) of the worst scenarios, until they sum to one."""
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
        offset = 0.0
        base_term = 0.0
        gradient = np.zeros(self.count)
        for scenario, share in zip(self.scenarios, shares, strict=True):
            tangent = scenario.tangent(active, weights)
            # <S, M> of a line that touches
            size = float(np.exp(tangent.value - tangent.offset))
            offset += share * tangent.value
            base_term += share * tangent.base_term / size
            gradient += share * tangent.gradient / size
        risk = float(aggregate(values, self.risk, self.tail_share))
        return Tangent(risk, gradient, base_term, offset)

    def derivatives(self, active: Index, weights: Array) -> tuple[Array, Array]:
        """Gradient, and curvatures with the response of the shares."""
        shares = self._shares(self._values(active, weights))
        parts = [s.derivatives(active, weights) for s in self.scenarios]
        gradient = np.array([part_gradient for part_gradient, _ in parts])
        curvatures = np.array([part_curvature for _, part_curvature in parts])
        curvature = np.tensordot(shares, curvatures, axes=1)
        mean = shares @ gradient
        if self.risk != "mean":
            covariance = (gradient.T * shares) @ gradient - np.outer(mean, mean)
            curvature = curvature + self.sharpness * covariance
        return mean, np.asarray(curvature)

    def subset(self, chosen: Index) -> "RiskObjective":
        """The objective over a part of the candidates."""
        scenarios = tuple(s.subset(chosen) for s in self.scenarios)
        return dataclasses.replace(self, scenarios=scenarios)

    def regularised(self, weights: Array) -> "RiskObjective":
        """The objective with the first scenario's ridge in each scenario."""
        ridge = RIDGE_SHARE * self.scenarios[0].mean_eigenvalue(weights)
        scenarios = tuple(s.add_ridge(ridge) for s in self.scenarios)
        return dataclasses.replace(self, scenarios=scenarios)
