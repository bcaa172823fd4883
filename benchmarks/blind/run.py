"""Diagnose every case of a set, by what a diagnosis may read: `cases/`,
`manifest.jsonl` and the study files.

    python -m benchmarks.blind run --cases SET --out RESULTS
    python -m benchmarks.blind run --cases SET --out RESULTS --list WITHHELD

writes RESULTS/ID.json, and RESULTS/without/EFFECT/ID.json where an effect is withheld
from the library. What is there already is left alone, but for cases that failed. Labels
and truth are never opened, nor needed.
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
from typing import Any, TypeVar

import numpy as np

from benchmarks.blind import baselines, loading, pool
from benchmarks.blind.loading import Case
from oed.effect import Effect
from oed.gap import diagnose
from oed.gap.data.diagnosis import Answer, Closure, Diagnosis
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library as library_of
from oed.noise.law import NoiseLaw

J = TypeVar("J")
EACH = "each"
#: answers that are kept beyond those of the 95 % set
KEPT = 20


@dataclasses.dataclass(frozen=True, slots=True)
class Job:
    """A case to diagnose, without one effect of the library where that is named."""

    folder: Path
    case: Case
    without: str = ""
    seed: int = 0

    def file(self, out: Path) -> Path:
        """Where its result is."""
        return (
            out / "without" / self.without if self.without else out
        ) / f"{self.case.id}.json"


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
    told: Callable[[str], None] = print,
) -> int:
    """Diagnose the cases of a set that have no result yet; how many failed. Raises
    ValueError, OSError.

    only     machines or plans;  listed: file of cases (see `chosen`);  limit: at most
             so many cases
    without  an effect withheld from the library; `each`: every one in turn, and the
             whole library not at all
    again    diagnose afresh what has a result;  workers, dask: see `pool.results`
    """
    jobs = chosen(
        folder, only=only, listed=listed, limit=limit, without=without, seed=seed
    )
    if not again:
        jobs = [j for j in jobs if not done(j.file(out))]
    jobs.sort(key=lambda j: j.case.study)  # a process compiles few machines
    return carried_out(
        work, jobs, lambda j: j.file(out), workers=workers, dask=dask, told=told
    )


def carried_out(
    work: Callable[[J], str],
    jobs: Sequence[J],
    file: Callable[[J], Path],
    *,
    workers: int = 0,
    dask: str = "",
    told: Callable[[str], None] = print,
) -> int:
    """Write the result that `work` makes of each job to its file, as they come; how
    many have an `error`.
    """
    failed, begun = 0, time.perf_counter()
    for number, (job, text) in enumerate(
        pool.results(work, jobs, workers=workers, dask=dask), start=1
    ):
        loading.write(file(job), text)
        failed += "error" in json.loads(text)
        if number % 20 == 0 or number == len(jobs):
            told(
                f"{number} of {len(jobs)} diagnoses, {failed} failed,"
                f" {time.perf_counter() - begun:.0f} s"
            )
    return failed


def chosen(
    folder: Path,
    *,
    only: Sequence[str] = (),
    listed: Path | None = None,
    limit: int = 0,
    without: str = "",
    seed: int = 0,
) -> list[Job]:
    """Jobs of a set. Lines of the file `listed` are {"id": ..., "without": effect, or
    nothing}. Raises ValueError.
    """
    cases = loading.manifest(folder, only)
    if listed is None:
        some = cases[: limit or None]
        return [
            Job(folder, c, name, seed) for c in some for name in _withheld(c, without)
        ]
    if without:
        raise ValueError(
            f"--without {without} and --list {listed}: give one of them; a list names"
            " what is withheld"
        )
    by_id, jobs = {c.id: c for c in cases}, []
    for number, line in enumerate(
        listed.read_text(encoding="utf-8").splitlines(), start=1
    ):
        try:
            said = json.loads(line)
            name, effect = str(said["id"]), str(said.get("without", ""))
        except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(
                f'{listed}, line {number}: {error!r}; write {{"id": ..., "without":'
                " effect}"
            ) from None
        if name in by_id:
            case = by_id[name]
            jobs += [
                Job(folder, case, e, seed)
                for e in (_withheld(case, effect) if effect else [""])
            ]
    if not jobs:
        raise ValueError(
            f"{listed}: none of its cases is in {folder}; make the list for this set"
        )
    return jobs[: limit or None]


def _withheld(case: Case, without: str) -> list[str]:
    """Names to withhold, in turn. Raises ValueError for an effect that is not in the
    library.
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


