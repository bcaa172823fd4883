"""Chooses candidates by exchange, for any criterion and rules, with a certificate.

The relaxation (`oed.design.bounds`) comes first. It gives the bound, and its gradient and
weights guide the search (`oed.design.search`). Where plans have a given number of readings
and no further rule, all pairs of a chosen and another candidate are exchanged at once, for
every criterion (`oed.design.tabu`). Criteria that are not smooth are reached along smooth
ones: E by exchanges that lower tr M^-p while p grows. Exchanges end in local optima, and
bounds by relaxation leave a share open: where there are few plans, all of them are looked
at, which costs less, and proves the best one.
"""

import dataclasses
import itertools
import math
from collections.abc import Iterator

import numpy as np

from oed.base import Array, Index
from oed.design.blocks import (
    NO_ROUNDING,
    Spectrum,
    WhiteCandidates,
    block_array,
    project_orthonormal,
    spectrum,
    whiten,
)
from oed.design.bounds import bound, condition_bound
from oed.design.catalogue import CRITERIA
from oed.design.evaluator import CriterionEvaluator
from oed.design.forms import Criterion, Determinant, ExtremeEigenvalues, Variance
from oed.design.objective import CriterionObjective
from oed.design.relaxation import Relaxation
from oed.design.rules import Rules
from oed.design.search import search, select_greedily

MAX_ENUMERATED_PLANS = 100_000  #: plans that are looked at, at most
NUMBERS_AT_ONCE = 1_000_000  #: numbers in the matrices that are in memory at once
#: plans whose log phi differs by less are equally good: the first one is taken
EQUAL_TOLERANCE = 1e-10


