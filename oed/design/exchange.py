"""Choice of candidates by exchange, for any criterion and under any rules, with a
certificate.

The relaxation (`oed.design.bounds`) comes first: it gives the bound, and its slopes and
weights lead the search (`oed.design.search`). An exchange takes one candidate out and
puts the best one in, by the criterion's exact value after adding (`Criterion.added`); D
of single rows knows all pairs at once (`oed.design.fedorov`). Criteria that are not
smooth are reached over their ladder: E by exchanges that lower tr M^-p while p grows.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array, Index
from oed.design.blocks import as_blocks, seen
from oed.design.bounds import Bound, bound, condition_bound
from oed.design.criterion import Criterion, Determinant, Variance, named
from oed.design.judge import Single
from oed.design.rules import Rules
from oed.design.search import greedy, search

#: log phi within this of the bound is proven optimal
PROVEN = 1e-7


@dataclasses.dataclass(frozen=True)
class Choice:
    """Chosen candidates.

    indices     ascending
    criterion   name;  value, bound in the criterion's own terms (log det, least
                eigenvalue, kappa, ...): no plan under the same rules is better than the
                bound; None where none was computed
    gap         what is known of the bound's own slack as a relaxation (log phi)
    efficiency  phi(plan) / phi(bound): the share of the readings that the best plan
                could do with
    directions  that candidates and prior see, and the criterion is told over; of
                `columns`
    """

    indices: Index
    criterion: str
    value: float
    directions: int
    columns: int
    bound: float | None = None
    gap: float | None = None
    efficiency: float | None = None
    proven: bool = False


def choose(
    rows: Array,
    size: int | None,
    rng: np.random.Generator,
    criterion: Criterion | str = "D",
    prior: Array | None = None,
    starts: int = 20,
    tolerance: float = 1e-6,
    certify: bool = True,
    rules: Rules | None = None,
) -> Choice:
    """Choose different candidates out of rows (C, n) or blocks (C, k, n), whitened and
    scaled: `size` of them, or what `rules` say.

    prior (n, n) is information held already (tolerances, earlier stages, readings
    kept). Without one, the design lives in the directions that the candidates together
    can see (singular values above `tolerance` of the largest): no plan sees more.
    `starts` rounds of local search are made. The bound comes with smooth criteria at no
    cost; for the others, `certify` = False leaves it out. Raises ValueError where no
    plan under the rules determines what the criterion asks for.
    """
    blocks = as_blocks(rows)
    columns = blocks.shape[2]
    rules = Rules(size=size) if rules is None else rules
    wanted = named(criterion, columns) if isinstance(criterion, str) else criterion
    _check(blocks, rules)
    blocks, basis = seen(blocks, prior, tolerance)
    n = blocks.shape[2]
    wanted = wanted.within(basis)
    base = np.zeros((n, n)) if prior is None else basis.T @ prior @ basis
    if prior is None and rules.size is not None and rules.size * blocks.shape[1] < n:
        raise ValueError(
            f"{rules.size} readings cannot determine the {n} directions the"
            " candidates see"
        )
    lead = bound(blocks, _leader(wanted, n), rules, base)
    judge = Single(blocks, wanted, base)
    best = search(
        judge, rules, lead.weights, lead.slopes, _greedy(judge, rules), rng, starts
    )
    value = judge.value(best)
    if not np.isfinite(value):
        raise ValueError(
            f"no plan under these rules determines the {n} directions the"
            " candidates see"
        )
    above = (
        _above(blocks, wanted, rules, base, lead) if wanted.smooth or certify else None
    )
    return _told(best, wanted, value, above, n, columns)


def greedy_d(blocks: Array, size: int, base: Array) -> Index:
    """The greedy D plan of `size` candidates."""
    judge = Single(blocks, Determinant(blocks.shape[2]), base)
    return greedy(judge, Rules(size=size), judge.ridge())


def _greedy(judge: Single, rules: Rules) -> list[Index]:
    """Greedy plans by this criterion and by D: the first may be blind while directions
    are unseen.
    """
    ways = [dataclasses.replace(judge, criterion=Determinant(judge.base.shape[0]))]
    if judge.criterion.smooth and not isinstance(judge.criterion, Determinant):
        ways.append(judge)
    return [greedy(w, rules, judge.ridge()) for w in ways]


# -- bounds ----------------------------------------------------------------------------


def _check(blocks: Array, rules: Rules) -> None:
    if rules.size is not None and not 0 < rules.size <= len(blocks):
        raise ValueError(
            f"cannot choose {rules.size} different readings out of {len(blocks)}"
            " candidates"
        )
    if not rules.allowed(np.zeros(0, dtype=np.intp), len(blocks)).any():
        raise ValueError("the rules allow no reading at all: raise the budget")


def _leader(criterion: Criterion, directions: int) -> Criterion:
    """The smooth criterion whose relaxation leads the search."""
    if criterion.smooth:
        return criterion
    smooth = [c for c in criterion.ladder() if c.smooth and c.concave]
    return (
        smooth[-1]
        if criterion.concave and smooth
        else Variance(np.eye(directions), "A")
    )


def _above(
    blocks: Array, criterion: Criterion, rules: Rules, base: Array, lead: Bound
) -> Bound | None:
    """The bound of the criterion itself."""
    if criterion.smooth:
        return lead
    if criterion.concave:
        return bound(blocks, criterion, rules, base)
    return condition_bound(blocks, criterion, rules, base)


def _told(
    best: Index,
    criterion: Criterion,
    value: float,
    above: Bound | None,
    n: int,
    columns: int,
) -> Choice:
    if above is None:
        return Choice(
            np.sort(best), criterion.name, criterion.told(value, len(best)), n, columns
        )
    return Choice(
        indices=np.sort(best),
        criterion=criterion.name,
        value=criterion.told(value, len(best)),
        directions=n,
        columns=columns,
        bound=criterion.told(above.value, len(best)),
        gap=above.gap,
        efficiency=float(np.exp(min(value - above.value, 0.0))),
        proven=above.value - value <= PROVEN,
    )
