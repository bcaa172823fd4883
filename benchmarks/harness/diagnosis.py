"""Diagnosis of a case's readings, without its truth, as a record of plain JSON."""

from __future__ import annotations

import functools
import json
import math
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from oed import dataset, gap
from oed.effect_model import Effect
from oed.gap import Diagnosis, GapProblem
from oed.measurement import Measurement
from oed.noise import NoiseLaw
from oed.result import AnswerRecord, ClosureRecord
from pkm_studies import study as studies
from pkm_studies.resolve import GapRequest, resolve
from pkm_studies.user_code import Consent

FAILURE = "failure"  #: how a diagnosis failed, if it did
ANSWERS = 20  #: most answers that are stored, if the 95 % set has no more
BENCHES = 8  #: studies whose compiled machines a process keeps

Record = dict[str, Any]
#: measurement, effects to try, and direction of gravity in the base frame
Bench = tuple[Measurement, tuple[Effect, ...], Any]


def bench(study: Path) -> Bench:
    """The measurement of a study file with its effects. Raises InputError."""
    return _bench(study, study.read_text(encoding="utf-8"))


@functools.lru_cache(BENCHES)
def _bench(study: Path, text: str) -> Bench:
    """Compiled once in a process: many cases have the same study."""
    stated = studies.Study.load(study, Consent.GIVEN)
    resolved = resolve(stated, readings=[])
    request = GapRequest.from_study(stated, resolved.machine)
    assert request is not None  # `always` makes one
    measurement = resolved.measurement_with(resolved.setups)
    return measurement, request.effects, request.gravity


def prepare(study: Path, readings: Path) -> tuple[GapProblem, tuple[Effect, ...]]:
    """The residuals of readings, and the effects to try.

    Raises InputError, ReadingsError, IdentificationError.
    """
    measurement, effects, gravity = bench(study)
    data = dataset.load(readings, measurement)
    problem = gap.prepare(
        measurement, data.series, data.y, data.covariates, gravity=gravity
    )
    return problem, effects


def diagnose(
    study: Path,
    readings: Path,
    stream: int | Sequence[int],
    law: Callable[[GapProblem], NoiseLaw] | None = None,
) -> Record:
    """The record of a diagnosis under the estimated noise law, or a known one."""
    problem, effects = prepare(study, readings)
    known = None if law is None else law(problem)
    rng = np.random.default_rng(stream)
    return diagnosis_record(gap.diagnose(problem, effects, rng, law=known))


def record_or_failure(work: Callable[[], Record]) -> Record:
    """A record, or the `failure` that it ends with, for JSON: it stops no other case."""
    try:
        record = work()
    except Exception as error:
        record = {
            FAILURE: f"{type(error).__name__}: {error}",
            "traceback": traceback.format_exc(limit=-4),
        }
    text = json.dumps(record, default=float, allow_nan=False)
    return dict(json.loads(text))


def diagnosis_record(diagnosis: Diagnosis) -> Record:
    """A diagnosis as JSON takes it."""
    count = max(ANSWERS, len(diagnosis.set95))
    return {
        "verdict": diagnosis.verdict,
        "answers": [_answer(a) for a in diagnosis.answers[:count]],
        "set95": [_answer(a) for a in diagnosis.set95],
        "marginal": {n: round(float(p), 6) for n, p in diagnosis.marginal.items()},
        "where": [
            {
                "block": b.block,
                "p_value": _finite(b.p_value),
                "strength": _finite(b.strength),
            }
            for b in diagnosis.where
        ],
        "closure": [_closure(c) for c in diagnosis.closure],
        "not_testable": sorted(diagnosis.not_testable),
        "confusable": [list(c) for c in diagnosis.confusable],
        "sizes": [
            {"effect": s.effect, "detectability": _finite(s.detectability)}
            for s in diagnosis.sizes
        ],
        "legs": [
            {
                "effect": c.effect,
                "name": c.name,
                "label": c.label,
                "mean": _finite(c.value),
                "sd": _finite(c.sd),
            }
            for c in diagnosis.coefficients
        ],
        "law_of_answer": _law(diagnosis.law),
    }


def _answer(answer: AnswerRecord) -> Record:
    return {
        "effects": list(answer.effects),
        "probability": round(float(answer.probability), 6),
        "classes": [list(c) for c in answer.classes],
    }


def _closure(c: ClosureRecord) -> Record:
    numbers = msgspec.structs.asdict(c)
    return {
        k: v if isinstance(v, str | int) else _finite(v) for k, v in numbers.items()
    }


def _law(law: NoiseLaw) -> Record:
    """All of a law; `scale` by channel."""
    of = law.law
    return {
        "repeat": float(of.level[0]),
        "carried": float(of.correlated[0]),
        "seat": float(of.seat[0]),
        "reach": float(of.reach[0]),
        "level": law.level,
        "tails": _finite(law.student_dof),
        "strays": law.outlier_share,
        "scale": of.scale[0].tolist(),
    }


def _finite(value: float) -> float | None:
    """A number, or None where it is not finite."""
    return float(value) if math.isfinite(value) else None
