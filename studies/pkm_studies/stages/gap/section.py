"""Diagnosis of what calibration leaves, as a section of the result: which effect,
where, how far, what next.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from oed import units
from oed.arrays import Array
from oed.effect import Column, Effect
from oed.gap.data import problem as problem_of
from oed.gap.data.diagnosis import UNKNOWN, Answer, Closure, Diagnosis, Size
from oed.measurement import Measurement, Series
from oed.result import gap as result_gap
from pkm_studies.resolve.gap import GapRequest
from pkm_studies.stages.gap import sentences as gap_words
from pkm_studies.stages.gap import traces as gap_traces

if TYPE_CHECKING:
    import pandas as pd


def diagnose(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    covariates: pd.DataFrame,
    theta: Array,
    asked: GapRequest,
    rng: np.random.Generator,
) -> Diagnosis:
    """The diagnosis of readings y (N,), SI, about fitted parameters theta (n,)."""
    from oed.gap.diagnose import diagnose as diagnosed

    prepared = problem_of.assemble(
        measurement, series, covariates, theta, y, gravity=asked.gravity
    )
    return diagnosed(prepared, asked.effects, rng)


def section(found: Diagnosis, effects: Sequence[Effect]) -> result_gap.GapSection:
    """The diagnosis in display units and words."""
    about = {e.name: _about(e, found) for e in effects}
    fine, labels = _channels(found)
    factor = np.array([units.factor(fine[n]) for n in labels])
    spots, spots_unit = gap_traces.spots(found)
    made = result_gap.GapSection(
        verdict=found.verdict,
        answers=[_answer(a) for a in found.answers],
        set95=[_answer(a) for a in found.set95],
        where=[
            result_gap.PlaceRecord(b.block, float(b.p_value), known(b.strength))
            for b in found.where
        ],
        closure=[_closure(c) for c in found.closure],
        not_testable=list(found.not_testable),
        confusable=[list(group) for group in found.confusable],
        selected=_selected(found),
        tried=[e.name for e in effects],
        marginal={
            n: float(p)
            for n, p in sorted(found.marginal.items(), key=lambda item: -item[1])
        },
        about=about,
        constants={effect: dict(values) for effect, values in found.constants.items()},
        coefficients=_coefficients(found, effects),
        sizes=[_size(s, fine) for s in found.sizes],
        noise=list(found.noise_words),
        units=fine,
        rms_before=_by_channel(found.before / factor, labels),
        rms_after=_by_channel(found.after / factor, labels),
        traces=gap_traces.traces(found),
        spots=spots,
        spots_unit=spots_unit,
        words=[],
        next=list(found.next),
        unknown={form: float(p) for form, p in found.likeness.items()},
    )
    return gap_words.told(made)


def known(value: float) -> float | None:
    """A number, or None where it is not finite."""
    return float(value) if math.isfinite(value) else None


def _answer(answer: Answer) -> result_gap.AnswerRecord:
    classes = [list(c) for c in answer.classes]
    return result_gap.AnswerRecord(
        list(answer.effects), float(answer.probability), classes
    )


def _selected(found: Diagnosis) -> list[str]:
    """Effects of the best answer that have a name."""
    best = found.answers[0].effects if found.answers and found.verdict != "none" else ()
    return [n for n in best if n != UNKNOWN]


def _closure(c: Closure) -> result_gap.ClosureRecord:
    return result_gap.ClosureRecord(
        split=c.split,
        value=known(c.value),
        low=known(c.low),
        high=known(c.high),
        p_worse=known(c.p_worse),
        s0=known(c.s0),
        s1=known(c.s1),
        s_noise=known(c.s_noise),
        n=int(c.n),
    )


def _about(effect: Effect, found: Diagnosis) -> result_gap.EffectNote:
    missing = found.not_testable.get(effect.name, "")
    column = gap_words.column(effect, found.problem.states) if missing else ""
    return result_gap.EffectNote(
        effect.about, effect.remedy, effect.exposed_by, effect.source, missing, column
    )


def _channels(found: Diagnosis) -> tuple[dict[str, str], np.ndarray]:
    """Fine unit of each channel, and the channel of each reading (N,)."""
    setups = found.problem.measurement.setups
    fine = {
        c.name: units.FINE[c.unit]
        for name in dict.fromkeys(found.problem.rows["setup"])
        for c in setups[name].instrument.channels
    }
    return fine, found.problem.rows["channel"].to_numpy()


def _by_channel(values: Array, labels: np.ndarray) -> dict[str, float]:
    return {
        str(n): float(np.sqrt(np.mean(values[labels == n] ** 2)))
        for n in dict.fromkeys(labels)
    }


def _size(size: Size, fine: dict[str, str]) -> result_gap.SizeRecord:
    rms = {n: units.number(v, fine[n]) for n, v in size.rms.items()}
    return result_gap.SizeRecord(size.effect, rms, known(size.detectability))


def _coefficients(
    found: Diagnosis, effects: Sequence[Effect]
) -> list[result_gap.CoefficientRecord]:
    """Coefficients with what was expected of each; effects give no unit beyond SI."""
    scales = {
        (e.name, c.name): c.scale
        for e in effects
        if e.name in _selected(found)
        for c in _columns(e, found)
    }
    return [
        result_gap.CoefficientRecord(
            c.effect,
            c.name,
            c.label,
            float(c.mean),
            float(c.sd),
            "SI",
            scales.get((c.effect, c.name)),
        )
        for c in found.coefficients
    ]


def _columns(effect: Effect, found: Diagnosis) -> list[Column]:
    """All columns of an effect, over set-ups and constants."""
    return [
        c
        for point in effect.grid()
        for state in found.problem.states
        for c in effect.columns(state, **point)
    ]
