"""One case of a campaign: a setting and a seed in, a row of figures out."""

import dataclasses
import functools
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import special

from oed import trust, units
from oed.accuracy import ErrorMaps, driven_errors
from oed.base import Array
from oed.estimation import IdentificationError
from oed.identifiability import Assessment
from oed.mechanism import AssemblyError
from oed.text import shorten
from pkm_studies import catalogue
from pkm_studies.base import Location
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
from pkm_studies.user_code import Consent, Origin

#: columns of every case: what a case function returns has other names
SEED, ERROR, PROCESSOR_TIME = "seed", "error", "cpu_s"
COLUMNS = (SEED, ERROR, PROCESSOR_TIME)

#: failures of a case that are no fault of what computes it
EXPECTED = (IdentificationError, AssemblyError, np.linalg.LinAlgError)

#: computes the figures of a setting and a seed, as numbers, texts and truth values
Figures = Callable[[Mapping[str, Any], int], Mapping[str, Any]]


@dataclasses.dataclass(frozen=True, slots=True)
class Case:
    """What a process needs for a row."""

    figures: Figures  #: computes them
    setting: Mapping[str, Any]  #: the varied values by field
    seed: int  #: of the case


def evaluate(case: Case) -> dict[str, Any]:
    """The row of a case: setting, seed, figures or `error`, processor time in s."""
    row: dict[str, Any] = {**case.setting, SEED: case.seed, ERROR: ""}
    begin = time.process_time()
    try:
        row |= case.figures(case.setting, case.seed)
    except EXPECTED as error:
        row[ERROR] = str(error)
    return {**row, PROCESSOR_TIME: round(time.process_time() - begin, 4)}


# The 95 % interval of a mean over independent cases.

#: standard deviations to either side of a 95 % interval
HALF_WIDTH = float(special.ndtri(0.975))


def mean_interval(values: Sequence[float] | Array) -> tuple[float, float]:
    """Ends of the interval, by the normal law; NaN from one value."""
    count = len(values)
    if count < 2:
        return math.nan, math.nan
    mean = np.mean(values)
    half = HALF_WIDTH * np.std(values, ddof=1) / np.sqrt(count)
    return float(mean - half), float(mean + half)


# Functions of a user that compute the figures of a case, or summarise cases.
#
# A function is named by `path/to/file.py:function`, relative to the campaign, as machines
# are. Every process looks its function up by itself.

MAX_REASON_LENGTH = 150  #: characters of a failure that are shown


class CaseFunctionError(RuntimeError):
    """A case function failed, or returns what no table can hold."""


@dataclasses.dataclass(frozen=True, slots=True)
class UserFunction:
    """A function by name."""

    reference: str  #: its name, see the module
    origin: Origin  #: of the campaign
    file: str  #: of the campaign, for errors

    def load(self, field: str) -> Callable[..., Any]:
        """The function itself. Raises InputError about a field of the campaign."""
        return _loaded(self, field)


@functools.cache
def _loaded(function: UserFunction, field: str) -> Callable[..., Any]:
    location = Location(function.file, field)
    return catalogue.function(function.reference, function.origin, location)


@dataclasses.dataclass(frozen=True, slots=True)
class CaseFunction:
    """Computes the figures of a case by a user's function."""

    function: UserFunction

    def __call__(self, setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
        """The figures, as JSON holds them. Raises CaseFunctionError, and failures of a case."""
        try:
            figures = self.function.load("case")(setting, seed)
        except EXPECTED:
            raise
        except Exception as error:
            raise CaseFunctionError(
                f"with {_words(setting, seed)} it ends with {type(error).__name__}:"
                f" {shorten(str(error), MAX_REASON_LENGTH)}"
            ) from error
        return _checked(figures, setting, seed)


def _words(setting: Mapping[str, Any], seed: int) -> str:
    values = [f"{name} = {value!r}" for name, value in setting.items()]
    return ", ".join([*values, f"seed = {seed}"])


def _checked(figures: Any, setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Figures whose names are their own and whose values JSON can hold."""
    where = f"with {_words(setting, seed)} it returns"
    if not isinstance(figures, Mapping):
        raise CaseFunctionError(f"{where} {type(figures).__name__}, no dictionary")
    taken = [name for name in figures if name in setting or name in COLUMNS]
    if taken:
        raise CaseFunctionError(f"{where} {taken[0]!r}, which names another column")
    try:
        return dict(json.loads(json.dumps(dict(figures), default=_plain)))
    except (TypeError, ValueError) as error:
        raise CaseFunctionError(f"{where} what no table can hold: {error}") from None


def _plain(value: Any) -> Any:
    """A NumPy number as Python's."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a value of type {type(value).__name__}")


# A virtual machine of a study: read, identified, compensated and compared.

CACHE_SIZE = 4  #: prepared combinations that a process remembers


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
        fitted = virtual_fit(state)
        truth = fitted.readings.truth
        assert truth is not None  # a virtual machine has some
        figures = _fit_figures(fitted, truth)
        if state.resolved.prediction is not None:
            figures |= _accuracy_figures(fitted, state.resolved.prediction, truth)
        if self.diagnose:
            figures |= _diagnosis_figures(fitted)
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


def _diagnosis_figures(state: Fitted) -> dict[str, Any]:
    section = written(diagnose_always(state).result.gap, "gap")
    answer = section.answers[0]
    return {
        "verdict": section.verdict,
        "answer": "+".join(sorted(answer.effects)),
        "probability": answer.probability,
        "acting": "+".join(sorted(e["effect"] for e in state.readings.effects)),
    }
