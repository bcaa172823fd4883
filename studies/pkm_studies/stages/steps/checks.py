"""The step that checks recorded readings before anything is fitted to them."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed import checks
from pkm_studies.base import Stream
from pkm_studies.stages.fit.effects import extrapolated_states
from pkm_studies.stages.fit.goodness import check_dataset, goodness_section
from pkm_studies.stages.run_state import Measured, MeasuredReadings


def check_readings(state: Measured) -> Measured:
    """Check the recorded readings that are fitted, and set single outliers aside."""
    readings, data = state.readings, state.resolved.dataset
    if data is None:
        return state
    state.progress.stage("check of the readings")
    fitted = data.take(dict.fromkeys(s.setup for s in readings.series))
    checked = check_dataset(state.resolved, fitted, state.rng(Stream.CHECKS))
    state = state.replace(checked=checked)
    state = state.add_sections(goodness=goodness_section(checked))
    state = state.add_warnings(*[f.sentence for f in checked.findings])
    used, covariates = state.resolved.prediction, readings.covariates
    if used is not None and covariates is not None:
        state = state.add_warnings(*extrapolated_states(used.states, covariates))
    if not checked.set_aside:
        return state
    return state.replace(readings=_drop_readings(readings, checked))


def _drop_readings(
    readings: MeasuredReadings, checked: checks.CheckedSession
) -> MeasuredReadings:
    """The readings that are not set aside, with their covariates."""
    rest = checked.session.without(checked.set_aside)
    covariates = readings.covariates
    if covariates is not None:
        used = np.setdiff1d(np.arange(len(covariates)), checked.set_aside)
        covariates = covariates.iloc[used].reset_index(drop=True)
    return dataclasses.replace(
        readings, series=rest.series, y=rest.y, covariates=covariates
    )
