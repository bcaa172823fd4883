"""Sets of cases on disk.

    DIR/manifest.jsonl         a line a case, in the order of names that tell nothing:
                               id, study, readings
    DIR/cases/ID.readings.csv  what a diagnosis may read
    DIR/labels.jsonl           what only the scorer may read
    DIR/truth/ID.npz           likewise: see `truth`

Cases that are there already are left alone, so that a run can be taken up again; the
lists are made anew.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.blind.generator import cases, noise
from benchmarks.blind.generator.cases import Case
from benchmarks.blind.generator.machines import Array
from benchmarks.blind.generator.plans import TEACH, Index


def generate(
    out: Path,
    *,
    name: str,
    count: int,
    seed: int,
    machines: Collection[str] = (),
    kinds: Collection[str] = (),
    told: Callable[[int, int], None] = lambda done, count: None,
) -> int:
    """Write `count` cases of a set, of some machines and kinds only where these are
    given; returns how many are new.

    Case k is the same whatever else is asked for. Raises OSError, ValueError for
    unknown names.
    """
    for folder in ("cases", "truth"):
        (out / folder).mkdir(parents=True, exist_ok=True)
    wanted = _numbers(name, count, seed, machines, kinds)
    new = 0
    labels, lines = [], []
    for done, k in enumerate(wanted):
        label, made = _one(out, name, seed, k)
        new += made
        labels.append(label)
        lines.append(_line(label))
        told(done + 1, len(wanted))
    order = np.argsort([str(line["id"]) for line in lines])
    _replace(
        out / "manifest.jsonl", "".join(json.dumps(lines[i]) + "\n" for i in order)
    )
    _replace(out / "labels.jsonl", "".join(json.dumps(labels[i]) + "\n" for i in order))
    return new


def _numbers(
    name: str, count: int, seed: int, machines: Collection[str], kinds: Collection[str]
) -> list[int]:
    """The first `count` numbers of cases of the wanted machines and kinds."""
    for given, known in ((machines, cases.ON.get(name, ())), (kinds, cases.KINDS)):
        for word in given:
            if word not in known:
                raise ValueError(
                    f"set {name} has no {word!r}; it has {', '.join(known)}"
                )
    found: list[int] = []
    k = 0
    while len(found) < count:
        if k > 1000 * (count + 1):
            raise ValueError(
                f"set {name} has no case of {sorted(kinds)} on {sorted(machines)}"
            )
        part = cases.role(seed, name, k)
        if (not machines or part.machine in machines) and (
            not kinds or part.kind in kinds
        ):
            found.append(k)
        k += 1
    return found


def _one(out: Path, name: str, seed: int, k: int) -> tuple[dict[str, object], bool]:
    """The label of case k, made if it is not there; and whether it was made."""
    key = cases.identity(seed, name, k)
    kept = out / "truth" / f"{key}.json"
    if kept.is_file():
        return json.loads(kept.read_text(encoding="utf-8")), False
    case = cases.make(seed, name, k)
    label = cases.label(case) | {"set": name, "study": case.stage.plan.study}
    _replace(
        out / "cases" / f"{key}.readings.csv",
        table(case).to_csv(index=False, lineterminator="\n"),
    )
    np.savez(out / "truth" / f"{key}.npz", allow_pickle=False, **truth(case))
    _replace(kept, json.dumps(label))
    return label, True


def _line(label: dict[str, object]) -> dict[str, object]:
    return {
        "id": label["id"],
        "study": label["study"],
        "readings": f"cases/{label['id']}.readings.csv",
    }


def _replace(path: Path, text: str) -> None:
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_text(text, encoding="utf-8", newline="")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def table(case: Case) -> pd.DataFrame:
    """The readings as a file shows them: text, empty where there is nothing."""
    plan = case.stage.plan
    rows = np.flatnonzero(plan.kind != TEACH)
    said: dict[str, list[str]] = {
        "setup": [plan.setups[k].name for k in plan.setup[rows]],
        "run": [plan.run_name(int(k)) for k in plan.run[rows]],
        "order": [str(k) for k in plan.order[rows]],
    }
    for k, (stem, unit) in enumerate(plan.machine.command):
        factor = {"mm": 1e3, "deg": 180.0 / np.pi}[unit]
        said[f"{stem}_{unit}"] = [f"{v:.9f}" for v in plan.command[rows, k] * factor]
    for column, values, form in _covariates(case):
        if column in plan.columns:
            said[column] = [form.format(v) for v in values[rows]]
    return pd.DataFrame(said | _readings(case, rows))


def _covariates(case: Case) -> list[tuple[str, Array, str]]:
    plan = case.stage.plan
    return [
        ("time_s", plan.time, "{:.2f}"),
        ("direction", plan.direction, "{:.0f}"),
        ("feed_mm_min", plan.feed * 6e4, "{:.3f}"),
        ("payload_N", plan.payload, "{:.1f}"),
        *(
            (name, values, "{:.1f}")
            for name, values in case.stage.climate.shown.items()
        ),
        ("repeat", plan.repeat.astype(float), "{:.0f}"),
    ]


def _readings(case: Case, rows: Index) -> dict[str, list[str]]:
    plan, layout = case.stage.plan, case.stage.layout
    cells: dict[str, list[str]] = {}
    at = 0
    for setup, here in zip(plan.setups, layout.rows, strict=True):
        channels = [f"{stem}_mm" for stem, _ in setup.instrument.channels]
        values = (
            case.y[at : at + len(here) * len(channels)].reshape(len(here), -1) * 1e3
        )
        at += values.size
        for k, column in enumerate(channels):
            whole = cells.setdefault(column, [""] * len(plan.kind))
            for i, v in zip(here, values[:, k], strict=True):
                whole[i] = f"{v:.7f}"
    return {column: [whole[i] for i in rows] for column, whole in cells.items()}


def truth(case: Case) -> dict[str, Array]:
    """What the oracle needs: `dy_0`, `dy_1`, ... (N,) exact change by each effect
    alone; `y0` without effects, `clean` with them, both free of noise; `y`; J (N, m)
    with `prior` and `theta` (m,); the grouping and law of the noise.

    `covariance` makes Sigma (N, N) of it.
    """
    found: dict[str, Array] = {f"dy_{i}": s.change for i, s in enumerate(case.sized)}
    found |= {
        "y0": case.scene.y,
        "clean": case.clean,
        "y": case.y,
        "J": case.scene.J.astype(np.float32),
    }
    found |= {
        "prior": case.scene.prior,
        "theta": case.scene.theta,
        "names": np.array(case.scene.names),
    }
    found |= {
        f"group_{f.name}": getattr(case.group, f.name)
        for f in dataclasses.fields(case.group)
    }
    found["law"] = np.array(json.dumps(dataclasses.asdict(case.law)))
    return found


def covariance(kept: Mapping[str, Any]) -> Array:
    """Sigma (N, N), m^2, of a truth file as loaded."""
    law = noise.Law(**json.loads(str(kept["law"])))
    names = [f.name for f in dataclasses.fields(noise.Grouping)]
    return noise.covariance(
        law, noise.Grouping(**{n: kept[f"group_{n}"] for n in names})
    )
