"""The same diagnosis by an observer who knows the noise: the cost of estimating it.

    PYTHONPATH=. oed campaign --allow-code benchmarks/blind_known_noise.campaign.toml

The true covariance of the readings (up to its level) takes the place of an estimated
noise law. Outliers are detected as in the diagnosis. Opens the truth, as the oracle
does; `score` compares these results with the diagnosis's.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.blind import case, loading, run
from benchmarks.blind.generator import write as truth_of
from benchmarks.blind.true_law import true_law
from oed.gap import procedure as diagnose


def diagnosis(setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """The record of a case's diagnosis, as `case.diagnosis` has it."""
    return case.record_of(setting, seed, work)


def work(job: run.DiagnosisJob) -> dict[str, Any]:
    """The record of a case's diagnosis, with `failure` where it fails."""
    return run.stored_record(job, _diagnose)


def _diagnose(job: run.DiagnosisJob) -> dict[str, Any]:
    problem = loading.prepare(job.folder, job.case)
    with np.load(job.folder / "truth" / f"{job.case.id}.npz") as truth:
        law = true_law(problem, truth_of.covariance(truth))
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
