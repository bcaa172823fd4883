"""Searches the best plan by exchange, within promising combinations of set-ups.

A set-up brings unknowns of its own, so its first readings determine nothing: exchanges
of single readings never open a new set-up. So combinations of set-ups are ranked first,
each by the relaxation over all its readings, which no plan with these set-ups exceeds,
and the exchange is made in the best ones. Set-ups are added while that helps, then
exchanged one for another. Columns that no candidate of a combination touches are left
out, so that each relaxation stays small.

A plan may also take the readings of largest weight. The weights w_i, from 0 to 1 with
the number of readings as their sum, are optimal for plans that may hold fractions of
readings (Kiefer and Wolfowitz 1960). The plan's value against the relaxation's bound is
its efficiency. A general conic solver gives the weights too (`oed.design.conic`), which
checks the solver of this project by one that shares no code with it.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Literal

import msgspec
import numpy as np

from oed.base import Array, Index
from oed.design import branch, exchange, robust
from oed.design.blocks import project_on_estimable
from oed.design.bounds import bound
from oed.design.candidates import Candidates
from oed.design.exchange import Choice, pose
from oed.design.forms import Criterion
from oed.design.how_many import AccuracyGoal, SizeCurve
from oed.design.objective import CriterionObjective
from oed.design.relaxation import Relaxation, relax_objective
from oed.design.rules import (
    MAX_COMBINATIONS,
    RelaxedRules,
    Rules,
    SetupLimit,
    number_of_combinations,
)
from oed.result import RobustSummary

RANKING_TOLERANCE = 1e-2  #: duality gap in log phi at which combinations are compared
THINNED_SIZE = 60  #: candidates of a set-up that are looked at, about
BEST_COMBINATIONS = 3  #: combinations that are returned, at the most

Combination = tuple[int, ...]


def rank_combinations(
    objective: CriterionObjective, rules: Rules, setups: SetupLimit
) -> list[Combination]:
    """Combinations of at most `setups.most` and mounted set-ups, the best first."""
    names = [int(name) for name in setups.mountable]
    most = setups.most_of(len(names))
    values = _CombinationValues(objective, rules, setups)
    if math.comb(len(names), most) <= MAX_COMBINATIONS:
        combinations = itertools.combinations(names, most)
        return sorted(combinations, key=values.of, reverse=True)[:BEST_COMBINATIONS]
    best: Combination = ()
    for _ in range(most):
        grown = [tuple(sorted((*best, s))) for s in names if s not in best]
        determined = [g for g in grown if np.isfinite(values.of(g))]
        best = max(determined or grown, key=values.of)
    best = _exchange_setups(best, names, values)
    if not values.computed:
        return [best]
    return sorted(values.computed, key=values.of, reverse=True)[:BEST_COMBINATIONS]


def _exchange_setups(
    best: Combination, names: list[int], values: "_CombinationValues"
) -> Combination:
    """The combination after exchanges of one set-up, until none helps."""
    improved = True
    while improved:
        improved = False
        for removed in best:
            remaining = [s for s in best if s != removed]
            exchanged = [
                tuple(sorted((*remaining, new))) for new in names if new not in best
            ]
            candidate = max(exchanged, key=values.of, default=best)
            if values.of(candidate) > values.of(best) + RANKING_TOLERANCE:
                best = candidate
                improved = True
                break
    return best


@dataclasses.dataclass(frozen=True, eq=False)
class _CombinationValues:
    """Relaxed values of combinations of set-ups; each is computed once."""

    objective: CriterionObjective
    rules: Rules
    setups: SetupLimit
    computed: dict[Combination, float] = dataclasses.field(default_factory=dict)

    def of(self, combination: Combination) -> float:
        """log phi of the relaxation; -inf where a direction is undetermined."""
        if combination not in self.computed:
            self.computed[combination] = self._relaxed_value(combination)
        return self.computed[combination]

    def _relaxed_value(self, combination: Combination) -> float:
        chosen = thin(self.setups, combination)
        objective = drop_untouched_columns(self.objective.subset(chosen))
        mounted = [*combination, *self.setups.mounted]
        available = int(np.isin(self.setups.setup, mounted).sum())
        thinning = len(chosen) / available
        rules = self.rules.free_setups(self.setups).subset(chosen)
        try:
            values = [
                _thinned_value(objective, problem, thinning)
                for problem in rules.relaxations(len(chosen))
            ]
        except (ValueError, np.linalg.LinAlgError):
            return -np.inf
        return min(values, default=-np.inf)


def _thinned_value(
    objective: CriterionObjective, problem: RelaxedRules, thinning: float
) -> float:
    """Value of a relaxation; weights of thinned candidates stand for neighbours too."""
    pool, total, cost = problem
    part = objective.subset(pool)
    cap: Array | float = 1.0 / thinning
    if cost is not None:
        part, cap = part.over_costs(cost), cost / thinning
    return relax_objective(part, total, cap, RANKING_TOLERANCE).value


def thin(setups: SetupLimit, combination: Combination) -> Index:
    """Candidates of a combination and of the mounted set-ups, each thinned evenly."""
    thinned = []
    for setup in (*combination, *setups.mounted):
        members = np.flatnonzero(setups.setup == setup)
        thinned.append(members[:: max(1, len(members) // THINNED_SIZE)])
    return np.sort(np.concatenate(thinned)).astype(np.intp)


def drop_untouched_columns(objective: CriterionObjective) -> CriterionObjective:
    """The objective without columns that neither a block nor the prior touches."""
    blocks, base = objective.blocks, objective.base
    uncoupled = np.count_nonzero(base, axis=0) <= 1
    touched = blocks.any(axis=(0, 1)) | ~uncoupled
    if touched.all():
        return objective
    return CriterionObjective(
        objective.criterion.restrict(np.eye(len(base))[:, touched]),
        np.ascontiguousarray(blocks[:, :, touched]),
        base[np.ix_(touched, touched)],
    )


#: the methods of this project, and the conic solvers that cvxpy calls
Solver = Literal["built_in", "clarabel", "scs"]


@dataclasses.dataclass(frozen=True, eq=False)
class Weights:
    """Optimal weights of candidates."""

    weights: Array  #: (C,) from 0 to 1, with the number of readings as their sum
    value: float  #: of the criterion at the weights, as in `Choice`
    bound: float  #: of the criterion for all plans, likewise
    duality_gap: float  #: how much better than the value the bound is, in log phi
    choice: Choice  #: the readings of largest weight


def choose_by_weights(
    rows: Array,
    size: int,
    criterion: Criterion | str = "D",
    prior: Array | None = None,
    solver: Solver = "built_in",
) -> Weights:
    """Weights of rows (C, n) or blocks (C, k, n), and a plan of `size` readings.

    Raises ValueError where the plan leaves undetermined what the criterion needs.
    """
    rules = Rules(size=size)
    problem = pose(rows, rules, criterion, prior)
    objective, goal = problem.objective, problem.objective.criterion
    optimum = _optimum(objective, rules, size, solver)
    heaviest = np.argsort(-optimum.weights, kind="stable")[:size]
    value = objective.value_of(heaviest)
    if not np.isfinite(value):
        raise ValueError(
            f"the {size} readings of largest weight do not determine the"
            f" {objective.directions} directions that the candidates determine"
        )
    choice = problem.choice(heaviest, value)
    at_weights = objective.value(np.arange(objective.count), optimum.weights)
    return Weights(
        weights=optimum.weights,
        value=goal.conventional_value(at_weights, size),
        bound=goal.conventional_value(optimum.bound, size),
        duality_gap=optimum.bound - at_weights,
        choice=choice.add_bound(goal, value, optimum.bound, optimum.duality_gap),
    )


def _optimum(
    objective: CriterionObjective, rules: Rules, size: int, solver: Solver
) -> Relaxation:
    """The relaxation's weights by a solver."""
    if solver == "built_in":
        return bound(objective, rules)
    from oed.design import conic  # cvxpy takes a second to import

    name: conic.Solver = "CLARABEL" if solver == "clarabel" else "SCS"
    blocks, goal, base = objective.blocks, objective.criterion, objective.base
    return conic.relax(blocks, size, goal, base, solver=name)