def done(file: Path) -> bool:
    """Whether a result is there, and none of a failure."""
    if not file.is_file():
        return False
    try:
        return "error" not in json.loads(file.read_text(encoding="utf-8"))
    except json.JSONDecodeError:
        return False


def work(job: Job) -> str:
    """The text of a case's result: JSON, with `error` where the diagnosis fails, for no
    failure may stop the others.
    """
    return as_json(job, _diagnosed)


def as_json(job: Job, made: Callable[[Job], dict[str, Any]]) -> str:
    """What is `made` of a case, or the `error` that it ends with, as JSON."""
    said: dict[str, Any] = {
        "id": job.case.id,
        "study": job.case.study,
        "without": job.without,
    }
    try:
        said |= made(job)
    except Exception as error:
        said |= {
            "error": f"{type(error).__name__}: {error}",
            "traceback": traceback.format_exc(limit=-4),
        }
    return json.dumps(said, default=float, allow_nan=False)


def _diagnosed(job: Job) -> dict[str, Any]:
    begun = time.perf_counter()
    effects = [
        e for e in loading.bench(job.case.study).effects if e.name != job.without
    ]
    problem = loading.prepared(job.folder, job.case)
    ready = time.perf_counter()
    said = told(diagnose.diagnose(problem, effects, draws(job)))
    said["seconds"] = {
        "prepare": ready - begun,
        "diagnose": time.perf_counter() - ready,
    }
    if not job.without:
        said["baselines"] = beside(problem, effects)
    return said


def draws(job: Job) -> np.random.Generator:
    """The same draws for a case whatever is run before it."""
    return np.random.default_rng(
        [job.seed, zlib.crc32(f"{job.case.id}/{job.without}".encode())]
    )


def beside(problem: GapProblem, effects: Sequence[Effect]) -> dict[str, list[str]]:
    """What the baselines answer."""
    known = library_of.build(problem, effects)
    return {
        "harmonic": baselines.harmonic(problem, known.effects),
        "stepwise": baselines.stepwise(problem, known),
    }


def told(found: Diagnosis) -> dict[str, Any]:
    """A diagnosis as JSON takes it."""
    return {
        "verdict": found.verdict,
        "answers": [_answer(a) for a in found.answers[: max(KEPT, len(found.set95))]],
        "set95": [_answer(a) for a in found.set95],
        "marginal": {n: round(float(p), 6) for n, p in found.marginal.items()},
        "where": [
            {
                "block": b.block,
                "p_value": _known(b.p_value),
                "strength": _known(b.strength),
            }
            for b in found.where
        ],
        "closure": [_closure(c) for c in found.closure],
        "not_testable": sorted(found.not_testable),
        "confusable": [list(c) for c in found.confusable],
        "sizes": [
            {"effect": s.effect, "detectability": _known(s.detectability)}
            for s in found.sizes
        ],
        "legs": [
            {
                "effect": c.effect,
                "name": c.name,
                "label": c.label,
                "mean": _known(c.mean),
                "sd": _known(c.sd),
            }
            for c in found.coefficients
        ],
        "law": _law(found.law),
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
    """All of a law; variances and ratios of single readings only where they are not all
    1.
    """
    return {
        "repeat": law.run_sd,
        "wander": law.ar1_sd,
        "sway": law.run_harmonic_sd,
        "reach": law.ar1_length,
        "level": law.level,
        "tails": _known(law.student_dof),
        "strays": law.outlier_share,
        "variance": _unless_one(law.variance),
        "ratio": None if law.channel_ratio is None else _unless_one(law.channel_ratio),
    }


def law_of(said: dict[str, Any], size: int) -> NoiseLaw:
    """The law that a result tells, for `size` readings."""
    variance = said["variance"] or [1.0] * size
    return NoiseLaw(
        run_sd=said["repeat"],
        ar1_sd=said["wander"],
        run_harmonic_sd=said.get("sway", 0.0),
        ar1_length=said["reach"],
        variance=np.array(variance, dtype=float),
        level=said["level"],
        student_dof=math.inf if said["tails"] is None else said["tails"],
        outlier_share=said.get("strays", 0.0),
        channel_ratio=None
        if said["ratio"] is None
        else np.array(said["ratio"], dtype=float),
    )


def _unless_one(values: Iterable[float]) -> list[float] | None:
    told = [float(f"{v:.5g}") for v in values]
    return None if all(v == 1.0 for v in told) else told


def _known(value: float) -> float | None:
    """A number, or None where it is not finite."""
    return float(value) if math.isfinite(value) else None