def best_of_all(objective: CriterionObjective, rules: Rules) -> Index | None:
    """The best plan of all; None where these are too many, or other rules hold."""
    size, criterion = rules.sole_size, objective.criterion
    blocks, base = objective.blocks, objective.base
    if size is None or not isinstance(criterion, ExtremeEigenvalues):
        return None
    if math.comb(len(blocks), size) > MAX_ENUMERATED_PLANS:
        return None
    products = blocks.transpose(0, 2, 1) @ blocks
    best = -np.inf
    chosen = None
    for plans in _plans(len(blocks), size, max(NUMBERS_AT_ONCE // products[0].size, 1)):
        matrices = np.broadcast_to(base, (len(plans), *base.shape)).copy()
        for position in range(size):
            matrices += products[plans[:, position]]
        eigenvalues = np.asarray(np.linalg.eigvalsh(matrices), dtype=float)
        values = criterion.eigenvalue_log_phi(eigenvalues)
        if values.max() > best + EQUAL_TOLERANCE:
            best = float(values.max())
            chosen = plans[np.flatnonzero(values >= best - EQUAL_TOLERANCE)[0]]
    return chosen


def _plans(count: int, size: int, part: int) -> Iterator[Index]:
    """All plans (m, size) of so many candidates, some at a time."""
    plans = itertools.combinations(range(count), size)
    while some := list(itertools.islice(plans, part)):
        yield np.array(some, dtype=np.intp)


#: a plan whose log phi is within this of the bound is proven optimal
PROVEN_TOLERANCE = 1e-7
#: log phi by which a bound must stay below what no information exceeds: less is no news
TRIVIAL_MARGIN = 1e-2


@dataclasses.dataclass(frozen=True)
class Choice:
    """Chosen candidates and their certificate.

    Value and bound are log det, least eigenvalue or kappa, and variances (A, c, I, G)
    with a minus sign. No plan under the same rules is better than the bound. Without a bound,
    `bound`, `duality_gap` and `efficiency` are None.

    indices      chosen candidates, ascending
    criterion    name of the criterion
    value        of the plan
    directions   dimension of the estimable subspace, over which the criterion is stated
    columns      number of columns
    weak         directions that are left out although candidates or prior see them,
                 worse than the best one by more than the tolerance
    bound        of all plans
    duality_gap  how much too high the bound can be, as a bound of the relaxation, log phi
    efficiency   phi(plan) / phi(bound): the share of the readings that the best plan
                 would need
    proven       whether no plan is better

    >>> import numpy as np
    >>> from oed.design import choose
    >>> rows = np.eye(4)[[0, 0, 1, 1, 2, 3]]
    >>> design = choose(rows, 4, np.random.default_rng(1), "E")
    >>> design.criterion, design.directions, design.proven
    ('E', 4, True)
    """

    indices: Index
    criterion: str
    value: float
    directions: int
    columns: int
    weak: int = 0
    bound: float | None = None
    duality_gap: float | None = None
    efficiency: float | None = None
    proven: bool = False

    def add_bound(
        self,
        criterion: Criterion,
        value: float,
        upper: float,
        duality_gap: float | None,
    ) -> "Choice":
        """The choice with a bound; its value and the bound `upper` are log phi.

        `duality_gap` is None where it is not known.
        """
        return dataclasses.replace(
            self,
            bound=criterion.conventional_value(upper, len(self.indices)),
            duality_gap=duality_gap,
            efficiency=float(np.exp(min(value - upper, 0.0))),
            proven=upper - value <= PROVEN_TOLERANCE,
        )


def choose(
    rows: Array,
    size: int | None,
    rng: np.random.Generator,
    criterion: Criterion | str = "D",
    *,
    prior: Array | None = None,
    rounds: int = 20,
    tolerance: float = 1e-6,
    certify: bool = True,
    rules: Rules | None = None,
) -> Choice:
    """Chooses different candidates out of whitened, scaled rows.

    rows       (C, n), or blocks (C, k, n)
    size       number of candidates to choose, unless `rules` are given
    prior      (n, n) prior information: tolerances, earlier stages, readings kept.
               Without it the design lives in the estimable subspace
    rounds     rounds of local search
    tolerance  singular values above this share of the largest count as estimable
    certify    False leaves out the bound of criteria that are not smooth; the bound of
               the others comes at no cost

    Raises ValueError where no plan under the rules determines what the criterion needs.

    The D-optimal three readings of a parabola on [-1, 1] lie at its ends and middle:

    >>> import numpy as np
    >>> from oed.design import choose
    >>> x = np.linspace(-1.0, 1.0, 21)
    >>> rows = np.column_stack([np.ones(21), x, x**2])
    >>> design = choose(rows, 3, np.random.default_rng(1))
    >>> x[design.indices]
    array([-1.,  0.,  1.])
    >>> round(design.efficiency, 3)
    1.0
    """
    rules = Rules(size=size) if rules is None else rules
    problem = pose(rows, rules, criterion, prior, tolerance)
    objective = problem.objective
    goal, directions = objective.criterion, objective.directions
    best = best_of_all(objective, rules)
    if best is not None:
        value = objective.value_of(best)
        return problem.choice(best, value).add_bound(goal, value, value, 0.0)
    guiding = _guiding_criterion(goal, directions, rules)
    guide = bound(dataclasses.replace(objective, criterion=guiding), rules)
    evaluator = CriterionEvaluator(objective.blocks, goal, objective.base)
    starts = _greedy_plans(evaluator, rules, guide.weights)
    best = search(evaluator, rules, guide.weights, guide.gradient, starts, rng, rounds)
    value = evaluator.value(best)
    if not rules.satisfied(best):
        raise ValueError(
            "no plan was found that keeps the quotas with the other rules: relax one of them"
        )
    if not np.isfinite(value):
        raise ValueError(
            f"no plan under these rules determines the {directions} directions that the"
            " candidates determine"
        )
    choice = problem.choice(best, value)
    upper = None
    if guiding is goal:
        upper = guide
    elif certify:
        upper = _bound_of(objective, rules)
    if upper is None:
        return choice
    return choice.add_bound(goal, value, upper.bound, upper.duality_gap)


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """The criterion of candidates over the directions that they or the prior determine."""

    objective: CriterionObjective  #: over r directions
    columns: int  #: number of columns of the candidates as given
    weak: int  #: directions left out although candidates or prior see them

    def choice(self, plan: Index, value: float) -> Choice:
        """A plan of this log phi, without a bound."""
        criterion = self.objective.criterion
        return Choice(
            indices=np.sort(plan),
            criterion=criterion.name,
            value=criterion.conventional_value(value, len(plan)),
            directions=self.objective.directions,
            columns=self.columns,
            weak=self.weak,
        )


def pose(
    rows: Array,
    rules: Rules,
    criterion: Criterion | str,
    prior: Array | None,
    tolerance: float = 1e-6,
) -> Problem:
    """The problem of a choice. Raises ValueError where no plan can keep the rules."""
    blocks = block_array(rows)
    goal = criterion
    if isinstance(goal, str):
        goal = CRITERIA.build(goal, blocks.shape[2])
    _check(blocks, rules)
    of_all = spectrum(blocks, prior)
    white = _estimable(blocks, goal, prior, tolerance, of_all)
    if prior is None:
        _check_size(white.blocks, rules)
    objective = CriterionObjective(
        goal.restrict(white.basis), white.blocks, white.prior, white.rounding
    )
    return Problem(objective, blocks.shape[2], of_all.weak(tolerance))


def _estimable(
    blocks: Array,
    goal: Criterion,
    prior: Array | None,
    tolerance: float,
    of_all: Spectrum,
) -> WhiteCandidates:
    """Candidates over determined directions: white for D, else orthonormal."""
    if goal.any_coordinates and of_all.is_ill_conditioned(tolerance):
        return whiten(blocks, prior, tolerance, of_all)
    projected, basis = project_orthonormal(blocks, of_all, tolerance)
    base = np.zeros((basis.shape[1],) * 2)
    if prior is not None:
        base = basis.T @ prior @ basis
    return WhiteCandidates(projected, basis, base, NO_ROUNDING)


def _greedy_plans(
    evaluator: CriterionEvaluator, rules: Rules, weights: Array
) -> list[Index]:
    """Greedy plans by D, and by the criterion, which may be -inf for all at first."""
    determinant = Determinant(evaluator.base.shape[0])
    guides = [dataclasses.replace(evaluator, criterion=determinant)]
    criterion = evaluator.criterion
    if criterion.smooth and criterion.starts_from_own_plan:
        guides.append(evaluator)
    ridge = evaluator.ridge()
    return [select_greedily(g, rules, ridge, weights=weights) for g in guides]


# -- bounds ----------------------------------------------------------------------------
def _check(blocks: Array, rules: Rules) -> None:
    if rules.size is not None and not 0 < rules.size <= len(blocks):
        raise ValueError(
            f"cannot choose {rules.size} different readings out of {len(blocks)} candidates"
        )
    nothing = np.zeros(0, dtype=np.intp)
    if not rules.additions(nothing, len(blocks)).any():
        raise ValueError("the rules allow no reading at all: raise the budget")
    conflict = None if rules.quotas is None else rules.quotas.conflict()
    if rules.quotas is not None and conflict is not None:
        names = ", ".join(rules.quotas.quotas[k].name for k in conflict)
        raise ValueError(
            f"no {rules.size} readings keep the quotas {names} together: relax one of them"
        )


def _check_size(blocks: Array, rules: Rules) -> None:
    _, k, directions = blocks.shape
    if rules.size is not None and rules.size * k < directions:
        raise ValueError(
            f"{rules.size} readings cannot determine the {directions} directions that"
            " the candidates determine"
        )


def _guiding_criterion(
    criterion: Criterion, directions: int, rules: Rules
) -> Criterion:
    """The criterion that guides the search: smooth or, under quotas, conic."""
    if criterion.smooth or (rules.quotas is not None and criterion.concave):
        return criterion
    approach = [c for c in criterion.continuation() if c.smooth and c.concave]
    if criterion.concave and approach:
        return approach[-1]
    return Variance(np.eye(directions), "A")


def _bound_of(objective: CriterionObjective, rules: Rules) -> Relaxation | None:
    """The bound of a criterion that is not smooth; None where none says anything."""
    criterion = objective.criterion
    if criterion.concave:
        return bound(objective, rules)
    upper = condition_bound(objective, rules)
    if upper is None or upper.bound > criterion.ceiling - TRIVIAL_MARGIN:
        return None
    return upper
