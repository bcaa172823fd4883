"""Expects the errors by effects that a plan does not model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.accuracy.budget import budget_model
from oed.accuracy.maps import ErrorMaps, Reference
from oed.compensate.effects import ExpectedEffect, expected_effects
from oed.compensate.effects.effect_maps import SessionStates
from oed.gap.data import problem as problems
from oed.measurement.measurement import Measurement, Series
from pkm_studies.resolve.gap import GapRequest
from pkm_studies.stages.gap.virtual_readings import empty_readings


def expected_unmodelled(
    measurement: Measurement,
    series: Sequence[Series],
    maps: ErrorMaps,
    request: GapRequest,
    reference: Reference,
    rng: np.random.Generator,
) -> list[ExpectedEffect]:
    """Errors by each effect of a request in planned readings and over the workspace."""
    planned = empty_readings(measurement, series, request)
    problem = problems.assemble(
        measurement, planned.series, planned.covariates, gravity=request.gravity
    )
    model = budget_model(measurement, problem.series, measurement.nominal)
    session = SessionStates(
        measurement, planned.covariates, problem.states, request.gravity
    )
    return expected_effects(
        problem, session, model, maps, request.effects, reference, rng
    )
