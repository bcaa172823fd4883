"""Upper bounds of the criterion over all plans under given rules.

Concave criteria are bounded by their relaxation; under quotas, by a conic solver's. Rules about set-ups are met by one
relaxation for each combination of set-ups, where these are few. Where they are many,
and for rules about distances, the rule is left out, which only raises the bound. E and
the condition number have relaxations of their own.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array
from oed.design import condition, relaxation
from oed.design.criterion import Criterion, ExtremeEigenvalues
from oed.design.quotas import QuotaSet
from oed.design.relaxation import Relaxation
from oed.design.rules import RelaxedRules, Rules


@dataclasses.dataclass(frozen=True)
class Bound:
    """An upper bound of log phi over all plans.

    value        the bound
    duality_gap  how much too high the bound can be, as a bound of the relaxation
    weights      (C,) weights of the relaxation that attains it
    slopes       (C,) of log phi along each weight, there
    """

    value: float
    duality_gap: float
    weights: Array
    slopes: Array


def bound(
    blocks: Array,
    criterion: Criterion,
    rules: Rules,
    prior: Array,
    tolerance: float = 1e-8,
) -> Bound:
    """Bound over all plans under the rules, for a concave criterion.

    Under quotas also for the condition number. Raises ValueError there for a criterion
    without a conic form.
    """
    if rules.quotas is not None:
        return _bound_under_quotas(blocks, criterion, rules.quotas, prior)
    by_candidates: dict[bytes, Bound] = {}
    for problem in rules.relaxations(len(blocks)):
        optimum = _relax(blocks, criterion, problem, prior, tolerance)
        new = _over_all_candidates(optimum, problem, len(blocks))
        key = problem.candidates.tobytes()
        # number and budget both hold: the lower of their bounds does
        if key not in by_candidates or new.value < by_candidates[key].value:
            by_candidates[key] = new
    if not by_candidates:
        raise ValueError("the budget does not pay for mounting any set-up")
    return max(by_candidates.values(), key=lambda b: b.value)


def has_conic_bound(criterion: Criterion) -> bool:
    """Whether `bound` knows the criterion under quotas."""
    if isinstance(criterion, ExtremeEigenvalues):
        return criterion.concave or criterion.least == criterion.largest
    return criterion.concave


def _bound_under_quotas(
    blocks: Array, criterion: Criterion, quotas: QuotaSet, prior: Array
) -> Bound:
    from oed.design import conic  # cvxpy takes a second to import

    limits = quotas.linear_limits()
    optimum = conic.relax(blocks, float(quotas.size), criterion, prior, 1.0, limits)
    return Bound(optimum.bound, optimum.duality_gap, optimum.weights, optimum.slopes)


def _relax(
    blocks: Array,
    criterion: Criterion,
    problem: RelaxedRules,
    prior: Array,
    tolerance: float,
) -> Relaxation:
    """The relaxation, over v = cost w where there is a cost."""
    candidates, total, cost = problem
    scaled = blocks[candidates]
    cap: Array | float = 1.0
    if cost is not None:
        scaled = scaled / np.sqrt(cost)[:, None, None]
        cap = cost
    if isinstance(criterion, ExtremeEigenvalues):
        optimum = condition.e_optimal(scaled, total, prior, cap)
        ends = np.log([max(optimum.value, 1e-300), optimum.bound])
        value, upper = criterion.least * ends
        return Relaxation(optimum.weights, float(value), float(upper), optimum.slopes)
    return relaxation.relax(scaled, total, prior, cap, tolerance, criterion)


def _over_all_candidates(
    optimum: Relaxation, problem: RelaxedRules, count: int
) -> Bound:
    """The bound with weights and slopes of all candidates (C,), as numbers."""
    weights, slopes = np.zeros(count), np.zeros(count)
    cost = np.ones(len(problem.candidates)) if problem.cost is None else problem.cost
    weights[problem.candidates] = optimum.weights / cost
    slopes[problem.candidates] = optimum.slopes
    return Bound(optimum.bound, optimum.duality_gap, weights, slopes)


def condition_bound(
    blocks: Array, criterion: Criterion, rules: Rules, prior: Array
) -> Bound | None:
    """Bound of kappa, O2 and O4 for plans of a given size; None with a budget.

    More readings can make the condition number worse, so a plan within a budget need
    not use it up.
    """
    plain_size = rules.size is not None and rules.budget is None
    if not plain_size or rules.quotas is not None:
        return None
    assert rules.size is not None
    if not isinstance(criterion, ExtremeEigenvalues):
        return None
    size = float(rules.size)
    if criterion.name == "O4":
        best = condition.o4(blocks, size, prior)
        upper = float(np.log(best.bound))
    else:
        best = condition.relax(blocks, size, prior)
        upper = -float(np.log(best.bound))
    return Bound(upper, best.duality_gap, best.weights, best.slopes)
