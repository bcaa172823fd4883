"""Diagnoses readings of a study and writes the result's section `gap` of it."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from msgspec.structs import replace

from oed import gap, units
from oed.base import Array
from oed.effect_model import Column, Effect
from oed.gap import Diagnosis
from oed.measurement import Measurement, Series
from oed.result import (
    ClosureRecord,
    CoefficientRecord,
    EffectNote,
    GapSection,
    SizeRecord,
    finite_or_none,
)
from pkm_studies.resolve import GapRequest
from pkm_studies.stages.gap import sentences, traces

if TYPE_CHECKING:
    import pandas as pd


def diagnose(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    covariates: pd.DataFrame,
    theta: Array,
    request: GapRequest,
    rng: np.random.Generator,
) -> Diagnosis:
    """The diagnosis of readings y (N,), SI, about fitted parameters theta (n,)."""
    residuals = gap.assemble(
        measurement, series, covariates, theta, y, gravity=request.gravity
    )
    return gap.diagnose(residuals, request.effects, rng)


def gap_section(diagnosis: Diagnosis, effects: Sequence[Effect]) -> GapSection:
    """The diagnosis in display units and in sentences."""
    channel_units, channels = _channels(diagnosis)
    factor = np.array([units.factor(channel_units[name]) for name in channels])
    spots, spots_unit = traces.spots(diagnosis)
    scatter = diagnosis.scatter
    likeliest_first = sorted(diagnosis.marginal.items(), key=lambda item: -item[1])
    section = GapSection(
        verdict=diagnosis.verdict,
        answers=list(diagnosis.answers),
        set95=list(diagnosis.set95),
        where=list(diagnosis.where),
        closure=[_closure(c) for c in diagnosis.closure],
        not_testable=list(diagnosis.not_testable),
        confusable=[list(group) for group in diagnosis.confusable],
        selected=list(diagnosis.selected),
        tried=[e.name for e in effects],
        marginal={name: float(p) for name, p in likeliest_first},
        about={e.name: _note(e, diagnosis) for e in effects},
        constants={name: dict(c) for name, c in diagnosis.constants.items()},
        coefficients=_coefficients(diagnosis, effects),
        sizes=_sizes(diagnosis, channel_units),
        noise=list(diagnosis.noise_words),
        units=channel_units,
        rms_before=_rms_by_channel(diagnosis.before / factor, channels),
        rms_after=_rms_by_channel(diagnosis.after / factor, channels),
        traces=traces.traces(diagnosis),
        spots=spots,
        spots_unit=spots_unit,
        words=[],
        next=list(diagnosis.next),
        unknown={form: float(p) for form, p in diagnosis.likeness.items()},
        nearest=list(diagnosis.nearest),
        scatter=None if scatter is None else scatter.factor,
        scatter_shape="" if scatter is None else scatter.shape,
        scatter_against="" if scatter is None else scatter.against,
        effective_laws=diagnosis.effective_laws,
    )
    return sentences.add_sentences(section)


def _closure(closure: ClosureRecord) -> ClosureRecord:
    """The closure, with None for what is not finite."""
    numbers = msgspec.structs.asdict(closure)
    unknown = [
        n for n, v in numbers.items() if isinstance(v, float) and not isfinite(v)
    ]
    return replace(closure, **dict.fromkeys(unknown))


def _note(effect: Effect, diagnosis: Diagnosis) -> EffectNote:
    missing = diagnosis.not_testable.get(effect.name, "")
    column = ""
    if missing:
        column = sentences.columns_to_record(effect, diagnosis.problem.states)
    note = msgspec.convert(effect, EffectNote, from_attributes=True)
    return replace(note, missing=missing, column=column)


def _channels(diagnosis: Diagnosis) -> tuple[dict[str, str], np.ndarray]:
    """Fine unit of each channel, and the channel of each reading (N,)."""
    setups, rows = diagnosis.problem.measurement.setups, diagnosis.problem.rows
    fine: dict[str, str] = {}
    for name in dict.fromkeys(rows["setup"]):
        fine |= {c.name: units.FINE[c.unit] for c in setups[name].instrument.channels}
    return fine, rows["channel"].to_numpy()


def _rms_by_channel(values: Array, channels: np.ndarray) -> dict[str, float]:
    return {
        str(name): float(np.sqrt(np.mean(values[channels == name] ** 2)))
        for name in dict.fromkeys(channels)
    }


def _sizes(diagnosis: Diagnosis, channel_units: dict[str, str]) -> list[SizeRecord]:
    records = []
    for size in diagnosis.sizes:
        rms, remaining = (
            {n: units.number(v, channel_units[n]) for n, v in values.items()}
            for values in (size.rms, size.remaining)
        )
        detectability = finite_or_none(size.detectability)
        records.append(SizeRecord(size.effect, rms, detectability, remaining))
    return records


def _coefficients(
    diagnosis: Diagnosis, effects: Sequence[Effect]
) -> list[CoefficientRecord]:
    """Coefficients, SI, with the prior standard deviation of each."""
    by_name = {effect.name: effect for effect in effects}
    priors = {
        (effect.name, column.name): column
        for effect in effects
        if effect.name in diagnosis.selected
        for column in _columns(effect, diagnosis)
    }
    records = []
    for c in diagnosis.coefficients:
        column = priors.get((c.effect, c.name))
        effect = by_name.get(c.effect)
        if effect is not None:
            c = replace(c, unit=effect.unit(c.name))
        if column is not None:
            c = replace(c, prior_sd=column.scale, shape=column.shape)
        records.append(c)
    return records


def _columns(effect: Effect, diagnosis: Diagnosis) -> list[Column]:
    """All columns of an effect, over its constants and the set-ups."""
    columns: list[Column] = []
    for constants in effect.constant_grid():
        for state in diagnosis.problem.states:
            columns += effect.columns(state, **constants)
    return columns
