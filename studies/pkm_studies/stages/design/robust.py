"""Chooses a plan for many machines, drawn from the tolerances of parameters."""

from __future__ import annotations

import dataclasses

import msgspec
import numpy as np

from oed.base.arrays import Array, Index
from oed.design import candidates, robust
from oed.design.criterion import Criterion
from oed.design.exchange import Choice
from oed.measurement import simulation
from oed.mechanism.kinematics import AssemblyError
from oed.result import RobustSummary
from pkm_studies.base import Place
from pkm_studies.stages.design.criteria import StudyCriteria
from pkm_studies.stages.design.how_many import chosen_pool
from pkm_studies.stages.design.search import DesignProblem
from pkm_studies.tables import RobustTable

#: machines drawn for each scenario until one reaches all candidates
TRIES = 5
#: share of the search rounds, and the fewest of them
ROUNDS_SHARE, MIN_ROUNDS = 4, 2


def choose_robust(
    problem: DesignProblem,
    study_criteria: StudyCriteria,
    nominal: Choice,
    table: RobustTable,
    rng: np.random.Generator,
    place: Place,
) -> tuple[Choice, RobustSummary]:
    """The robust plan over the nominal plan's set-ups, and what it gains over that.

    Raises InputError for criteria that are not smooth, and where drawn machines cannot
    reach the candidates.
    """
    c, judged_by = problem.candidates, study_criteria.table.judged_by
    pool, basis = chosen_pool(problem, nominal)
    blocks = _scenarios(problem, study_criteria, table.scenarios, rng, place)
    blocks = blocks[:, pool] @ basis
    criterion = study_criteria.over_candidates(judged_by, c)
    within = criterion.restrict(basis)
    prior = basis.T @ c.prior_information @ basis
    try:
        choice = robust.choose(
            blocks,
            within,
            problem.rules.subset(pool).without_most_setups,
            rng,
            risk=table.risk,
            tail_share=table.level,
            prior=prior,
            rounds=max(problem.rounds // ROUNDS_SHARE, MIN_ROUNDS),
        )
    except ValueError as error:
        raise place.key("risk").error(
            str(error), "choose D, Ds, A, c, I or O5, or leave the table out"
        ) from error
    nominal_rows = np.searchsorted(pool, nominal.indices)
    nominal_values = _log_phis(blocks, within, prior, nominal_rows)
    of_nominal = robust.aggregate(nominal_values, table.risk, table.level)
    summary = msgspec.structs.replace(
        choice.summary,
        nominal=float(of_nominal),
        nominal_values=nominal_values.tolist(),
    )
    indices = pool[choice.indices]
    value = problem.score(criterion, indices)[1]
    # the nominal bound holds for this plan as well
    robust_choice = dataclasses.replace(
        nominal, indices=indices, value=value, efficiency=None, proven=False
    )
    return robust_choice, summary


def _scenarios(
    problem: DesignProblem,
    study_criteria: StudyCriteria,
    count: int,
    rng: np.random.Generator,
    place: Place,
) -> Array:
    """Blocks (S, C, k, n) of the same commands on drawn machines; first the nominal."""
    c = problem.candidates
    measurement, table = c.measurement, study_criteria.table
    blocks = [c.blocks]
    failures = 0
    while len(blocks) < count:
        theta = simulation.draw_parameters(measurement, rng)
        try:
            scenario = candidates.build(
                measurement,
                c.series,
                theta,
                table.scaling,
                whole_runs=table.whole_runs,
                nuisances=c.nuisances,
            )
        except AssemblyError as error:
            failures += 1
            if failures > TRIES * count:
                raise place.key("scenarios").error(
                    f"machines within the tolerances cannot reach all candidates: {error}",
                    "narrow the candidates, or the tolerances",
                ) from error
            continue
        blocks.append(scenario.blocks)
    return np.array(blocks)


def _log_phis(
    blocks: Array, criterion: Criterion, prior: Array, chosen: Index
) -> Array:
    """log phi (S,) of a plan in each scenario."""
    rows = blocks[:, chosen].reshape(len(blocks), -1, blocks.shape[3])
    return np.array([criterion.value(prior + r.T @ r) for r in rows])
