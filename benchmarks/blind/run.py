"""Diagnosis of every case of a set, without its labels and truth.

    python -m benchmarks.blind run --cases SET --out RESULTS
    python -m benchmarks.blind run --cases SET --out RESULTS --list WITHHELD

writes RESULTS/ID.json, and RESULTS/without/EFFECT/ID.json where an effect is withheld
from the library. It reads `cases/`, `manifest.jsonl` and the study files. Existing
results stay, but for cases that failed.
"""

from __future__ import annotations

import dataclasses
import json
import math
import time
import traceback
import zlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind import loading
from benchmarks.blind.harmonic import harmonic
from benchmarks.blind.loading import Case
from benchmarks.blind.stepwise import stepwise
from oed.effect import Effect
from oed.gap import diagnose
from oed.gap.data.diagnosis import Answer, Closure, Diagnosis
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library as library_of
from oed.noise.law import NoiseLaw
from pkm_studies.campaign.jobs import Job, Row, run_jobs

EACH = "each"
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

    def file(self, out: Path) -> Path:
        """Where its result is."""
        folder = out / "without" / self.without if self.without else out
        return folder / f"{self.case.id}.json"


def run(
    folder: Path,
    out: Path,
    *,
    only: Sequence[str] = (),
    listed: Path | None = None,
    limit: int = 0,
    without: str = "",
    workers: int = 0,
    dask: str = "",
    again: bool = False,
    seed: int = 0,
    report: Callable[[str], None] = print,
) -> int:
    """Diagnose the cases of a set that have no result yet; how many failed.

    only       machines or plans
    listed     file of cases, see `select_jobs`
    limit      at most so many cases
    without    an effect withheld from the library; `each`: every one in turn, and the
               whole library not at all
    workers    processes; 0: one a core, 1: this process alone
    dask       address of a scheduler, in place of processes here; its workers need the
               project and the set's folder
    again      diagnose again what has a result
    report     takes a line of progress

    Raises ValueError, OSError, InputError.
    """
    jobs = select_jobs(
        folder, only=only, listed=listed, limit=limit, without=without, seed=seed
    )
    return carry_out(
        work, jobs, out, workers=workers, dask=dask, again=again, report=report
    )


def carry_out(
    work: Callable[[DiagnosisJob], Row],
    jobs: Sequence[DiagnosisJob],
    out: Path,
    *,
    workers: int = 0,
    dask: str = "",
    again: bool = False,
    report: Callable[[str], None] = print,
) -> int:
    """Store the record of each job that has none, as they come; how many have an `error`.

    Records of failures count as none.
    """
    due = [Job(j.file(out), j) for j in jobs if again or not is_done(j.file(out))]
    due.sort(key=lambda job: job.case.case.study)  # a process compiles few machines
    failed, start = 0, time.perf_counter()
    records = run_jobs(work, due, workers=workers, scheduler=dask)
    for number, record in enumerate(records, start=1):
        failed += "error" in record
        if number % 20 == 0 or number == len(due):
            seconds = time.perf_counter() - start
            report(
                f"{number} of {len(due)} diagnoses, {failed} failed, {seconds:.0f} s"
            )
    return failed


def select_jobs(
    folder: Path,
    *,
    only: Sequence[str] = (),
    listed: Path | None = None,
    limit: int = 0,
    without: str = "",
    seed: int = 0,
) -> list[DiagnosisJob]:
    """Jobs of a set. Raises ValueError.

    Lines of the file `listed` are {"id": ..., "without": effect, or nothing}.
    """
    cases = loading.manifest(folder, only)
    if listed is None:
        jobs = []
        for case in cases[: limit or None]:
            jobs += [
                DiagnosisJob(folder, case, e, seed) for e in _withheld(case, without)
            ]
        return jobs
    if without:
        raise ValueError(
            f"--without {without} and --list {listed}: give one of them; a list names"
            " what is withheld"
        )
    by_id, jobs = {c.id: c for c in cases}, []
    lines = listed.read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines, start=1):
        try:
            entry = json.loads(line)
            name, effect = str(entry["id"]), str(entry.get("without", ""))
        except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(
                f'{listed}, line {number}: {error!r}; write {{"id": ..., "without":'
                " effect}"
            ) from None
        if name in by_id:
            case = by_id[name]
            jobs += [
                DiagnosisJob(folder, case, e, seed) for e in _withheld(case, effect)
            ]
    if not jobs:
        raise ValueError(
            f"{listed}: none of its cases is in {folder}; make the list for this set"
        )
    return jobs[: limit or None]


