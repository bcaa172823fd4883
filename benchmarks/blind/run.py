"""Diagnosis of a case of a set, without its labels and truth.

The campaign `blind` runs it, see `case`. It reads `cases/`, `manifest.jsonl` and the
study files. One effect may be withheld from the library.
"""

from __future__ import annotations

import dataclasses
import json
import math
import traceback
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from benchmarks.blind import loading
from benchmarks.blind.harmonic import harmonic
from benchmarks.blind.loading import Case
from benchmarks.blind.stepwise import stepwise
from oed.gap import procedure as diagnose
from oed.gap.data.diagnosis import Diagnosis
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library as library_of
from oed.model.effect import Effect
from oed.noise import Laws, NoiseLaw
from oed.result import AnswerRecord, ClosureRecord
from pkm_campaign import Row

if TYPE_CHECKING:
    import pandas as pd

#: how a diagnosis failed, if it did
FAILURE = "failure"
#: most answers that are stored, if the 95 % set has no more
ANSWERS = 20


@dataclasses.dataclass(frozen=True, slots=True)
class DiagnosisJob:
    """A case to diagnose, without one effect of the library where that is named.

    folder     of the set
    case       the case
    without    effect that is withheld; "" for none
    seed       of the diagnosis's draws
    """

    folder: Path
    case: Case
    without: str = ""
    seed: int = 0


def work(job: DiagnosisJob) -> Row:
    """The record of a case's diagnosis, with `failure` where it fails.

    No failure may stop the others.
    """
    return stored_record(job, _diagnose)


def stored_record(
    job: DiagnosisJob, diagnose_case: Callable[[DiagnosisJob], dict[str, Any]]
) -> Row:
    """The record of a case's diagnosis, or of the `failure` it ends with, for JSON."""
    record = {"id": job.case.id, "study": job.case.study, "without": job.without}
    return record | record_or_failure(lambda: diagnose_case(job))


def record_or_failure(diagnose_case: Callable[[], dict[str, Any]]) -> Row:
    """The record of a diagnosis, or the `failure` it ends with, for JSON."""
    try:
        record = diagnose_case()
    except Exception as error:
        record = {
            FAILURE: f"{type(error).__name__}: {error}",
            "traceback": traceback.format_exc(limit=-4),
        }
    text = json.dumps(record, default=float, allow_nan=False)
    return dict(json.loads(text))


def verdict_counts(cases: pd.DataFrame) -> dict[str, int]:
    """How many diagnoses of a campaign failed, and what the others say."""
    counts = {"failures": int(cases[FAILURE].notna().sum()) if FAILURE in cases else 0}
    if "verdict" in cases:
        verdicts = cases["verdict"].dropna().value_counts()
        counts |= {f"verdict {name}": int(n) for name, n in verdicts.items()}
    return counts


def _diagnose(job: DiagnosisJob) -> dict[str, Any]:
    library = loading.bench(job.case.study).effects
    effects = [e for e in library if e.name != job.without]
    problem = loading.prepare(job.folder, job.case)
    diagnosis = diagnose.diagnose(problem, effects, random_stream(job))
    record = diagnosis_record(diagnosis)
    if not job.without:
        record["baselines"] = baseline_answers(problem, effects)
    return record


def random_stream(job: DiagnosisJob) -> np.random.Generator:
    """The random stream of a case, whatever runs before it."""
    key = zlib.crc32(f"{job.case.id}/{job.without}".encode())
    return np.random.default_rng([job.seed, key])


def baseline_answers(
    problem: GapProblem,
    effects: Sequence[Effect],
) -> dict[str, list[str]]:
    """Effects that each baseline names."""
    known = library_of.build(problem, effects)
    return {
        "harmonic": harmonic(problem, known.effects),
        "stepwise": stepwise(problem, known),
    }


def diagnosis_record(diagnosis: Diagnosis) -> dict[str, Any]:
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
                "p_value": _known(b.p_value),
                "strength": _known(b.strength),
            }
            for b in diagnosis.where
        ],
        "closure": [_closure(c) for c in diagnosis.closure],
        "not_testable": sorted(diagnosis.not_testable),
        "confusable": [list(c) for c in diagnosis.confusable],
        "sizes": [
            {"effect": s.effect, "detectability": _known(s.detectability)}
            for s in diagnosis.sizes
        ],
        "legs": [
            {
                "effect": c.effect,
                "name": c.name,
                "label": c.label,
                "mean": _known(c.value),
                "sd": _known(c.sd),
            }
            for c in diagnosis.coefficients
        ],
        "law": _law(diagnosis.law),
    }


def _answer(answer: AnswerRecord) -> dict[str, Any]:
    return {
        "effects": list(answer.effects),
        "probability": round(float(answer.probability), 6),
        "classes": [list(c) for c in answer.classes],
    }


def _closure(c: ClosureRecord) -> dict[str, Any]:
    numbers = msgspec.structs.asdict(c)
    return {k: v if isinstance(v, str | int) else _known(v) for k, v in numbers.items()}


def _law(law: NoiseLaw) -> dict[str, Any]:
    """All of a law; `scale` by channel."""
    of = law.law
    return {
        "repeat": float(of.level[0]),
        "carried": float(of.carried[0]),
        "seat": float(of.seat[0]),
        "reach": float(of.reach[0]),
        "level": law.level,
        "tails": _known(law.student_dof),
        "strays": law.outlier_share,
        "scale": of.scale[0].tolist(),
    }


def law_of(record: dict[str, Any]) -> NoiseLaw:
    """The law of a result's record."""
    dof, names = record["tails"], ("scale", "carried", "reach", "repeat", "seat")
    return NoiseLaw(
        Laws(*(np.array([record[name]], dtype=float) for name in names)),
        level=record["level"],
        student_dof=math.inf if dof is None else dof,
        outlier_share=record["strays"],
    )


def _known(value: float) -> float | None:
    """A number, or None where it is not finite."""
    return float(value) if math.isfinite(value) else None
