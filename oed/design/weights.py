"""Chooses readings by the weights of the relaxation, instead of an exchange.

The weights w_i, from 0 to 1 with the number of readings as their sum, are optimal for
plans that may hold fractions of readings (Kiefer and Wolfowitz 1960). The plan takes
the readings of largest weight. Its value against the relaxation's bound is its
efficiency. A general conic solver gives the weights too (`oed.design.conic`), which
checks the solver of this project by one that shares no code with it.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from oed.base import Array
from oed.design.blocks import as_blocks, information
from oed.design.bounds import bound
from oed.design.exchange import Choice, Problem, pose
from oed.design.forms import Criterion
from oed.design.relaxation import Relaxation
from oed.design.rules import Rules

#: the methods of this project, and the conic solvers that cvxpy calls
Solver = Literal["built_in", "clarabel", "scs"]


@dataclasses.dataclass(frozen=True, eq=False)
class Weights:
    """Optimal weights of candidates.

    weights      (C,) from 0 to 1, with the number of readings as their sum
    value        of the criterion at the weights, as in `Choice`
    bound        of the criterion for all plans, likewise
    duality_gap  how much better than the value the bound is, in log phi
    choice       the readings of largest weight
    """

    weights: Array
    value: float
    bound: float
    duality_gap: float
    choice: Choice


def choose_by_weights(
    rows: Array,
    size: int,
    criterion: Criterion | str = "D",
    prior: Array | None = None,
    solver: Solver = "built_in",
    tolerance: float = 1e-6,
) -> Weights:
    """Weights of whitened, scaled rows (C, n) or blocks (C, k, n), and a plan.

    size       number of readings
    prior      (n, n) prior information
    tolerance  singular values above this share of the largest count as estimable

    Raises ValueError where no `size` readings determine what the criterion needs, and
    where those of largest weight do not: an exchange may find some.
    """
    columns = as_blocks(rows).shape[2]
    rules = Rules(size=size)
    problem = pose(rows, rules, criterion, prior, tolerance)
    goal, blocks, base = problem.criterion, problem.blocks, problem.base
    optimum = _optimum(problem, rules, size, solver)
    heaviest = np.argsort(-optimum.weights, kind="stable")[:size]
    value = goal.value(base + information(blocks[heaviest]))
    if not np.isfinite(value):
        raise ValueError(
            f"the {size} readings of largest weight do not determine the"
            f" {blocks.shape[2]} directions that the candidates determine"
        )
    choice = Choice(
        indices=np.sort(heaviest),
        criterion=goal.name,
        value=goal.conventional_value(value, size),
        directions=blocks.shape[2],
        columns=columns,
        weak=problem.weak,
    )
    at_weights = goal.value(base + information(blocks, optimum.weights))
    return Weights(
        weights=optimum.weights,
        value=goal.conventional_value(at_weights, size),
        bound=goal.conventional_value(optimum.bound, size),
        duality_gap=optimum.bound - at_weights,
        choice=choice.with_bound(goal, value, optimum.bound, optimum.duality_gap),
    )


def _optimum(problem: Problem, rules: Rules, size: int, solver: Solver) -> Relaxation:
    """The relaxation's weights by a solver."""
    blocks, goal, base = problem.blocks, problem.criterion, problem.base
    if solver == "built_in":
        return bound(blocks, goal, rules, base, rounding=problem.rounding)
    from oed.design import conic  # cvxpy takes a second to import

    name: conic.Solver = "CLARABEL" if solver == "clarabel" else "SCS"
    return conic.relax(blocks, size, goal, base, solver=name)
