"""The same diagnosis by an observer who knows the noise: the cost of estimating it.

    python -m benchmarks.blind known-noise --cases SET --results RESULTS

writes RESULTS/known_noise/ID.json as `run` writes RESULTS/ID.json, with the true
covariance of the readings (up to its level) in place of an estimated noise law.
Outliers are detected as in the diagnosis. Opens the truth, as the oracle does; `score`
compares these results with the diagnosis's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind import loading, oracle, run
from benchmarks.blind.generator import write as truth_of
from oed.gap import diagnose

FOLDER = "known_noise"


def run_all(
    folder: Path,
    results: Path,
    *,
    listed: Path | None = None,
    limit: int = 0,
    workers: int = 0,
    again: bool = False,
    seed: int = 0,
    report: Callable[[str], None] = print,
) -> int:
    """Diagnose the cases of a set that have no such result yet; how many failed.

    Options are those of `run.run`. Raises ValueError, OSError.
    """
    out = results / FOLDER
    every = run.select_jobs(folder, listed=listed, limit=limit, seed=seed)
    jobs = [j for j in every if not j.without]
    return run.carry_out(work, jobs, out, workers=workers, again=again, report=report)


def work(job: run.DiagnosisJob) -> dict[str, Any]:
    """The record of a case's diagnosis, with `error` where it fails."""
    return run.stored_record(job, _diagnose)


def _diagnose(job: run.DiagnosisJob) -> dict[str, Any]:
    problem = loading.prepare(job.folder, job.case)
    with np.load(job.folder / "truth" / f"{job.case.id}.npz") as truth:
        law = oracle.true_law(problem, truth_of.covariance(truth))
    effects = loading.bench(job.case.study).effects
    rng = run.random_stream(job)
    return run.diagnosis_record(diagnose.diagnose(problem, effects, rng, law=law))


def figures(oracles: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The oracle's figures for this observer: the law of its closures is the true one."""
    return {
        name: {**figures, "closure": _under_true_law(figures["closure"])}
        for name, figures in oracles.items()
    }


def _under_true_law(closures: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    return [{**c, "same_law": c["true"]} for c in closures]
