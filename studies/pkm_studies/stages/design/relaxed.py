"""Chooses the readings of largest weight, and states the weights of the candidates."""

from __future__ import annotations

import numpy as np

from oed.base.arrays import Array
from oed.design.candidates import Candidates
from oed.design.exchange import Choice
from oed.design.weights import choose_by_weights
from oed.result import CandidateWeight, RelaxedSummary
from pkm_studies.base import Place
from pkm_studies.stages.describe import displayed_command
from pkm_studies.stages.design.criteria import StudyCriteria
from pkm_studies.stages.design.search import DesignProblem

#: least weight that is stated
LEAST = 1e-6


def choose_relaxed(
    problem: DesignProblem, study_criteria: StudyCriteria, place: Place
) -> tuple[Choice, RelaxedSummary]:
    """The plan of the largest weights, and the weights.

    Raises InputError where this plan leaves directions undetermined.
    """
    c, table = problem.candidates, study_criteria.table
    criterion = study_criteria.over_candidates(table.judged_by, c)
    solver = table.solver or "built_in"
    size = problem.rules.size
    if size is None:
        reason = "weights need the number of readings, which a budget leaves open"
        raise place.error(reason, "give readings, not budget_min", table.method)
    try:
        weighed = choose_by_weights(c.blocks, size, criterion, c.prior, solver)
    except ValueError as error:
        remedy = "leave method out, ask for more readings, or give more candidates"
        raise place.error(str(error), remedy, table.method) from error
    summary = RelaxedSummary(
        solver=solver,
        value=weighed.value,
        bound=weighed.bound,
        gap=weighed.duality_gap,
        weights=_stated(c, weighed.weights),
    )
    return weighed.choice, summary


def _stated(candidates: Candidates, weights: Array) -> list[CandidateWeight]:
    """The weights that are not 0, largest first."""
    stated = []
    machine = candidates.measurement.machine
    for k in np.argsort(-weights, kind="stable"):
        if weights[k] < LEAST:
            break
        series = candidates.readings_of(np.array([k], dtype=np.intp))[0]
        weight = CandidateWeight(
            setup=series.setup,
            run=str(series.run[0]),
            command=displayed_command(machine, series.reading_commands()[0]),
            weight=float(weights[k]),
        )
        stated.append(weight)
    return stated