def _withheld(case: Case, without: str) -> list[str]:
    """Names to withhold, in turn.

    Raises ValueError for an effect that is not in the library.
    """
    if not without:
        return [""]
    names = [e.name for e in loading.bench(case.study).effects]
    if without == EACH:
        return names
    if without not in names:
        raise ValueError(
            f"--without {without}: no such effect; there are {', '.join(names)}, or"
            f" {EACH}"
        )
    return [without]


def is_done(file: Path) -> bool:
    """Whether a result is there, and none of a failure."""
    if not file.is_file():
        return False
    try:
        return "error" not in json.loads(file.read_text(encoding="utf-8"))
    except json.JSONDecodeError:
        return False


def work(job: DiagnosisJob) -> Row:
    """The record of a case's diagnosis, with `error` where it fails.

    No failure may stop the others.
    """
    return stored_record(job, _diagnose)


def stored_record(
    job: DiagnosisJob, diagnose_case: Callable[[DiagnosisJob], dict[str, Any]]
) -> Row:
    """The record of a case's diagnosis, or of the `error` it ends with, as JSON holds it."""
    record: dict[str, Any] = {
        "id": job.case.id,
        "study": job.case.study,
        "without": job.without,
    }
    try:
        record |= diagnose_case(job)
    except Exception as error:
        record |= {
            "error": f"{type(error).__name__}: {error}",
            "traceback": traceback.format_exc(limit=-4),
        }
    text = json.dumps(record, default=float, allow_nan=False)
    return dict(json.loads(text))


def _diagnose(job: DiagnosisJob) -> dict[str, Any]:
    start = time.perf_counter()
    library = loading.bench(job.case.study).effects
    effects = [e for e in library if e.name != job.without]
    problem = loading.prepare(job.folder, job.case)
    ready = time.perf_counter()
    diagnosis = diagnose.diagnose(problem, effects, random_stream(job))
    record = diagnosis_record(diagnosis)
    record["seconds"] = {
        "prepare": ready - start,
        "diagnose": time.perf_counter() - ready,
    }
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
                "mean": _known(c.mean),
                "sd": _known(c.sd),
            }
            for c in diagnosis.coefficients
        ],
        "law": _law(diagnosis.law),
    }


def _answer(answer: Answer) -> dict[str, Any]:
    return {
        "effects": list(answer.effects),
        "probability": round(float(answer.probability), 6),
        "classes": [list(c) for c in answer.classes],
    }


def _closure(c: Closure) -> dict[str, Any]:
    numbers = {f.name: getattr(c, f.name) for f in dataclasses.fields(c)}
    return {k: v if isinstance(v, str | int) else _known(v) for k, v in numbers.items()}


def _law(law: NoiseLaw) -> dict[str, Any]:
    """All of a law; variances and ratios of single readings where they are not all 1."""
    return {
        "repeat": law.run_sd,
        "wander": law.ar1_sd,
        "seat": law.seat_sd,
        "reach": law.ar1_length,
        "level": law.level,
        "tails": _known(law.student_dof),
        "strays": law.outlier_share,
        "variance": _unless_one(law.variance),
        "ratio": None if law.channel_ratio is None else _unless_one(law.channel_ratio),
    }


def law_of(record: dict[str, Any], size: int) -> NoiseLaw:
    """The law of a result's record, for `size` readings."""
    variance = record["variance"] or [1.0] * size
    ratio, dof = record["ratio"], record["tails"]
    return NoiseLaw(
        run_sd=record["repeat"],
        ar1_sd=record["wander"],
        seat_sd=record.get("seat", 0.0),
        ar1_length=record["reach"],
        variance=np.array(variance, dtype=float),
        level=record["level"],
        student_dof=math.inf if dof is None else dof,
        outlier_share=record.get("strays", 0.0),
        channel_ratio=None if ratio is None else np.array(ratio, dtype=float),
    )


def _unless_one(values: Iterable[float]) -> list[float] | None:
    rounded = [float(f"{v:.5g}") for v in values]
    return None if all(v == 1.0 for v in rounded) else rounded


def _known(value: float) -> float | None:
    """A number, or None where it is not finite."""
    return float(value) if math.isfinite(value) else None
