"""Diagnosis of the cases of a set under the estimated or the true noise law."""

from __future__ import annotations

import json
import math
import time
import traceback
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.blind import loading
from benchmarks.blind.run import diagnosis_record
from benchmarks.second import cases as case_files
from benchmarks.second.cases import Case
from oed.effect import Effect
from oed.gap import diagnose
from oed.gap.data.problem import GapProblem
from oed.noise.law import NoiseLaw

ESTIMATED, TRUE = "estimated", "true"
LAWS = (ESTIMATED, TRUE)


def run(
    cases: Sequence[Case],
    laws: Sequence[str],
    report: Callable[[str], None] = print,
) -> int:
    """Diagnose the cases that have no result yet, one by one; how many failed."""
    failed = 0
    for case in cases:
        due = [law for law in laws if not case.result(law).is_file()]
        if not due:
            continue
        label = case_files.labels(case.folder, case.machine)[case.name]
        for law in due:
            record = _record(case, law, label)
            failed += "error" in record
            loading.write(case.result(law), json.dumps(record, default=float))
            report(
                f"{case.machine} {case.name}, {law} law:"
                f" {record.get('verdict', record.get('error'))},"
                f" {record['seconds']:.1f} s"
            )
    return failed


def _record(case: Case, law: str, label: Mapping[str, Any]) -> dict[str, Any]:
    """The record of a diagnosis; `error` where it fails, for it may stop no other."""
    start = time.process_time()
    try:
        problem, effects = case_files.prepare(case)
        start = time.process_time()
        known = true_law(problem, label["law"]) if law == TRUE else None
        record = _diagnose(case, problem, effects, known)
    except Exception as error:
        record = {
            "error": f"{type(error).__name__}: {error}",
            "traceback": traceback.format_exc(limit=-4),
        }
    return {**record, "seconds": time.process_time() - start}


def _diagnose(
    case: Case,
    problem: GapProblem,
    effects: Sequence[Effect],
    law: NoiseLaw | None,
) -> dict[str, Any]:
    key = zlib.crc32(f"{case.machine}/{case.name}".encode())
    rng = np.random.default_rng(key)
    return diagnosis_record(diagnose.diagnose(problem, effects, rng, law=law))


def true_law(problem: GapProblem, law: Mapping[str, Any]) -> NoiseLaw:
    """The noise law of a label; outliers and tails are left to the diagnosis."""
    correlation = law.get("rho", math.exp(-1.0))
    return NoiseLaw(
        run_sd=law.get("repeat_over_sigma", 0.0),
        ar1_sd=law.get("ar_over_sigma", 0.0),
        ar1_length=-1.0 / math.log(correlation),
        variance=np.ones(len(problem)),
    )
