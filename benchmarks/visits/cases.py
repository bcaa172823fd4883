"""Cases of the second generator that are visited again: what the advised readings decide.

    PYTHONPATH=. oed campaign --allow-code benchmarks/visits.campaign.toml --seeds 40
    python -m benchmarks.harness visits

Each case is diagnosed, visited again for what the diagnosis advises, and diagnosed with
both visits.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.harness.diagnosis import (
    FAILURE,
    diagnosis_record,
    prepare,
    record_or_failure,
)
from benchmarks.harness.judge import SIX, Scored
from benchmarks.harness.statistics import share
from benchmarks.second.world import GENERATOR, MACHINES, write_case
from benchmarks.visits import later
from oed import gap, units
from oed.base import Array
from oed.gap import (
    Diagnosis,
    GapProblem,
    SecondVisit,
    explain_residuals,
    propose_second_visit,
)

MM = 1e-3
#: kind and severity of the cases, in turn
KINDS = (
    ("single", 6),
    ("pair", 10),
    ("single", 10),
    ("single", 20),
    ("pair", 20),
    ("unknown", 10),
    ("single", 6),
    ("pair", 6),
    ("single", 10),
)
Record = Mapping[str, Any]
#: bins of the predicted probability
BINS = ((0.0, 0.6), (0.6, 0.8), (0.8, 1.0))
HEADER = "| measure | first visit | after the second | bar |\n|---|---|---|---|"


def visits(setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """What both visits to a case say, and what was predicted after the first.

    The setting names the seed of the first case. With `failure` where a case cannot be
    visited again. Raises ModuleNotFoundError without the generator.
    """
    make = later.modules(GENERATOR)
    kind, severity = KINDS[seed % len(KINDS)]
    machine = MACHINES[seed % len(MACHINES)]
    key = (setting["start"] + seed, MACHINES.index(machine))
    record = record_or_failure(lambda: _record(make, machine, kind, severity, key))
    return {"machine": machine, "kind": kind, "severity": severity, **record}


def _record(
    make: Any, machine: str, kind: str, severity: float, key: Sequence[int]
) -> dict[str, Any]:
    law = str(np.random.default_rng([*key, 1]).choice(make.LAWS))
    first = later.draw(make, machine, kind, law, severity, key)
    with tempfile.TemporaryDirectory() as folder:
        stem = Path(folder) / "case_000"
        make.write(first.case, first.y, first.label, stem)
        problem, effects = prepare(*write_case(stem, Path(folder) / "study"))
    rng = np.random.default_rng(key)
    diagnosis = explain_residuals(problem, effects)
    record = {
        "acting": [e["effect"] for e in first.label["effects"]],
        "first": _judge(first.label, diagnosis),
        "readings": sum(len(s) for s in problem.series),
        "visited": False,
    }
    visit = propose_second_visit(diagnosis, effects, rng)
    if visit is None:
        return record
    both = _both(make, first, problem, visit)
    second = explain_residuals(both, effects)
    return record | {
        "visited": True,
        "further": sum(len(s) for s in visit.series),
        "now": visit.probability_now,
        "predicted": visit.probability_after,
        "least": visit.pairs[0].separation,
        "second": _judge(first.label, second),
        "runs": [run.name for run in visit.runs],
    }


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
        "both_visible": all(e.get("given_other", 0.0) >= SIX for e in label["effects"]),
    }


def _named(diagnosis: Diagnosis) -> dict[tuple[str, ...], float]:
    """Probability of each set of named effects; an unknown alone is a set as well."""
    named: dict[tuple[str, ...], float] = {}
    for (names, unknown), probability in diagnosis.shares.items():
        key = tuple(sorted(names)) or (("unknown",) if unknown else ())
        named[key] = named.get(key, 0.0) + probability
    return named


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
    return gap.prepare(
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


# -- table -----------------------------------------------------------------------------


def table(records: Sequence[Record]) -> str:
    """Shares before and after over all cases and over those visited; the calibration."""
    judged = [record for record in records if FAILURE not in record]
    visited = [record for record in judged if record["visited"]]
    lines = [
        f"{len(records)} cases, {len(records) - len(judged)} left out,"
        f" {len(visited)} visited again with a share of readings of"
        f" {_readings(visited)}.",
        "",
        HEADER,
    ]
    for words, some in (("", judged), (", visited", visited)):
        lines += _rows(words, some)
    return "\n".join([*lines, "", *_calibration(visited)])


def _readings(visited: Sequence[Record]) -> str:
    shares = [record["further"] / record["readings"] for record in visited]
    return f"{np.mean(shares):.2f} (at most {max(shares):.2f})" if shares else "none"


def _rows(words: str, records: Sequence[Record]) -> list[str]:
    singles = [r for r in records if r["kind"] == "single"]
    clear = [r for r in singles if r["first"]["clear"]]
    pairs = [r for r in records if r["kind"] == "pair" and r["first"]["both_visible"]]
    unknown = [r for r in records if r["kind"] == "unknown"]
    return [
        _row(f"right class{words}", clear, lambda v: v["class"], "0.95"),
        _row(f"right class, all singles{words}", singles, lambda v: v["class"], ""),
        _row(f"both of two{words}", pairs, lambda v: v["right"], "0.80"),
        _row(f"never listed is flagged{words}", unknown, lambda v: v["right"], ""),
    ]


def _row(
    title: str, records: Sequence[Record], check: Callable[[Record], bool], bar: str
) -> str:
    before = [check(r["first"]) for r in records]
    after = [check(_last(r)) for r in records]
    return f"| {title} | {share(title, before).cell} | {share(title, after).cell} | {bar} |"


def _last(record: Record) -> Record:
    """The answer that stands: of both visits, or of the first where none was advised."""
    answer: Record = record["second"] if record["visited"] else record["first"]
    return answer


def _calibration(visited: Sequence[Record]) -> list[str]:
    """Predicted probability that the likeliest answer is right, and the share that is."""
    lines = [
        "| predicted | cases | mean before | mean predicted | right before | right after |",
        "|---|---|---|---|---|---|",
    ]
    for low, high in (*BINS, (0.0, 1.0)):
        part = [r for r in visited if low <= r["predicted"] < high + (high == 1.0)]
        if part:
            lines.append(
                f"| {low:g} to {high:g} | {len(part)} | {_mean(part, 'now')}"
                f" | {_mean(part, 'predicted')} | {_right(part, 'first')}"
                f" | {_right(part, 'second')} |"
            )
    return lines


def _mean(records: Sequence[Record], name: str) -> str:
    return f"{np.mean([record[name] for record in records]):.2f}"


def _right(records: Sequence[Record], visit: str) -> str:
    return share(visit, [record[visit]["likeliest_right"] for record in records]).cell
