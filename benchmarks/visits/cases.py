"""Cases of the second generator that are visited again: what the advised readings decide.

    PYTHONPATH=. oed campaign --allow-code benchmarks/visits.campaign.toml --seeds 40
    python -m benchmarks.harness visits

Each case is diagnosed, visited again for what the diagnosis advises, and diagnosed with
both visits.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.harness import tables
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
        "second": _judge(first.label, second),
    }


def _judge(label: Mapping[str, Any], diagnosis: Diagnosis) -> dict[str, Any]:
    """The answer, and whether it is right."""
    scored = Scored(label, diagnosis_record(diagnosis))
    kept = set().union(*scored.classes) if scored.effects else set()
    likeliest = max(_named(diagnosis).items(), key=lambda item: item[1])[0]
    right = not likeliest
    if scored.effects:
        right = scored.names_are_right(frozenset(likeliest))
    return {
        "class": bool(scored.detected and scored.names and scored.names <= kept),
        "right": scored.is_right,
        "likeliest_right": bool(right),
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
    order_of_setups = list(dict.fromkeys(run.setup for run in visit.runs))
    runs = []
    for run in sorted(visit.runs, key=lambda run: order_of_setups.index(run.setup)):
        direction = int(run.condition.get("direction", 1.0))
        command = run.command[::direction]
        poses = {}
        for column in first.case.cmd:
            stem, unit = column.rsplit("_", 1)
            values = command[:, names.index(stem)]
            poses[column] = values / MM if unit == "mm" else np.degrees(values)
        feed = run.condition.get("feed", 0.02) / units.MM_PER_MIN
        stated = {"feed": feed, "payload": run.condition.get("payload", 0.0)}
        here = {"setup": numbers[run.setup], "poses": poses, "dir": direction}
        runs.append(here | stated)
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
        tables.head("measure", "first visit", "after the second"),
    ]
    for words, some in (("", judged), (", visited", visited)):
        lines += _rows(words, some)
    columns = ("mean before", "mean predicted", "right before", "right after")
    lines += ["", tables.head("visited", *columns)]
    if visited:
        means = [
            f"{np.mean([r[n] for r in visited]):.2f}" for n in ("now", "predicted")
        ]
        right = [
            _cell([r[v] for r in visited], "likeliest_right")
            for v in ("first", "second")
        ]
        lines.append(tables.row(len(visited), *means, *right))
    return "\n".join(lines)


def _readings(visited: Sequence[Record]) -> str:
    shares = [record["further"] / record["readings"] for record in visited]
    return f"{np.mean(shares):.2f} (at most {max(shares):.2f})" if shares else "none"


def _rows(words: str, records: Sequence[Record]) -> list[str]:
    singles = [r for r in records if r["kind"] == "single"]
    clear = [r for r in singles if r["first"]["clear"]]
    pairs = [r for r in records if r["kind"] == "pair" and r["first"]["both_visible"]]
    unknown = [r for r in records if r["kind"] == "unknown"]
    return [
        _row(f"right class{words}", clear, "class"),
        _row(f"right class, all singles{words}", singles, "class"),
        _row(f"both of two{words}", pairs, "right"),
        _row(f"never listed is flagged{words}", unknown, "right"),
    ]


def _row(title: str, records: Sequence[Record], measure: str) -> str:
    """Before and after; without a second visit the first answer stands."""
    before = [r["first"] for r in records]
    after = [r["second"] if r["visited"] else r["first"] for r in records]
    return tables.row(title, _cell(before, measure), _cell(after, measure))


def _cell(answers: Sequence[Record], measure: str) -> str:
    return share(measure, [answer[measure] for answer in answers]).cell
