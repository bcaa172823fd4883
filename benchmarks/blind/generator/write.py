"""Sets of cases on disk.

    DIR/manifest.jsonl           a line a case, in the order of names that reveal nothing:
                                 id, study, readings
    DIR/order.txt                ids in the order in which they were drawn
    DIR/cases/ID.readings.csv    what a diagnosis may read
    DIR/labels.jsonl             what only the scorer may read
    DIR/truth/ID.npz             likewise: see `truth`

Existing cases stay, so that an interrupted run can go on; the lists are written again.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.blind.generator import cases, noise
from benchmarks.blind.generator.cases import Case
from benchmarks.blind.generator.machine import Array
from benchmarks.blind.generator.plans import TEACH
from benchmarks.blind.generator.runs import Index


def generate(
    out: Path,
    *,
    name: str,
    count: int,
    seed: int,
    machines: Collection[str] = (),
    kinds: Collection[str] = (),
    report: Callable[[int, int], None] = lambda done, count: None,
) -> int:
    """Write `count` cases of a set; returns how many are new.

    machines, kinds    only these, where given
    report             takes the number of cases done, and of all

    Case k does not depend on the other arguments. Raises OSError, ValueError for
    unknown names, and where `out` holds other cases.
    """
    wanted = _numbers(name, count, seed, machines, kinds)
    names = [cases.identity(seed, name, k) for k in wanted]
    _check_order(out / "order.txt", names)
    for folder in ("cases", "truth"):
        (out / folder).mkdir(parents=True, exist_ok=True)
    new = 0
    labels, lines = [], []
    for done, k in enumerate(wanted):
        label, is_new = _one(out, name, seed, k)
        new += is_new
        labels.append(label)
        lines.append(_line(label))
        report(done + 1, len(wanted))
    order = np.argsort([str(line["id"]) for line in lines])
    _replace(out / "manifest.jsonl", _as_lines([lines[i] for i in order]))
    _replace(out / "labels.jsonl", _as_lines([labels[i] for i in order]))
    _replace(out / "order.txt", "".join(f"{n}\n" for n in names))
    return new


def _check_order(file: Path, names: Sequence[str]) -> None:
    """Raise ValueError unless the cases of a folder are the first of these, or more."""
    there = file.read_text(encoding="utf-8").split() if file.is_file() else []
    if any(a != b for a, b in zip(there, names, strict=False)):
        raise ValueError(
            f"{file.parent} holds a set of another seed, kind or machine: choose"
            " another folder"
        )


def _as_lines(records: Sequence[dict[str, object]]) -> str:
    return "".join(json.dumps(record) + "\n" for record in records)


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
    numbers: list[int] = []
    k = 0
    while len(numbers) < count:
        if k > 1000 * (count + 1):
            raise ValueError(
                f"set {name} has no case of {sorted(kinds)} on {sorted(machines)}"
            )
        role = cases.role(seed, name, k)
        of_machine = not machines or role.machine in machines
        if of_machine and (not kinds or role.kind in kinds):
            numbers.append(k)
        k += 1
    return numbers


def _one(out: Path, name: str, seed: int, k: int) -> tuple[dict[str, object], bool]:
    """The label of case k, which is made if it is not there; and whether it is new."""
    key = cases.identity(seed, name, k)
    stored = out / "truth" / f"{key}.json"
    if stored.is_file():
        return json.loads(stored.read_text(encoding="utf-8")), False
    case = cases.make(seed, name, k)
    label = cases.label(case) | {"set": name, "study": case.stage.plan.study}
    _replace(
        out / "cases" / f"{key}.readings.csv",
        table(case).to_csv(index=False, lineterminator="\n"),
    )
    np.savez(out / "truth" / f"{key}.npz", allow_pickle=False, **truth(case))
    _replace(stored, json.dumps(label))
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
    """The readings as a file has them: text, empty where there is no reading."""
    plan = case.stage.plan
    rows = np.flatnonzero(plan.kind != TEACH)
    cells: dict[str, list[str]] = {
        "setup": [plan.setups[k].name for k in plan.setup[rows]],
        "run": [plan.run_name(int(k)) for k in plan.run[rows]],
        "order": [str(k) for k in plan.order[rows]],
    }
    for k, (stem, unit) in enumerate(plan.machine.command):
        factor = {"mm": 1e3, "deg": 180.0 / np.pi}[unit]
        cells[f"{stem}_{unit}"] = [f"{v:.9f}" for v in plan.command[rows, k] * factor]
    for column, values, form in _covariates(case):
        if column in plan.columns:
            cells[column] = [form.format(v) for v in values[rows]]
    return pd.DataFrame(cells | _readings(case, rows))


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
    """What the oracle needs, by name.

    dy_0, dy_1, ...    (N,) exact change by each effect alone
    y0, clean          (N,) readings without and with effects, both without noise
    y                  (N,) readings
    J                  (N, m) slopes
    prior, theta       (m,) tolerances and values of the parameters, and their names
    group_..., law     grouping and law of the noise: `covariance` makes Sigma of them
    """
    arrays: dict[str, Array] = {f"dy_{i}": s.change for i, s in enumerate(case.sized)}
    arrays |= {
        "y0": case.scene.y,
        "clean": case.clean,
        "y": case.y,
        "J": case.scene.J.astype(np.float32),
        "prior": case.scene.prior,
        "theta": case.scene.theta,
        "names": np.array(case.scene.names),
    }
    for field in dataclasses.fields(case.group):
        arrays[f"group_{field.name}"] = getattr(case.group, field.name)
    arrays["law"] = np.array(json.dumps(dataclasses.asdict(case.law)))
    return arrays


def covariance(truth: Mapping[str, Any]) -> Array:
    """Sigma (N, N), m^2, of a truth file as loaded."""
    law = noise.Law(**json.loads(str(truth["law"])))
    names = [field.name for field in dataclasses.fields(noise.Grouping)]
    grouping = noise.Grouping(**{name: truth[f"group_{name}"] for name in names})
    return noise.covariance(law, grouping)
