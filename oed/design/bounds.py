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
from oed.design.blocks import NO_ROUNDING, Rounding, find_copies, quotient_error
from oed.design.forms import Criterion
from oed.design.quotas import QuotaSet
from oed.design.relaxation import Relaxation
from oed.design.rules import RelaxedRules, Rules

#: duality gap from which a conic solver's answer counts as inexact, in log phi
INEXACT_GAP = 1e-3


def bound(
    blocks: Array,
    criterion: Criterion,
    rules: Rules,
    prior: Array,
    rounding: Rounding = NO_ROUNDING,
) -> Relaxation:
    """Relaxation whose bound holds for all plans under the rules, of a concave
    criterion.

    It allows for rounding, except under quotas. Raises ValueError for a criterion
    without a conic form there.
    """
    if rules.quotas is not None:
        return _bound_under_quotas(blocks, criterion, rules, rules.quotas, prior)
    by_candidates: dict[bytes, Relaxation] = {}
    for problem in rules.relaxations(len(blocks)):
        optimum = _relax(blocks, criterion, problem, prior, rounding)
        count = len(blocks)
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
    blocks: Array, criterion: Criterion, rules: Rules, quotas: QuotaSet, prior: Array
) -> Relaxation:
    """The conic solver's bound; one without quotas where, inexact, it is higher."""
    from oed.design import conic  # cvxpy takes a second to import

    size, limits = float(quotas.size), quotas.linear_limits()
    best = conic.relax(blocks, size, criterion, prior, 1.0, limits)
    if best.duality_gap <= INEXACT_GAP:
        return best
    without = bound(blocks, criterion, dataclasses.replace(rules, quotas=None), prior)
    if without.bound >= best.bound:
        return best
    return dataclasses.replace(best, value=without.value, bound=without.bound)


def _relax(
    blocks: Array,
    criterion: Criterion,
    problem: RelaxedRules,
    prior: Array,
    rounding: Rounding,
) -> Relaxation:
    """The relaxation, over v = cost w where there is a cost."""
    candidates, total, cost = problem
    scaled = blocks[candidates]
    if cost is None:
        return _relax_counted(scaled, criterion, total, prior, rounding)
    scaled = scaled / np.sqrt(cost)[:, None, None]
    errors = rounding.rows / float(np.sqrt(cost.min())) + quotient_error(scaled)
    rounding = rounding._replace(rows=errors)
    return _relax_capped(scaled, criterion, total, prior, cost, rounding)


def _relax_counted(
    blocks: Array, criterion: Criterion, total: float, prior: Array, rounding: Rounding
) -> Relaxation:
    """The relaxation over weights of at most 1, which equal candidates share evenly."""
    copies = find_copies(blocks)
    cap: Array | float = 1.0
    if copies.exist:
        blocks = blocks[copies.first]
        cap = copies.number.astype(float)
    optimum = _relax_capped(blocks, criterion, total, prior, cap, rounding)
    if not copies.exist:
        return optimum
    return dataclasses.replace(
        optimum,
        weights=(optimum.weights / copies.number)[copies.label],
        gradient=optimum.gradient[copies.label],
    )


def _relax_capped(
    scaled: Array,
    criterion: Criterion,
    total: float,
    prior: Array,
    cap: Array | float,
    rounding: Rounding,
) -> Relaxation:
    """The relaxation over weights of at most `cap`."""
    extreme = condition.relax_criterion(criterion, scaled, total, prior, cap)
    if extreme is not None:
        return extreme
    return relaxation.relax(
        scaled, total, prior, cap, criterion=criterion, rounding=rounding
    )


def condition_bound(
    blocks: Array, criterion: Criterion, rules: Rules, prior: Array
) -> Relaxation | None:
    """Bound of kappa, O2 and O4 for plans of a given size; None with a budget.

    More readings can make the condition number worse, so a plan within a budget need
    not use it up. Quotas are left out where the conic solver fails, and for O4: that
    only raises the bound.
    """
    if rules.size is None or rules.budget is not None:
        return None
    size = float(rules.size)
    if rules.quotas is not None:
        from oed.design import conic  # cvxpy takes a second to import

        limits = rules.quotas.linear_limits()
        with contextlib.suppress(conic.NoConicAnswerError):
            return conic.relax(blocks, size, criterion, prior, 1.0, limits)
    return condition.relax_criterion(criterion, blocks, size, prior, 1.0)
