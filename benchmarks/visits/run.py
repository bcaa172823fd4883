"""One case with its second visit: both diagnoses, and the predicted probability."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.blind.run import diagnosis_record
from benchmarks.second import cases as case_files
from benchmarks.second.cases import Case
from benchmarks.second.score import Scored
from benchmarks.visits import later
from oed import units
from oed.base import Array
from oed.gap import procedure
from oed.gap.before import repeats, second_visit
from oed.gap.before.second_visit import SecondVisit
from oed.gap.data import problem as problems
from oed.gap.data.diagnosis import Diagnosis
from oed.gap.data.problem import GapProblem
from oed.model.effect import Effect

MM = 1e-3
MACHINES = ("a3", "planar", "delta", "hexapod")


def record(
    make: Any, machine: str, kind: str, severity: float, seed: int
) -> dict[str, Any]:
    """What both visits to a case say, and what was predicted after the first.

    Raises ValueError where the case cannot be visited again.
    """
    start = time.process_time()
    key = (seed, MACHINES.index(machine))
    law = str(np.random.default_rng([*key, 1]).choice(make.LAWS))
    first = later.draw(make, machine, kind, law, severity, key)
    with tempfile.TemporaryDirectory() as folder:
        stem = Path(folder) / "cases" / machine / "case_000"
        stem.parent.mkdir(parents=True)
        make.write(first.case, first.y, first.label, stem)
        problem, effects = case_files.prepare(Case(Path(folder), machine, stem.name))
    rng = np.random.default_rng(key)
    diagnosis = _diagnose(problem, effects, rng)
    result = {
        "machine": machine,
        "kind": kind,
        "severity": severity,
        "seed": seed,
        "acting": [e["effect"] for e in first.label["effects"]],
        "first": _judge(first.label, diagnosis),
        "readings": sum(len(s) for s in problem.series),
        "visited": False,
    }
    if second_visit.needs_second_visit(diagnosis):
        candidates = repeats.candidate_runs(diagnosis.problem)
        visit = second_visit.propose(diagnosis, effects, candidates, rng)
        if visit is not None:
            both = _both(make, first, problem, visit)
            second = _diagnose(both, effects, rng)
            result |= {
                "visited": True,
                "further": sum(len(s) for s in visit.series),
                "now": visit.probability_now,
                "predicted": visit.probability_after,
                "least": visit.pairs[0].separation,
                "second": _judge(first.label, second),
                "runs": [run.name for run in visit.runs],
            }
    return {**result, "seconds": time.process_time() - start}


def _diagnose(
    problem: GapProblem, effects: Sequence[Effect], rng: np.random.Generator
) -> Diagnosis:
    """Which effects act; without places and closure."""
    return procedure.explain_residuals(problem, effects, rng)


def _judge(label: Mapping[str, Any], diagnosis: Diagnosis) -> dict[str, Any]:
    """The answer, and whether it is right."""
    scored = Scored(label, diagnosis_record(diagnosis))
    kept = set().union(*scored.classes) if scored.effects else set()
    truth = {e["effect"] for e in label["effects"]}
    likeliest = max(_named(diagnosis).items(), key=lambda item: item[1])[0]
    right = scored.names_are_right(frozenset(likeliest)) if truth else not likeliest
    return {
        "verdict": diagnosis.verdict,
        "answer": sorted(scored.first),
        "probability": scored.probability,
        "class": bool(scored.detected and scored.names and scored.names <= kept),
        "right": scored.is_right,
        "likeliest": sorted(likeliest),
        "likeliest_right": bool(right),
        "exact": set(likeliest) == truth,
        "total": label.get("sqrt_lambda_total", 0.0),
        "clear": scored.is_clear,
        "both_visible": all(e.get("given_other", 0.0) >= 5.9 for e in label["effects"]),
    }


def _named(diagnosis: Diagnosis) -> dict[tuple[str, ...], float]:
    """Probability of each set of named effects; an unknown alone is a set as well."""
    shares: dict[tuple[str, ...], float] = {}
    for (names, unknown), share in diagnosis.shares.items():
        key = tuple(sorted(names)) or (("unknown",) if unknown else ())
        shares[key] = shares.get(key, 0.0) + share
    return shares


def _both(
    make: Any, first: later.First, problem: GapProblem, visit: SecondVisit
) -> GapProblem:
    """The readings of both visits as one problem."""
    order = {name: k for k, name in enumerate(problem.measurement.setups)}
    assert list(order) == [s["name"] for s in first.case.setups if s["name"] in order]
    numbers = {s["name"]: k for k, s in enumerate(first.case.setups)}
    names = [c.name for c in problem.measurement.machine.command]
    by_setup = {run.setup: [] for run in visit.runs}
    for run in visit.runs:
        by_setup[run.setup].append(run)
    runs = []
    for run in [r for group in by_setup.values() for r in group]:
        direction = int(run.condition.get("direction", 1.0))
        command = run.command[::direction]
        poses = {}
        for column in first.case.cmd:
            stem, unit = column.rsplit("_", 1)
            values = command[:, names.index(stem)]
            poses[column] = values / MM if unit == "mm" else np.degrees(values)
        runs.append(
            {
                "setup": numbers[run.setup],
                "poses": poses,
                "dir": direction,
                "feed": run.condition.get("feed", 0.02) / units.MM_PER_MIN,
                "payload": run.condition.get("payload", 0.0),
            }
        )
    y, clock = later.visit_again(make, first, runs)
    covariates = _with_time(visit, clock, runs)
    series = [*problem.series, *visit.series]
    return problems.prepare(
        problem.measurement,
        series,
        np.concatenate([problem.y, MM * np.round(y, 6)]),
        pd.concat([problem.covariates, covariates], ignore_index=True),
        gravity=problem.gravity,
    )


def _with_time(
    visit: SecondVisit, clock: Array, runs: Sequence[Mapping[str, Any]]
) -> pd.DataFrame:
    """Covariates of the second visit with the time at which each pose was read."""
    counts = [len(next(iter(run["poses"].values()))) for run in runs]
    rows = visit.covariates.groupby(["setup", "run"], sort=False).size().tolist()
    starts = np.cumsum([0, *counts])
    times = [
        clock[start + count - taken : start + count]
        for start, count, taken in zip(starts, counts, rows, strict=False)
    ]
    return visit.covariates.assign(time=np.concatenate(times))
