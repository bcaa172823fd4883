"""Simulates readings of a virtual machine that has effects its model lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from oed import dataset, gap, units
from oed.base import Array
from oed.effect_model import State
from oed.gap import states as states_of
from oed.measurement import Measurement, Series
from pkm_studies.resolve import (
    ActingEffect,
    GapRequest,
    planned_covariates,
    unknown_coefficient,
)

if TYPE_CHECKING:
    import pandas as pd

    from oed.dataset import Dataset


class CoefficientPrior(NamedTuple):
    """Prior standard deviation, SI; `shape`: it only lets the form adapt."""

    sd: float
    shape: bool


def empty_readings(
    measurement: Measurement, series: Sequence[Series], request: GapRequest
) -> Dataset:
    """Planned readings without values, with covariates from [gap.conditions]."""
    covariates = planned_covariates(measurement, series, request.conditions)
    parted = [s.separate_poses() for s in series]
    empty = np.full(len(measurement.setup_of_readings(parted)), np.nan)
    return dataset.from_series(parted, empty, measurement, covariates)


def covariates_of(
    measurement: Measurement,
    series: Sequence[Series],
    recorded: pd.DataFrame | None,
    request: GapRequest,
) -> pd.DataFrame:
    """Covariates of readings: the recorded ones, or those of [gap.conditions]."""
    if recorded is not None:
        return recorded
    return empty_readings(measurement, series, request).covariates


def exact_readings(
    measurement: Measurement,
    planned: Dataset,
    truth: Array,
    request: GapRequest,
    rng: np.random.Generator,
) -> tuple[Array, list[dict[str, Any]]]:
    """Readings y (N,) without noise, SI, and the acting effects for the truth file.

    truth   (n,) parameters of the virtual machine, SI
    rng     draws the coefficients that are to be drawn

    Raises InputError for coefficients that an effect does not have.
    """
    series = planned.series
    if not request.acting:
        return measurement.readings(series, truth), []
    states = states_of(measurement, series, planned.covariates, truth, request.gravity)
    factors = [_factors(acting, states, rng) for acting in request.acting]
    acting = [
        (entry.effect, entry.constants, factor)
        for entry, factor in zip(request.acting, factors, strict=True)
    ]
    y = gap.exact_readings(measurement, series, truth, states, acting)
    entries = []
    for k, entry in enumerate(request.acting):
        others = acting[:k] + acting[k + 1 :]
        without = gap.exact_readings(measurement, series, truth, states, others)
        rms = _rms_by_channel(y - without, planned)
        entries.append(_truth_entry(entry, factors[k], states, rms))
    return y, entries


def check_coefficients(
    measurement: Measurement, series: Sequence[Series], request: GapRequest
) -> None:
    """Raises InputError for coefficients that an acting effect does not have."""
    planned = empty_readings(measurement, series, request)
    nominal, covariates = measurement.nominal, planned.covariates
    states = states_of(
        measurement, planned.series, covariates, nominal, request.gravity
    )
    rng = np.random.default_rng(0)
    for acting in request.acting:
        _factors(acting, states, rng)


def _priors(
    acting: ActingEffect, states: Sequence[State]
) -> dict[str, CoefficientPrior]:
    """The prior of each coefficient of an effect, by name."""
    priors = {}
    for state in states:
        for column in acting.effect.columns(state, **acting.constants):
            priors[column.name] = CoefficientPrior(column.scale, column.shape)
    return priors


def _factors(
    acting: ActingEffect, states: Sequence[State], rng: np.random.Generator
) -> dict[str, float]:
    """Coefficients, in prior standard deviations."""
    priors = _priors(acting, states)
    if acting.coefficients is not None:
        for name in acting.coefficients:
            if name not in priors:
                raise unknown_coefficient(acting.location, name, list(priors))
        return {n: acting.size * value for n, value in acting.coefficients.items()}
    textbook = [name for name, prior in priors.items() if not prior.shape]
    values = np.ones(len(textbook))
    if acting.draw:
        values = rng.standard_normal(len(textbook))
    return {n: acting.size * float(v) for n, v in zip(textbook, values, strict=True)}


def _rms_by_channel(change: Array, planned: Dataset) -> dict[str, float]:
    """Root mean square of a change (N,) of the readings, by channel, in fine units."""
    channels = [
        channel
        for s in planned.series
        for _ in range(len(s))
        for channel in planned.layouts[s.setup].channels
    ]
    names = np.array([c.name for c in channels])
    rms = {}
    for name, unit in {c.name: units.FINE[c.unit] for c in channels}.items():
        value = np.sqrt(np.mean(change[names == name] ** 2))
        rms[f"{name}_{unit}"] = float(units.from_si(value, unit))
    return rms


def _truth_entry(
    acting: ActingEffect,
    factors: Mapping[str, float],
    states: Sequence[State],
    rms: dict[str, float],
) -> dict[str, Any]:
    """An effect in the truth file: coefficients, SI and in prior sds, and its size."""
    priors = _priors(acting, states)
    coefficients = {
        name: {"value": factor * priors[name].sd, "prior_sds": factor}
        for name, factor in factors.items()
    }
    return {
        "effect": acting.effect.name,
        "constants": dict(acting.constants),
        "coefficients": coefficients,
        "rms": rms,
    }
