"""A virtual machine of a study: read, identified, compensated and compared."""

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from oed import trust, units
from oed.accuracy import ErrorMaps, driven_errors
from oed.base import Array
from oed.identifiability import Assessment
from pkm_campaign.case import HALF_WIDTH
from pkm_studies.resolve import PredictionRequest
from pkm_studies.stages import (
    Fitted,
    Scheduled,
    diagnose_always,
    scheduled,
    virtual_fit,
    written,
)
from pkm_studies.study import Study
from pkm_studies.user_code import Consent

#: prepared combinations that a process remembers
CACHE_SIZE = 4


@dataclasses.dataclass(frozen=True, slots=True)
class VirtualMachine:
    """Computes the figures of a virtual machine of a combination.

    study, path    text of the varied study, and the file that its paths start from
    diagnose       whether its readings are diagnosed
    consent        to run Python files that the study names
    """

    study: str
    path: str
    diagnose: bool
    consent: Consent

    def __call__(self, setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
        """The figures of the machine of this seed. Raises what a fit raises."""
        state = _prepared(self.study, self.path, self.consent).replace(seed=seed)
        fitted, truth, effects = virtual_fit(state)
        figures = _fit_figures(fitted, truth)
        if state.resolved.prediction is not None:
            figures |= _accuracy_figures(fitted, state.resolved.prediction, truth)
        if self.diagnose:
            figures |= _diagnosis_figures(fitted, effects)
        return figures


@functools.lru_cache(maxsize=CACHE_SIZE)
def _prepared(text: str, path: str, consent: Consent) -> Scheduled:
    """The state with its plan, made once for all machines of a combination."""
    study: Study = Study.parse(text, Path(path), consent)
    state = scheduled(study)
    scaling = study.design.scaling if study.design else "length"
    verdict = Assessment.of(state.measurement, state.readings.series, scaling)
    return state.replace(identifiability=verdict)


def _fit_figures(state: Fitted, truth: Array) -> dict[str, Any]:
    """Fit and intervals against the true parameters (n,)."""
    estimate, goodness = state.estimate, state.goodness
    objections = trust.section_objections(goodness, state.estimate_section)
    inside, squared, rank = _interval_figures(state, truth)
    return {
        "readings": len(estimate.residuals),
        "rank": rank,
        "chi2": estimate.chi2,
        "dof": estimate.dof,
        "p_value": goodness.p_high,
        "trusted": not objections,
        "inside_95": inside,
        "nees": squared,
    }


def _interval_figures(state: Fitted, truth: Array) -> tuple[float, float, int]:
    """Share of 95 % intervals of identifiable combinations that hold the truth.

    And the mean squared standardised error, the Mahalanobis distance over the rank:
    1 on average where the covariance is right. A combination's true value is the one
    that gives the exact readings with the lost directions at nominal.
    """
    measurement, series = state.measurement, state.readings.series
    estimate = state.estimate
    coordinates = estimate.coordinates
    exact = measurement.readings(series, truth)
    true = coordinates.match_readings(measurement, series, exact, estimate.z)
    error = estimate.z - true
    covariance = coordinates.dual @ estimate.covariance @ coordinates.dual.T
    rank = len(error)
    inside = np.abs(error) <= HALF_WIDTH * np.sqrt(np.diag(covariance))
    squared = error @ np.linalg.solve(covariance, error) / rank
    return float(inside.mean()), float(squared), rank


def _accuracy_figures(
    state: Fitted, request: PredictionRequest, truth: Array
) -> dict[str, Any]:
    """Predicted and realised rms error after compensation, by component."""
    estimate, measurement = state.estimate, state.measurement
    table, command = request.table, request.command
    count = len(measurement.machine.parameters)
    maps = ErrorMaps.of(measurement.kinematics, command, table.reference)
    covariance = estimate.covariance[:count, :count]
    identified, true = estimate.theta[:count], truth[:count]
    correctable = maps.remaining @ (identified - measurement.machine.nominal)
    unknown = np.einsum("nkp,pq,nkq->nk", maps.raw, covariance, maps.raw, optimize=True)
    expected = np.sqrt(np.mean(correctable**2 + unknown, axis=0))
    errors = driven_errors(
        measurement.kinematics, command, true, table.reference, believed=identified
    )
    figures = {}
    for k, component in enumerate(measurement.machine.components):
        unit = units.FINE[component.unit]
        realised = float(np.sqrt(np.mean(errors[:, k] ** 2)))
        name = f"{component.name}_{unit}"
        figures[f"predicted_{name}"] = units.number(float(expected[k]), unit)
        figures[f"realised_{name}"] = units.number(realised, unit)
    return figures


def _diagnosis_figures(state: Fitted, effects: list[dict[str, Any]]) -> dict[str, Any]:
    section = written(diagnose_always(state).result.gap, "gap")
    answer = section.answers[0]
    return {
        "verdict": section.verdict,
        "answer": "+".join(sorted(answer.effects)),
        "probability": answer.probability,
        "acting": "+".join(sorted(e["effect"] for e in effects)),
    }
