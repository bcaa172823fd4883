"""Readings of a virtual machine that has unmodelled effects, and what is true of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from oed import dataset, units
from oed.arrays import Array
from oed.effect import Effect, State
from oed.gap.data import signature
from oed.gap.data import state as states_of
from oed.measurement import Measurement, Series
from pkm_studies.resolve import gap as resolve_gap
from pkm_studies.resolve.gap import ActingEffect, GapRequest

if TYPE_CHECKING:
    from oed.dataset import Dataset


def laid_out(
    measurement: Measurement, series: Sequence[Series], asked: GapRequest
) -> Dataset:
    """The planned readings, still empty, with the covariates that the study's
    conditions give them.
    """
    rows = resolve_gap.covariates(measurement, series, asked.conditions)
    series = [s.parted() for s in series]
    return dataset.from_series(
        series, np.full(len(measurement.owners(series)), np.nan), measurement, rows
    )


def readings(
    measurement: Measurement,
    planned: Dataset,
    truth: Array,
    asked: GapRequest,
    rng: np.random.Generator,
) -> tuple[Array, list[dict[str, Any]]]:
    """Noise-free readings y (N,), SI, of a machine at `truth` (n,) with the acting
    effects; what they are, in words.

    `rng` draws the coefficients that are to be drawn. Raises InputError for
    coefficients that an effect has not.
    """
    series = planned.series
    if not asked.acting:
        return measurement.readings(series, truth), []
    states = states_of.states(
        measurement, series, planned.covariates, truth, asked.gravity
    )
    factors = [_factors(acting, states, rng) for acting in asked.acting]
    chosen = [
        (a.effect, a.constants, f) for a, f in zip(asked.acting, factors, strict=True)
    ]
    y = signature.exact_readings(measurement, series, truth, states, chosen)
    told = []
    for k, acting in enumerate(asked.acting):
        rest = signature.exact_readings(
            measurement, series, truth, states, chosen[:k] + chosen[k + 1 :]
        )
        told.append(_told(acting, factors[k], states, y - rest, planned))
    return y, told


def _scales(
    effect: Effect, constants: Any, states: Sequence[State]
) -> dict[str, tuple[float, bool]]:
    """Prior standard deviation of each coefficient, and whether it only lets the form
    adapt.
    """
    return {
        c.name: (c.scale, c.shape)
        for state in states
        for c in effect.columns(state, **constants)
    }


def _factors(
    acting: ActingEffect, states: Sequence[State], rng: np.random.Generator
) -> dict[str, float]:
    """Coefficients in prior standard deviations."""
    known = _scales(acting.effect, acting.constants, states)
    if acting.coefficients is not None:
        for name in acting.coefficients:
            if name not in known:
                raise resolve_gap.unknown_coefficient(acting.place, name, list(known))
        return {
            name: acting.size * value for name, value in acting.coefficients.items()
        }
    textbook = [name for name, (_, shape) in known.items() if not shape]
    values = (
        rng.standard_normal(len(textbook)) if acting.draw else np.ones(len(textbook))
    )
    return {
        name: acting.size * float(v) for name, v in zip(textbook, values, strict=True)
    }


def _told(
    acting: ActingEffect,
    factors: dict[str, float],
    states: Sequence[State],
    part: Array,
    planned: Dataset,
) -> dict[str, Any]:
    """One effect of the truth file: what it is, its coefficients (SI, and in prior
    standard deviations), its size.
    """
    scales = _scales(acting.effect, acting.constants, states)
    channels = [
        c
        for s in planned.series
        for _ in range(len(s))
        for c in planned.layouts[s.setup].channels
    ]
    names = np.array([c.name for c in channels])
    fine = {c.name: units.FINE[c.unit] for c in channels}
    return {
        "effect": acting.effect.name,
        "constants": dict(acting.constants),
        "coefficients": {
            n: {"value": f * scales[n][0], "prior_sds": f} for n, f in factors.items()
        },
        "rms": {
            f"{n}_{u}": float(units.from_si(np.sqrt(np.mean(part[names == n] ** 2)), u))
            for n, u in fine.items()
        },
    }
