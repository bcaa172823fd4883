"""Effects beside the geometry that a design or plan of a study allows for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed import dataset
from oed.base import Array
from oed.design import Candidates
from oed.effect_model import Effect
from oed.effects import (
    Course,
    PlannedEffects,
    SessionStates,
    draw_courses,
    expected_columns,
    over_courses,
    planned_effects,
)
from oed.gap import GapProblem, assemble
from oed.measurement import Measurement, Series
from pkm_studies.base import Location
from pkm_studies.resolve.gap import GapRequest
from pkm_studies.resolve.prediction import PredictionRequest
from pkm_studies.study import Study

#: values of `effects` that allow none, and all
NO_EFFECTS, ALL_EFFECTS = "none", "catalogue"
#: combinations of effects that are unknowns of candidates, at most
MAX_EFFECT_UNKNOWNS = 60
#: courses of a session that are drawn
DRAWN_COURSES = 8
#: time that a session lasts where nothing says it, s
SESSION_SECONDS = 7200.0


def named_effects(
    request: GapRequest, names: str | Sequence[str], location: Location
) -> list[Effect]:
    """The effects named, or with a word all. Raises InputError for other names."""
    if isinstance(names, str):
        return list(request.effects)
    by_name = {effect.name: effect for effect in request.effects}
    for k, name in enumerate(names):
        if name not in by_name:
            remedy = f"name some of {', '.join(by_name)}"
            raise location.item(k).error("no such effect is tried", remedy, name)
    return [by_name[name] for name in dict.fromkeys(names)]


def check_effect_names(study: Study, request: GapRequest) -> None:
    """Raise InputError for a name in `effects` of a table that is no effect."""
    tables = {
        "design": study.design,
        "plan": study.plan,
        "identify": study.identify,
    }
    for key, table in tables.items():
        if table is not None and table.effects is not None:
            named_effects(
                request, table.effects, study.location.key(key).key("effects")
            )


def effects_of_planned(
    measurement: Measurement,
    series: Sequence[Series],
    effects: Sequence[Effect],
    request: GapRequest,
    prediction: PredictionRequest,
    rng: np.random.Generator,
    most: int,
    seconds: float = SESSION_SECONDS,
) -> PlannedEffects | None:
    """What effects do to planned readings and workspace; None where nothing changes.

    `most` of their combinations are unknowns, the others scatter.

    The order of the readings is not known before they are chosen: what depends on sense
    of travel, time or temperatures counts as if it were not recorded.
    """
    problem, courses = planned_courses(
        measurement, series, request, rng, DRAWN_COURSES, seconds
    )
    columns = expected_columns(problem, effects)
    if columns is None:
        return None
    session = SessionStates.of(problem)
    where, table = prediction.command, prediction.table
    over = over_courses(problem, courses, columns, session, where, table.reference, rng)
    return planned_effects(over, columns, session, problem.sigma, most)


def planned_courses(
    measurement: Measurement,
    series: Sequence[Series],
    request: GapRequest,
    rng: np.random.Generator,
    count: int,
    seconds: float,
    bodies: Sequence[str] = (),
    last: int = 0,
) -> tuple[GapProblem, list[Course]]:
    """Planned readings in courses that a session may take; the first is the problem's.

    Temperatures of `bodies` are recorded; `last` readings repeat the first ones.
    """
    parted = [s.separate_poses() for s in series]
    empty = np.full(len(measurement.setup_of_readings(parted)), np.nan)
    rows = dataset.from_series(parted, empty, measurement, None).covariates
    courses = draw_courses(rows, seconds, count, rng, bodies, last)
    problem = assemble(
        measurement, parted, courses[0].covariates, gravity=request.gravity
    )
    return courses[0].of(problem), courses


def pose_error_slopes(pool: Candidates, raw: Array, effects: PlannedEffects) -> Array:
    """Pose errors (n, k, columns) per unit of each column of candidates with effects.

    raw  (n, k, p) per unit of each parameter of the machine, SI
    """
    measurement = pool.measurement
    poses, components, parameters = raw.shape
    by_parameter = np.zeros((poses, components, len(measurement.names)))
    by_parameter[:, :, :parameters] = raw
    scaled = (by_parameter * measurement.tolerance)[:, :, measurement.free]
    return pool.spread(np.concatenate([scaled, effects.tool], axis=2))
