"""A design that allows for effects, and what the plan without them would lose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from oed import estimation
from oed.base import Index
from oed.identifiability import prior_information
from oed.measurement import Measurement, Series
from oed.result import AllowedEffects, RecordingSection
from pkm_studies.base import Stream
from pkm_studies.quantities import fine_units
from pkm_studies.resolve import (
    MAX_EFFECT_UNKNOWNS,
    NO_EFFECTS,
    SESSION_SECONDS,
    DesignRequest,
    PredictionRequest,
    ResolvedStudy,
    effects_of_planned,
    named_effects,
    pose_error_slopes,
)
from pkm_studies.stages.design.criteria import StudyCriteria
from pkm_studies.tables import DesignTable

if TYPE_CHECKING:
    from oed.design import Choice, DesignProblem
    from oed.effects import PlannedEffects


def allowed_effects(
    resolved: ResolvedStudy,
    table: DesignTable,
    request: DesignRequest,
    rng: np.random.Generator,
) -> PlannedEffects | None:
    """What the effects of [design] do to its candidates; None without any.

    Raises InputError for names that are no effects, and where the design cannot allow for
    any.
    """
    if table.effects == NO_EFFECTS:
        return None
    where = check_allowed(resolved, table, request)
    location = resolved.study.location.key("design").key("effects")
    gap = resolved.gap_or_default
    return effects_of_planned(
        resolved.measurement,
        resolved.candidates,
        named_effects(gap, table.effects, location),
        gap,
        where,
        rng,
        MAX_EFFECT_UNKNOWNS,
    )


def planned_names(
    expected: PlannedEffects | None, table: DesignTable
) -> PlannedEffects | None:
    """The effects at the sizes that a plan is chosen for; themselves at expected sizes."""
    size = chosen_size(table)
    return expected if expected is None or size == 1.0 else expected.of_size(size)


def chosen_size(table: DesignTable) -> float:
    """Size of the effects that a plan is chosen for, in expected sizes.

    Those that [design] names are as large as expected. Of the catalogue, a machine has
    few that are: its effects have the typical size that a fit expects of a healthy
    machine. A plan for these loses little on a machine without effects or with large ones.
    """
    return estimation.Discrepancy.HEALTHY if isinstance(table.effects, str) else 1.0


def check_allowed(
    resolved: ResolvedStudy, table: DesignTable, request: DesignRequest
) -> PredictionRequest:
    """Where accuracy counts. Raises InputError where a design can allow for no effect."""
    location = resolved.study.location.key("design").key("effects")
    reasons = {
        'need scaling = "tolerance"': table.scaling != "tolerance",
        "are not known of readings that are part of the plan": bool(request.retained),
        "are not in accuracy by number of readings (how_many)": (
            table.how_many is not None
        ),
        "are not known of poses off the grid (polish)": (
            table.polish is not None and table.polish.enabled
        ),
    }
    for reason, holds in reasons.items():
        if holds:
            raise location.error(
                f"effects beside the geometry {reason}", 'write effects = "none"'
            )
    if resolved.prediction is None:
        raise location.error(
            "what effects do to the tool needs a workspace",
            "add [prediction], or leave effects out",
        )
    return resolved.prediction


def compare_without(
    problem: DesignProblem,
    study_criteria: StudyCriteria,
    choice: Choice,
    without: tuple[DesignProblem, Choice],
) -> AllowedEffects | None:
    """The choice beside that for a machine without effects; None without effects.

    without  the problem without effects, and its choice
    """
    effects = study_criteria.effects
    if effects is None:
        return None
    rigid_problem, rigid = without
    name = study_criteria.table.judged_by
    criterion = study_criteria.candidates_criterion(name, problem.candidates)
    chosen_value = problem.score(criterion, choice.indices)[0]
    rigid_value = problem.score(criterion, rigid.indices)[0]
    rigid_criteria = StudyCriteria(
        study_criteria.resolved, study_criteria.table, study_criteria.request
    )
    alone = rigid_criteria.candidates_criterion(name, rigid_problem.candidates)
    best_alone = rigid_problem.score(alone, rigid.indices)[0]
    chosen_alone = rigid_problem.score(alone, choice.indices)[0]
    none = np.zeros(0, dtype=np.intp)
    return AllowedEffects(
        groups=len(effects.groups),
        unknowns=effects.readings.count,
        efficiency=float(np.exp(rigid_value - chosen_value)),
        efficiency_without=float(np.exp(chosen_alone - best_alone)),
        accuracy=_accuracy(problem, study_criteria, effects, choice.indices),
        accuracy_without=_accuracy(problem, study_criteria, effects, rigid.indices),
        before=_accuracy(problem, study_criteria, effects, none),
        size=chosen_size(study_criteria.table),
    )


def recording(
    criteria: StudyCriteria, measurement: Measurement, series: Sequence[Series]
) -> RecordingSection | None:
    """What else to record beside the readings of a design with effects."""
    resolved, table = criteria.resolved, criteria.table
    if resolved.prediction is None or criteria.effects is None:
        return None
    gap = resolved.gap_or_default
    location = resolved.study.location.key("design").key("effects")
    from pkm_studies.stages.recording import PlanToRecord, recording_section

    return recording_section(
        PlanToRecord(
            measurement=measurement,
            series=tuple(series),
            planned=criteria.effects,
            effects=named_effects(gap, table.effects, location),
            request=gap,
            prediction=resolved.prediction,
            information=prior_information(measurement),
            seconds=SESSION_SECONDS,
            seed=Stream.PLANNED_COURSES.key(resolved.study.seed),
            further={},
        )
    )


def _accuracy(
    problem: DesignProblem,
    study_criteria: StudyCriteria,
    effects: PlannedEffects,
    chosen: Index,
) -> dict[str, float]:
    """Rms error of each component with the chosen readings, in its fine unit."""
    c, maps = problem.candidates, study_criteria.needed_maps
    measurement = c.measurement
    if not study_criteria.table.prior:
        c = c.add_prior(prior_information(measurement))
    total = c.information(chosen)
    covariance = np.linalg.inv(total)
    slopes = pose_error_slopes(c, maps.raw, effects)
    variance = np.einsum("nkp,pq,nkq->k", slopes, covariance, slopes, optimize=True)
    mean = variance / len(slopes) + effects.others
    rms = dict(zip(maps.names, np.sqrt(mean).tolist(), strict=True))
    return fine_units(rms, measurement.machine)
