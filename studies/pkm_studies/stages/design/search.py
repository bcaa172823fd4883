"""The search for a plan: by exchange, within each promising combination of set-ups
where not all can be mounted.

An exchange of single readings never opens a new set-up, whose first readings only tell
where it stands. So combinations of set-ups are ranked by their relaxation first
(`oed.design.setups`), and the exchange is made in each.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from oed.arrays import Array, Index
from oed.design import bounds, exchange, setups
from oed.design.blocks import information, project_on_estimable
from oed.design.candidates import Candidates
from oed.design.criterion import Compound, Criterion, ExtremeEigenvalues, PowerMean
from oed.design.exchange import Choice
from oed.design.rules import MAX_COMBINATIONS, Rules


@dataclasses.dataclass(frozen=True, eq=False)
class DesignProblem:
    """Candidates, the rules of a plan, and rounds of search."""

    candidates: Candidates
    rules: Rules
    starts: int

    @property
    def limited(self) -> bool:
        """Whether it is to be found which set-ups to mount."""
        assert self.rules.setup is not None
        names = np.setdiff1d(
            self.rules.setup, np.array(self.rules.mounted, dtype=np.intp)
        )
        fewer = self.rules.most_setups is not None and self.rules.most_setups < len(
            names
        )
        dear = self.rules.budget is not None and len(names) > 1
        return self.candidates.prior is not None and (fewer or dear)

    @property
    def loose(self) -> bool:
        """Whether the bound leaves it free how many set-ups are mounted: there are too
        many combinations of them.
        """
        assert self.rules.setup is not None
        names, most = (
            len(np.setdiff1d(self.rules.setup, self.rules.mounted)),
            self.rules.most_setups,
        )
        return (
            most is not None
            and sum(math.comb(names, k) for k in range(1, most + 1)) > MAX_COMBINATIONS
        )

    def columns(self, some: Index) -> Array:
        """Columns (n, r) of the identity: of the machine and of the set-ups at
        positions `some`.
        """
        named = [self.candidates.setups[k] for k in some]
        measurement = self.candidates.measurement
        free = [
            n for n, f in zip(measurement.names, measurement.free, strict=True) if f
        ]
        kept = [
            k
            for k, n in enumerate(free)
            if "." not in n or n.rpartition(".")[0] in named
        ]
        kept += range(len(free), len(self.candidates.prior_information))
        return np.eye(len(self.candidates.prior_information))[:, kept]

    def judged(self, criterion: Criterion, chosen: Index) -> tuple[float, float]:
        """log phi of a plan, and the number that users know: over all columns, or, for
        criteria of eigenvalues, over those of its own set-ups; without anything held,
        over the directions that the candidates see.
        """
        c = self.candidates
        m = c.prior_information + information(c.blocks[chosen])
        if c.prior is None:
            basis = project_on_estimable(c.blocks, None)[1]
            criterion, m = criterion.restrict(basis), basis.T @ m @ basis
        elif self.limited and _spectral(criterion):
            basis = self.columns(
                np.union1d(c.setup[chosen], np.array(self.rules.mounted, dtype=np.intp))
            )
            criterion, m = criterion.restrict(basis), basis.T @ m @ basis
        value = criterion.value(m)
        return value, criterion.conventional_value(value, len(chosen))


def best(
    problem: DesignProblem, criterion: Criterion, rng: np.random.Generator
) -> Choice:
    """The best plan found, with what is known of how good it is. Raises ValueError
    where there is none.
    """
    c = problem.candidates
    if not problem.limited:
        rules = dataclasses.replace(problem.rules, most_setups=None)
        return exchange.choose(
            c.blocks, None, rng, criterion, c.prior, problem.starts, rules=rules
        )
    found: list[Index] = []
    refused: list[ValueError] = []
    for some in _combinations(problem, criterion):
        try:
            found.append(
                _within(problem, criterion, np.array(some, dtype=np.intp), rng)
            )
        except ValueError as error:  # set-ups that the budget does not pay for
            refused.append(error)
    if not found:
        raise refused[0]
    chosen = max(found, key=lambda indices: problem.judged(criterion, indices)[0])
    return _certified(problem, criterion, chosen)


def _combinations(
    problem: DesignProblem, criterion: Criterion
) -> list[tuple[int, ...]]:
    """Combinations worth an exchange: the best few of the most set-ups, or the best of
    each number within a budget.
    """
    c, rules = problem.candidates, problem.rules
    assert rules.setup is not None
    names = np.setdiff1d(rules.setup, np.array(rules.mounted, dtype=np.intp))
    most = min(rules.most_setups or len(names), len(names))
    if rules.budget is None:
        return setups.rank_combinations(
            c.blocks, _smooth(criterion), c.prior_information, rules
        )
    found = []
    for count in range(1, most + 1):
        some = dataclasses.replace(rules, most_setups=count)
        found += setups.rank_combinations(
            c.blocks, _smooth(criterion), c.prior_information, some
        )[:1]
    return found


def _smooth(criterion: Criterion) -> Criterion:
    """What combinations are ranked by: the criterion itself, or the last of its ladder
    that has a relaxation.
    """
    ways = [x for x in criterion.continuation() if x.concave and x.smooth]
    return criterion if criterion.concave and criterion.smooth else ways[-1]


def _within(
    problem: DesignProblem, criterion: Criterion, some: Index, rng: np.random.Generator
) -> Index:
    """The best plan within a combination of set-ups."""
    c, rules = problem.candidates, problem.rules
    mounted = np.union1d(some, np.array(rules.mounted, dtype=np.intp))
    pool = np.flatnonzero(np.isin(c.setup, mounted))
    basis = problem.columns(mounted)
    found = exchange.choose(
        c.blocks[pool] @ basis,
        None,
        rng,
        criterion.restrict(basis),
        basis.T @ c.prior_information @ basis,
        problem.starts,
        certify=False,
        rules=dataclasses.replace(rules.subset(pool), most_setups=None),
    )
    return np.asarray(pool[found.indices])


def _certified(problem: DesignProblem, criterion: Criterion, chosen: Index) -> Choice:
    """A plan with its bound over all combinations of set-ups, where one is known."""
    c, (value, number) = problem.candidates, problem.judged(criterion, chosen)
    told = Choice(
        indices=np.sort(chosen),
        criterion=criterion.name,
        value=number,
        directions=len(c.prior_information),
        columns=len(c.prior_information),
    )
    if not criterion.concave or _spectral(criterion):
        return told
    above = bounds.bound(c.blocks, criterion, problem.rules, c.prior_information)
    return dataclasses.replace(
        told,
        bound=criterion.conventional_value(above.value, len(chosen)),
        duality_gap=above.duality_gap,
        efficiency=float(np.exp(min(value - above.value, 0.0))),
        proven=above.value - value <= exchange.PROVEN,
    )


def _spectral(criterion: Criterion) -> bool:
    """Whether a column that no reading touches counts."""
    if isinstance(criterion, Compound):
        return any(map(_spectral, criterion.parts))
    return isinstance(criterion, ExtremeEigenvalues | PowerMean)
