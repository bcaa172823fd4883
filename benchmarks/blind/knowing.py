"""The same diagnosis by an observer who knows the noise: what telling it from the
readings costs, and what none can do.

    python -m benchmarks.blind known-noise --cases SET --results RESULTS

writes RESULTS/known_noise/ID.json as `run` writes RESULTS/ID.json, with the true
covariance of the readings (up to its level) in place of a noise law told from them.
Which readings are far off is told as the diagnosis tells it. Opens the truth, as the
oracle does; `score` puts the figures of these results beside the diagnosis's.
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


def diagnosed(
    folder: Path,
    results: Path,
    *,
    listed: Path | None = None,
    limit: int = 0,
    workers: int = 0,
    again: bool = False,
    seed: int = 0,
    told: Callable[[str], None] = print,
) -> int:
    """Diagnose the cases of a set that have no such result yet; how many failed.
    Options as `run.run` has them.

    Raises ValueError, OSError.
    """
    out = results / FOLDER
    jobs = [
        j
        for j in run.chosen(folder, listed=listed, limit=limit, seed=seed)
        if not j.without
    ]
    jobs = [j for j in jobs if again or not run.done(j.file(out))]
    jobs.sort(key=lambda j: j.case.study)
    return run.carried_out(
        work, jobs, lambda j: j.file(out), workers=workers, told=told
    )


def work(job: run.Job) -> str:
    """The text of a case's result: JSON, with `error` where the diagnosis fails."""
    return run.as_json(job, _diagnosed)


def _diagnosed(job: run.Job) -> dict[str, Any]:
    problem = loading.prepared(job.folder, job.case)
    with np.load(job.folder / "truth" / f"{job.case.id}.npz") as kept:
        law = oracle.true_law(problem, truth_of.covariance(kept))
    effects = loading.bench(job.case.study).effects
    return run.told(diagnose.diagnose(problem, effects, run.draws(job), law=law))


def figures(oracles: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The oracle's figures by which this observer is scored: closures under the true
    law are those of its own.
    """
    return {name: {**f, "closure": _true(f["closure"])} for name, f in oracles.items()}


def _true(closures: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    return [{**c, "same_law": c["true"]} for c in closures]
