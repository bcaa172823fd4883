"""Upper bounds of the criterion over all plans under given rules.

Concave criteria are bounded by their relaxation; under quotas, by a conic solver's. Rules about set-ups are met by one
relaxation for each combination of set-ups, where these are few. Where they are many,
and for rules about distances, the rule is left out, which only raises the bound. E and
the condition number have relaxations of their own.
"""

import contextlib
import dataclasses

import numpy as np

from oed.base import Array
from oed.design import condition, relaxation
from oed.design.blocks import find_copies
from oed.design.forms import ExtremeEigenvalues
from oed.design.objective import CriterionObjective
from oed.design.quotas import QuotaSet
from oed.design.relaxation import Relaxation
from oed.design.rules import RelaxedRules, Rules

#: duality gap from which a conic solver's answer counts as inexact, in log phi
INEXACT_GAP = 1e-3


def bound(objective: CriterionObjective, rules: Rules) -> Relaxation:
    """Relaxation whose bound holds for all plans under the rules, of a concave
    criterion.

    It allows for rounding, except under quotas. Raises ValueError for a criterion
    without a conic form there.
    """
    if rules.quotas is not None:
        return _bound_under_quotas(objective, rules, rules.quotas)
    count = objective.count
    by_candidates: dict[bytes, Relaxation] = {}
    for problem in rules.relaxations(count):
        optimum = _relax(objective, problem)
        weights, gradient = np.zeros(count), np.zeros(count)
        cost = 1.0 if problem.cost is None else problem.cost
        weights[problem.candidates] = optimum.weights / cost
        gradient[problem.candidates] = optimum.gradient
        new = dataclasses.replace(optimum, weights=weights, gradient=gradient)
        key = problem.candidates.tobytes()
        # number and budget both hold: the lower of their bounds does
        if key not in by_candidates or new.bound < by_candidates[key].bound:
            by_candidates[key] = new
    if not by_candidates:
        raise ValueError("the budget does not pay for mounting any set-up")
    return max(by_candidates.values(), key=lambda relaxed: relaxed.bound)


def _bound_under_quotas(
    objective: CriterionObjective, rules: Rules, quotas: QuotaSet
) -> Relaxation:
    """The conic solver's bound; one without quotas where, inexact, it is higher."""
    best = _relax_conic(objective, quotas)
    if best.duality_gap <= INEXACT_GAP:
        return best
    without = bound(objective, dataclasses.replace(rules, quotas=None))
    if without.bound >= best.bound:
        return best
    return dataclasses.replace(best, value=without.value, bound=without.bound)


def _relax_conic(objective: CriterionObjective, quotas: QuotaSet) -> Relaxation:
    from oed.design import conic  # cvxpy takes a second to import

    return conic.relax(
        objective.blocks,
        float(quotas.size),
        objective.criterion,
        objective.base,
        limits=quotas.linear_limits(),
    )


def _relax(objective: CriterionObjective, problem: RelaxedRules) -> Relaxation:
    """The relaxation, over v = cost w where there is a cost."""
    candidates, total, cost = problem
    part = objective.subset(candidates)
    if cost is None:
        return _relax_counted(part, total)
    return _relax_capped(part.over_costs(cost), total, cost)


def _relax_counted(objective: CriterionObjective, total: float) -> Relaxation:
    """The relaxation over weights of at most 1, which equal candidates share evenly."""
    copies = find_copies(objective.blocks)
    if not copies.exist:
        return _relax_capped(objective, total, 1.0)
    kinds = objective.subset(copies.first)
    optimum = _relax_capped(kinds, total, copies.number.astype(float))
    return dataclasses.replace(
        optimum,
        weights=(optimum.weights / copies.number)[copies.label],
        gradient=optimum.gradient[copies.label],
    )


def _relax_capped(
    objective: CriterionObjective, total: float, cap: Array | float
) -> Relaxation:
    """The relaxation over weights of at most `cap`."""
    criterion = objective.criterion
    if isinstance(criterion, ExtremeEigenvalues):
        blocks, base = objective.blocks, objective.base
        return condition.relax(criterion, blocks, total, base, cap)
    return relaxation.relax_objective(objective, total, cap)


def condition_bound(objective: CriterionObjective, rules: Rules) -> Relaxation | None:
    """Bound of kappa, O2 and O4 for plans of a given size; None with a budget, and for
    other criteria.

    More readings can make the condition number worse, so a plan within a budget need
    not use it up. Quotas are left out where the conic solver fails, and for O4: that
    only raises the bound.
    """
    if rules.size is None or rules.budget is not None:
        return None
    if rules.quotas is not None:
        from oed.design import conic  # cvxpy takes a second to import

        with contextlib.suppress(conic.NoConicAnswerError):
            return _relax_conic(objective, rules.quotas)
    if not isinstance(objective.criterion, ExtremeEigenvalues):
        return None
    return _relax_capped(objective, float(rules.size), 1.0)
