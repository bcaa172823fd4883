"""Cases of the campaign `second`: a diagnosis under the estimated or the true noise law.

    PYTHONPATH=. oed campaign --allow-code benchmarks/second.campaign.toml --seeds 20

A setting names the folder of the set, a machine and a law; the seed is the number of
the machine's case.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

import dataclasses
import math
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.blind.run import (
    diagnosis_record,
    record_or_failure,
    verdict_counts,
)
from benchmarks.second import cases as case_files
from benchmarks.second.cases import Case
from oed.gap import procedure as diagnose
from oed.gap.data.problem import GapProblem
from oed.model.effect import Effect
from oed.noise import NoiseLaw

if TYPE_CHECKING:
    import pandas as pd

ESTIMATED, TRUE = "estimated", "true"
LAWS = (ESTIMATED, TRUE)


def diagnosis(setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """The record of a diagnosis, with `failure` where it fails: that stops no other.

    setting  folder of the set, machine, and law of the noise: estimated or true

    Raises ValueError for a number beyond the set's cases, OSError.
    """
    folder, machine, law = (setting[name] for name in ("folder", "machine", "law"))
    names = case_files.names(Path(folder), machine)
    if seed >= len(names):
        raise ValueError(
            f"the set has {len(names)} cases of {machine}: give the campaign --seeds"
            f" {len(names)}, or generate more in another folder than {folder}"
        )
    case = Case(Path(folder), machine, names[seed])
    return {"case": case.name, **record_or_failure(lambda: _record(case, law))}


def verdicts(cases: pd.DataFrame, setting: Mapping[str, Any]) -> dict[str, Any]:
    """How many diagnoses failed, and what the others say."""
    return dict(verdict_counts(cases))


def _record(case: Case, law: str) -> dict[str, Any]:
    problem, effects = case_files.prepare(case)
    known = None
    if law == TRUE:
        label = case_files.labels(case.folder, case.machine)[case.name]
        known = true_law(problem, label["law"])
    return _diagnose(case, problem, effects, known)


def _diagnose(
    case: Case,
    problem: GapProblem,
    effects: Sequence[Effect],
    law: NoiseLaw | None,
) -> dict[str, Any]:
    key = zlib.crc32(f"{case.machine}/{case.name}".encode())
    rng = np.random.default_rng(key)
    record = diagnosis_record(diagnose.diagnose(problem, effects, rng, law=law))
    record["law_of_answer"] = record.pop("law")  # `law` is that of the setting
    return record


def true_law(problem: GapProblem, law: Mapping[str, Any]) -> NoiseLaw:
    """The noise law of a label; outliers and tails are left to the diagnosis."""
    correlation = law.get("rho", math.exp(-1.0))
    carried = law.get("ar_over_sigma", 0.0)
    within, stated = math.hypot(1.0, carried), problem.stated_law.law
    changed = dataclasses.replace(
        stated,
        scale=within * stated.scale,
        carried=np.array([(carried / within) ** 2]),
        reach=np.array([-1.0 / math.log(correlation)]),
        level=np.array([law.get("repeat_over_sigma", 0.0) / within]),
    )
    return NoiseLaw(changed)
