"""A plan for many machines: chosen over scenarios of parameters and set-ups drawn from
their tolerances.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed import result
from oed.arrays import Array, Index
from oed.design import candidates, robust
from oed.design.criterion import Criterion
from oed.design.exchange import Choice
from oed.kinematics import AssemblyError
from pkm_studies.errors import Place
from pkm_studies.stages.design.criteria import StudyCriteria
from pkm_studies.stages.design.search import DesignProblem
from pkm_studies.study.tables import RobustTable

#: machines drawn for each scenario until one reaches all candidates
TRIES = 5


def choose(
    problem: DesignProblem,
    aims: StudyCriteria,
    nominal: Choice,
    said: RobustTable,
    rng: np.random.Generator,
    place: Place,
) -> tuple[Choice, result.RobustSummary]:
    """The robust plan over the set-ups that the nominal one mounts, and what it gains
    over that one.

    Raises InputError for criteria that are not smooth, and where drawn machines cannot
    reach the candidates.
    """
    c = problem.candidates
    assert c.setup is not None
    pool = np.flatnonzero(np.isin(c.setup, c.setup[nominal.indices]))
    basis = (
        problem.columns(np.unique(c.setup[nominal.indices]))
        if problem.limited
        else np.eye(c.blocks.shape[2])
    )
    blocks = _scenarios(problem, aims, said.scenarios, rng, place)[:, pool] @ basis
    criterion = aims.criterion(aims.design.judged_by, c).restrict(basis)
    rules = dataclasses.replace(problem.rules.subset(pool), most_setups=None)
    prior = basis.T @ c.prior_information @ basis
    try:
        found = robust.choose(
            blocks,
            criterion,
            rules,
            rng,
            risk=said.risk,
            tail_share=said.level,
            prior=prior,
            rounds=max(problem.starts // 4, 2),
        )
    except ValueError as error:
        raise place.key("risk").error(
            str(error), "choose D, Ds, A, c, I or O5, or leave the table out"
        ) from error
    others = _values(blocks, criterion, prior, np.searchsorted(pool, nominal.indices))
    told = result.RobustSummary(
        risk=said.risk,
        level=said.level,
        scenarios=said.scenarios,
        value=float(found.value),
        bound=float(found.bound),
        efficiency=found.efficiency,
        nominal=float(robust.aggregate(others, said.risk, said.level)),
        values=[float(v) for v in found.values],
        nominal_values=[float(v) for v in others],
    )
    indices = pool[found.indices]
    value = problem.judged(aims.criterion(aims.design.judged_by, c), indices)[1]
    # the nominal bound holds for this plan as well
    return (
        dataclasses.replace(
            nominal, indices=indices, value=value, efficiency=None, proven=False
        ),
        told,
    )


def _scenarios(
    problem: DesignProblem,
    aims: StudyCriteria,
    count: int,
    rng: np.random.Generator,
    place: Place,
) -> Array:
    """Blocks (S, C, k, n) of the same commands on drawn machines; the nominal one
    first.
    """
    c = problem.candidates
    measurement, whole = c.measurement, aims.design.whole_runs
    tables = [c.blocks]
    failed = 0
    while len(tables) < count:
        at = measurement.nominal + measurement.tolerance * rng.standard_normal(
            len(measurement.nominal)
        )
        try:
            made = candidates.build(
                measurement, c.series, at, aims.design.scaling, whole_runs=whole
            )
        except AssemblyError as error:
            failed += 1
            if failed > TRIES * count:
                problem_ = (
                    "machines within the tolerances cannot reach all candidates:"
                    f" {error}"
                )
                raise place.key("scenarios").error(
                    problem_, "narrow the candidates, or the tolerances"
                ) from error
            continue
        tables.append(made.blocks)
    return np.array(tables)


def _values(blocks: Array, criterion: Criterion, prior: Array, chosen: Index) -> Array:
    """log phi (S,) of a plan in each scenario."""
    picked = blocks[:, chosen].reshape(len(blocks), -1, blocks.shape[3])
    return np.array([criterion.value(prior + rows.T @ rows) for rows in picked])