#: share of the search rounds that a plan for many machines takes, and the fewest of them:
#: each round computes every scenario
ROBUST_ROUNDS_SHARE = 0.25
MIN_ROBUST_ROUNDS = 2


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
        count = len(self.new_setups)
        most = self.setups.most
        too_many = most is not None and most < count
        costly = self.rules.budget is not None and count > 1
        return self.candidates.prior is not None and (too_many or costly)

    @property
    def bound_ignores_setups(self) -> bool:
        """Whether the bound allows any number of set-ups: too many combinations."""
        most = self.setups.most
        if most is None:
            return False
        return number_of_combinations(len(self.new_setups), most) > MAX_COMBINATIONS

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
        m = c.information(chosen)
        if c.prior is None:
            basis = project_on_estimable(c.blocks, None)[1]
            criterion, m = criterion.restrict(basis), basis.T @ m @ basis
        elif self.selects_setups and criterion.spectral:
            basis = self.columns(np.union1d(c.setup[chosen], self.mounted))
            criterion, m = criterion.restrict(basis), basis.T @ m @ basis
        log_phi = criterion.value(m)
        return log_phi, criterion.conventional_value(log_phi, len(chosen))

    def check(self, criterion: Criterion) -> None:
        """Raises ValueError where no plan can keep the rules, whatever the search."""
        c = self.candidates
        if not self.selects_setups:
            rules = self.rules.any_setups
            exchange.pose(c.blocks, rules, criterion, c.prior)

    def best_plan(self, criterion: Criterion, rng: np.random.Generator) -> Choice:
        """The best plan found, with its certificate. Raises ValueError where none exists."""
        c = self.candidates
        if not self.selects_setups:
            return exchange.choose(
                c.blocks,
                None,
                rng,
                criterion,
                prior=c.prior,
                rounds=self.rounds,
                rules=self.rules.any_setups,
            )
        plans: list[Index] = []
        refusals: list[ValueError] = []
        for combination in self._combinations(criterion):
            setup_indices = np.array(combination, dtype=np.intp)
            try:
                plans.append(self._best_within(criterion, setup_indices, rng))
            except ValueError as error:  # set-ups that the budget does not pay for
                refusals.append(error)
        if not plans:
            raise refusals[0]
        best = max(plans, key=lambda indices: self.score(criterion, indices)[0])
        return self._certified(criterion, best)

    def tighten(
        self, criterion: Criterion, choice: Choice, nodes: int, rng: np.random.Generator
    ) -> Choice:
        """A choice with the bound, and perhaps the better plan, of a tree of `nodes`."""
        c = self.candidates
        return branch.tighten(choice, c.blocks, rng, criterion, c.prior, nodes)

    def weigh(self, criterion: Criterion, solver: Solver) -> Weights:
        """The weights of the candidates, and the plan of the largest ones.

        Raises ValueError where a budget leaves the number of readings open, and where
        the plan leaves directions undetermined.
        """
        c = self.candidates
        if self.rules.size is None:
            raise ValueError("weights need the number of readings")
        return choose_by_weights(c.blocks, self.rules.size, criterion, c.prior, solver)

    def chosen_pool(self, choice: Choice) -> tuple[Index, Array]:
        """Candidates of a plan's set-ups, and a basis (n, r) of their columns.

        All candidates and columns, where the search did not have to choose set-ups.
        """
        c = self.candidates
        if not self.selects_setups:
            return np.arange(len(c)), np.eye(c.blocks.shape[2])
        used = c.setup[choice.indices]
        return np.flatnonzero(np.isin(c.setup, used)), self.columns(np.unique(used))

    def choose_robust(
        self,
        criterion: Criterion,
        nominal: Choice,
        scenarios: Array,
        rng: np.random.Generator,
        *,
        risk: robust.Risk,
        tail_share: float,
    ) -> tuple[Choice, RobustSummary]:
        """A plan that serves all scenarios, beside the nominal one, over its set-ups.

        scenarios  (S, C, k, n) blocks of the candidates, those of the problem first

        Raises ValueError as `oed.design.robust.choose`.
        """
        pool, basis = self.chosen_pool(nominal)
        blocks = scenarios[:, pool] @ basis
        restricted = criterion.restrict(basis)
        prior = basis.T @ self.candidates.prior_information @ basis
        choice = robust.choose(
            blocks,
            restricted,
            self.rules.subset(pool).any_setups,
            rng,
            risk=risk,
            tail_share=tail_share,
            prior=prior,
            rounds=max(int(self.rounds * ROBUST_ROUNDS_SHARE), MIN_ROBUST_ROUNDS),
        )
        nominal_rows = np.searchsorted(pool, nominal.indices)
        rows = blocks[:, nominal_rows].reshape(len(blocks), -1, blocks.shape[3])
        log_phi = np.array([restricted.value(prior + r.T @ r) for r in rows])
        summary = msgspec.structs.replace(
            choice.summary,
            nominal=float(robust.aggregate(log_phi, risk, tail_share)),
            nominal_values=log_phi.tolist(),
        )
        indices = pool[choice.indices]
        value = self.score(criterion, indices)[1]
        # the nominal bound holds for this plan as well
        chosen = dataclasses.replace(
            nominal, indices=indices, value=value, efficiency=None, proven=False
        )
        return chosen, summary

    def accuracy(self, factors: Array, choice: Choice) -> Array:
        """Root mean square (K,) of the combinations `factors` (K, r, n) by a plan."""
        goal = AccuracyGoal(("",) * len(factors), factors)
        return goal.accuracy(self.candidates.information(choice.indices))

    def size_curve(
        self,
        choice: Choice,
        names: tuple[str, ...],
        factors: Array,
        seed: Sequence[int],
    ) -> SizeCurve:
        """Accuracy of components by the number of readings, over a plan's set-ups.

        factors  (K, r, n) of the components `names`, in units of the wanted accuracy
        """
        c = self.candidates
        pool, basis = self.chosen_pool(choice)
        rules = self.rules.subset(pool)
        setups = None
        if rules.setups is not None:
            setups = dataclasses.replace(rules.setups, seconds=None, most=None)
        return SizeCurve(
            c.blocks[pool] @ basis,
            basis.T @ c.prior_information @ basis,
            AccuracyGoal(names, factors @ basis),
            tuple(seed),
            rules=dataclasses.replace(rules, time=None, setups=setups),
        )

    def _combinations(self, criterion: Criterion) -> list[tuple[int, ...]]:
        """The best sets of the most set-ups; by budget, of each number."""
        c = self.candidates
        objective = CriterionObjective(criterion.relaxed, c.blocks, c.prior_information)
        if self.rules.budget is None:
            return rank_combinations(objective, self.rules, self.setups)
        combinations = []
        largest = self.setups.most_of(len(self.new_setups))
        for most in range(1, largest + 1):
            limited = dataclasses.replace(self.setups, most=most)
            combinations += rank_combinations(objective, self.rules, limited)[:1]
        return combinations

    def _best_within(
        self, criterion: Criterion, setup_indices: Index, rng: np.random.Generator
    ) -> Index:
        """The best plan with a combination of set-ups and those mounted already."""
        c = self.candidates
        mounted = np.union1d(setup_indices, self.mounted)
        pool = np.flatnonzero(np.isin(c.setup, mounted))
        basis = self.columns(mounted)
        rules = self.rules.subset(pool).any_setups
        choice = exchange.choose(
            c.blocks[pool] @ basis,
            None,
            rng,
            criterion.restrict(basis),
            prior=basis.T @ c.prior_information @ basis,
            rounds=self.rounds,
            certify=False,
            rules=rules,
        )
        return pool[choice.indices]

    def _certified(self, criterion: Criterion, chosen: Index) -> Choice:
        """A plan with its bound over all combinations of set-ups, where one is known."""
        c = self.candidates
        log_phi, value = self.score(criterion, chosen)
        choice = Choice(
            indices=np.sort(chosen),
            criterion=criterion.name,
            value=value,
            directions=len(c.prior_information),
            columns=len(c.prior_information),
        )
        if not criterion.concave or criterion.spectral:
            return choice
        objective = CriterionObjective(criterion, c.blocks, c.prior_information)
        upper = bound(objective, self.rules)
        return choice.add_bound(criterion, log_phi, upper.bound, upper.duality_gap)
