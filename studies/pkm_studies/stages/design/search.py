"""Searches the best plan by exchange, within promising combinations of set-ups.

An exchange of single readings never opens a new set-up, whose first readings only tell
where it stands. So combinations of set-ups are ranked by their relaxation first
(`oed.design.setups`), and the exchange is made in each.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from oed.base import Array, Index
from oed.design import bounds, branch, exchange
from oed.design.blocks import information, project_on_estimable
from oed.design.candidates import Candidates
from oed.design.exchange import Choice
from oed.design.forms import Compound, Criterion, ExtremeEigenvalues, PowerMean
from oed.design.plan_limits import SetupLimit
from oed.design.rules import MAX_COMBINATIONS, Rules
from oed.design.setups import rank_combinations


@dataclasses.dataclass(frozen=True, eq=False)
class DesignProblem:
    """Candidates, the rules of a plan, and the number of search rounds."""

    candidates: Candidates
    rules: Rules
    rounds: int

    @property
    def setups(self) -> SetupLimit:
        """Set-ups of the candidates, and the rule about them."""
        return self.rules.setups or SetupLimit(self.candidates.setup)

    @property
    def mounted(self) -> Index:
        """Set-ups that are mounted already."""
        return np.array(self.setups.mounted, dtype=np.intp)

    @property
    def new_setups(self) -> Index:
        """Set-ups that a plan would have to mount."""
        return self.setups.mountable

    @property
    def selects_setups(self) -> bool:
        """Whether the search has to find out which set-ups to mount."""
        count, most = len(self.new_setups), self.setups.most
        too_many = most is not None and most < count
        costly = self.rules.budget is not None and count > 1
        return self.candidates.prior is not None and (too_many or costly)

    @property
    def bound_ignores_setups(self) -> bool:
        """Whether the bound allows any number of set-ups: too many combinations."""
        count, most = len(self.new_setups), self.setups.most
        if most is None:
            return False
        return sum(math.comb(count, k) for k in range(1, most + 1)) > MAX_COMBINATIONS

    def columns(self, setup_indices: Index) -> Array:
        """Identity columns (n, r) of the machine's parameters and of some set-ups'."""
        candidates = self.candidates
        chosen = [candidates.setups[k] for k in setup_indices]
        names = candidates.measurement.free_names
        columns = [
            k
            for k, name in enumerate(names)
            if "." not in name or name.rpartition(".")[0] in chosen
        ]
        columns += range(len(names), len(candidates.prior_information))
        return np.eye(len(candidates.prior_information))[:, columns]

    def score(self, criterion: Criterion, chosen: Index) -> tuple[float, float]:
        """log phi of a plan, and the number that users know.

        Over all columns; criteria of eigenvalues over those of the plan's set-ups;
        without prior information, over the directions that the candidates see.
        """
        c = self.candidates
        m = c.prior_information + information(c.blocks[chosen])
        if c.prior is None:
            basis = project_on_estimable(c.blocks, None)[1]
            criterion, m = criterion.restrict(basis), basis.T @ m @ basis
        elif self.selects_setups and _spectral(criterion):
            basis = self.columns(np.union1d(c.setup[chosen], self.mounted))
            criterion, m = criterion.restrict(basis), basis.T @ m @ basis
        log_phi = criterion.value(m)
        return log_phi, criterion.conventional_value(log_phi, len(chosen))


def check_plan(problem: DesignProblem, criterion: Criterion) -> None:
    """Raises ValueError where no plan can keep the rules, whatever the search."""
    c = problem.candidates
    if not problem.selects_setups:
        rules = problem.rules.without_most_setups
        exchange.pose(c.blocks, rules, criterion, c.prior)


def best_plan(
    problem: DesignProblem, criterion: Criterion, rng: np.random.Generator
) -> Choice:
    """The best plan found, with its certificate. Raises ValueError where none exists."""
    c = problem.candidates
    if not problem.selects_setups:
        return exchange.choose(
            c.blocks,
            None,
            rng,
            criterion,
            prior=c.prior,
            rounds=problem.rounds,
            rules=problem.rules.without_most_setups,
        )
    plans: list[Index] = []
    refusals: list[ValueError] = []
    for combination in _combinations(problem, criterion):
        setup_indices = np.array(combination, dtype=np.intp)
        try:
            plans.append(_best_within(problem, criterion, setup_indices, rng))
        except ValueError as error:  # set-ups that the budget does not pay for
            refusals.append(error)
    if not plans:
        raise refusals[0]
    best = max(plans, key=lambda indices: problem.score(criterion, indices)[0])
    return _certified(problem, criterion, best)


def branch_and_bound(
    problem: DesignProblem,
    criterion: Criterion,
    choice: Choice,
    nodes: int,
    rng: np.random.Generator,
) -> Choice:
    """A choice with the bound, and perhaps the better plan, of a tree of `nodes`."""
    c = problem.candidates
    return branch.tighten(choice, c.blocks, rng, criterion, c.prior, nodes)


def _combinations(
    problem: DesignProblem, criterion: Criterion
) -> list[tuple[int, ...]]:
    """Combinations of set-ups worth an exchange.

    The best few of the largest number, or within a budget the best of each number.
    """
    c = problem.candidates
    arguments = c.blocks, _smooth(criterion), c.prior_information, problem.rules
    if problem.rules.budget is None:
        return rank_combinations(*arguments, problem.setups)
    combinations = []
    largest = problem.setups.most_of(len(problem.new_setups))
    for most in range(1, largest + 1):
        limited = dataclasses.replace(problem.setups, most=most)
        combinations += rank_combinations(*arguments, limited)[:1]
    return combinations


def _smooth(criterion: Criterion) -> Criterion:
    """The criterion, or the last of its continuation that has a relaxation."""
    if criterion.concave and criterion.smooth:
        return criterion
    return [step for step in criterion.continuation() if step.concave and step.smooth][
        -1
    ]


def _best_within(
    problem: DesignProblem,
    criterion: Criterion,
    setup_indices: Index,
    rng: np.random.Generator,
) -> Index:
    """The best plan with a combination of set-ups and those mounted already."""
    c = problem.candidates
    mounted = np.union1d(setup_indices, problem.mounted)
    pool = np.flatnonzero(np.isin(c.setup, mounted))
    basis = problem.columns(mounted)
    rules = problem.rules.subset(pool).without_most_setups
    choice = exchange.choose(
        c.blocks[pool] @ basis,
        None,
        rng,
        criterion.restrict(basis),
        prior=basis.T @ c.prior_information @ basis,
        rounds=problem.rounds,
        certify=False,
        rules=rules,
    )
    return pool[choice.indices]


def _certified(problem: DesignProblem, criterion: Criterion, chosen: Index) -> Choice:
    """A plan with its bound over all combinations of set-ups, where one is known."""
    c = problem.candidates
    log_phi, value = problem.score(criterion, chosen)
    choice = Choice(
        indices=np.sort(chosen),
        criterion=criterion.name,
        value=value,
        directions=len(c.prior_information),
        columns=len(c.prior_information),
    )
    if not criterion.concave or _spectral(criterion):
        return choice
    bound = bounds.bound(c.blocks, criterion, problem.rules, c.prior_information)
    return dataclasses.replace(
        choice,
        bound=criterion.conventional_value(bound.bound, len(chosen)),
        duality_gap=bound.duality_gap,
        efficiency=float(np.exp(min(log_phi - bound.bound, 0.0))),
        proven=bound.bound - log_phi <= exchange.PROVEN,
    )


def _spectral(criterion: Criterion) -> bool:
    """Whether a column that no reading touches counts."""
    if isinstance(criterion, Compound):
        return any(map(_spectral, criterion.parts))
    return isinstance(criterion, ExtremeEigenvalues | PowerMean)
