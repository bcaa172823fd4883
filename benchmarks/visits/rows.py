"""Rows of further runs of a case of the second generator, and the paths between them."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from oed.base import Array

#: from the last reading of the first visit, between runs, and for a change (s)
PAUSE, BETWEEN, CHANGE = 600.0, 120.0, 240.0
#: substeps from pose to pose, and poses of the lead-in
SUBSTEPS, LEAD = 4, 2


def with_runs(case: Any, runs: Sequence[Mapping[str, Any]]) -> tuple[Any, Any]:
    """The case with further runs, and these alone."""
    truth = importlib.import_module("truth")
    later = _Rows(case)
    for run in runs:
        later.add(run)
    alone = later.case(truth, with_first=False)
    return later.case(truth, with_first=True), alone


class _Rows:
    """Rows of further runs of a case."""

    def __init__(self, case: Any) -> None:
        self.first = case
        self.names = list(case.cmd)
        self.cmd: dict[str, list[float]] = {n: [] for n in self.names}
        self.dense: dict[str, list[float]] = {n: [] for n in self.names}
        self.rows: dict[str, list[Any]] = {
            n: [] for n in ("setup", "run", "time", "dir", "feed", "payload")
        }
        self.reads: list[tuple[int, int, int]] = []
        self.idx: list[int] = []
        self.path: dict[str, list[Any]] = {
            n: [] for n in ("t", "tool", "payload", "run", "moves")
        }
        self.runs: list[dict[str, Any]] = []
        self.clock = float(case.tD.max()) + PAUSE
        self.last: tuple[int, float] = (int(case.setup[-1]), float(case.payload[-1]))

    def add(self, run: Mapping[str, Any]) -> None:
        """A run after the others."""
        case, setup = self.first, int(run["setup"])
        here = (setup, float(run["payload"]))
        self.clock += CHANGE * (here != self.last)
        self.last = here
        table = np.column_stack([run["poses"][n] for n in self.names])
        if "psi_deg" in self.names:
            k = self.names.index("psi_deg")
            table[:, k] = np.unwrap(table[:, k], period=360.0)
        instrument = case.setups[setup]["instrument"]
        referred = instrument in ("relative", "calliper")
        tool = case.setups[setup].get("tool_mm", 0.0)
        dense, at = _path(table, referred)
        if not np.isfinite(self._joints(dense, tool)).all():
            dense, at = _path(table, referred, from_inside=True)
        columns = {n: dense[:, j] for j, n in enumerate(self.names)}
        way = np.linalg.norm(np.diff(case.m.pose(columns, tool)[0], axis=0), axis=1)
        elapsed = np.r_[0.0, np.cumsum(way)] / (run["feed"] / 60.0)
        if instrument == "calliper":
            elapsed = np.arange(len(dense)) * 7.5
        number, count, start = len(self.runs), len(table), len(self.rows["run"])
        for n in self.names:
            self.cmd[n] += table[:, self.names.index(n)].tolist()
            self.dense[n] += columns[n].tolist()
        self.idx += (len(self.path["t"]) + at).tolist()
        self.path["t"] += (self.clock + elapsed).tolist()
        self.path["tool"] += [tool] * len(dense)
        self.path["payload"] += [run["payload"]] * len(dense)
        self.path["run"] += [number] * len(dense)
        self.path["moves"] += [instrument != "calliper"] * len(dense)
        values = {
            "setup": setup,
            "run": number,
            "dir": run["dir"],
            "feed": run["feed"],
            "payload": run["payload"],
        }
        for n, value in values.items():
            self.rows[n] += [value] * count
        self.rows["time"] += np.round(self.clock + elapsed[at], 1).tolist()
        self.reads += _reads(case.setups[setup], start, count)
        self.runs.append({**values, "ref": False})
        self.clock += elapsed[-1] + BETWEEN

    def _joints(self, poses: Array, tool: float) -> Array:
        """Joints (n, K) of poses (n, p); NaN where they are out of reach."""
        m = self.first.m
        x, rotation = m.pose(dict(zip(self.names, poses.T, strict=True)), tool)
        offset = np.array([0, 0, -1.0]) * np.full((len(poses), 1, 1), tool)
        with np.errstate(invalid="ignore"):
            return np.asarray(m.inverse(x, rotation, m.A + offset))

    def case(self, truth: Any, *, with_first: bool) -> Any:
        """These rows as a case, after those of the first session or alone."""
        one, shift = self.first, len(self.first.runs)
        rows, dense = one.n, len(one.tD)

        def joined(before: Any, after: Any) -> Array:
            return np.concatenate([before, after]) if with_first else np.asarray(after)

        number = np.asarray(self.rows["run"]) + (shift if with_first else 0)
        at = np.array(self.reads)
        if with_first:
            at = at + np.array([rows, rows, 0])
        reads = [tuple(r) for r in at]
        if with_first:
            reads = [*zip(one.row, one.ref, one.kind, strict=True), *reads]
        case = truth.Case(
            one.m,
            one.setups,
            joined(one.setup, self.rows["setup"]),
            joined(one.run, number),
            {n: joined(one.cmd[n], self.cmd[n]) for n in self.names},
            joined(one.t, self.rows["time"]),
            joined(one.dir, self.rows["dir"]),
            joined(one.feed, self.rows["feed"]),
            joined(one.payload, self.rows["payload"]),
            reads,
        )
        case.lead, case.grating, case.temps, case.tight = (
            one.lead,
            one.grating,
            {},
            one.tight,
        )
        case.runs = [*one.runs, *self.runs] if with_first else self.runs
        q, rates, velocity = self._motion(one)
        at_rows = np.asarray(self.idx)
        case.idx = joined(one.idx, at_rows + (dense if with_first else 0)).astype(int)
        case.tD = joined(one.tD, self.path["t"])
        case.payD = joined(one.payD, self.path["payload"])
        case.runD = joined(
            one.runD, np.asarray(self.path["run"]) + (shift if with_first else 0)
        )
        case.Q, case.QD = joined(one.Q, q), joined(one.QD, rates)
        case.qd, case.vel = case.QD[case.idx], joined(one.vel, velocity[at_rows])
        case.sigma = (
            np.array([one.setups[k]["sigma_um"] for k in case.setup[case.row]]) * 1e-3
        )
        return case

    def _motion(self, one: Any) -> tuple[Array, Array, Array]:
        """Joints, their rates and the tool's velocity along the paths."""
        tool = np.asarray(self.path["tool"])
        x, rotation = one.m.pose(self.dense, tool)
        q = one.m.inverse(
            x, rotation, one.m.A + np.array([0, 0, -1.0]) * tool[:, None, None]
        )
        rates, velocity = np.zeros_like(q), np.zeros_like(x)
        runs, time = np.asarray(self.path["run"]), np.asarray(self.path["t"])
        for k in np.unique(runs):
            at = runs == k
            if np.asarray(self.path["moves"])[at].all():
                rates[at] = np.gradient(q[at], time[at], axis=0)
                velocity[at] = np.gradient(x[at], time[at], axis=0)
        return q, rates, velocity


def _path(
    table: Array, referred: bool, *, from_inside: bool = False
) -> tuple[Array, Array]:
    """Poses on the way, with a lead-in, and which of them are read.

    from_inside  lead in from the side of the poses to come, where the other is out of
                 reach
    """
    start = 1 if referred else 0
    step = table[start + 1] - table[start]
    step = -step if from_inside else step
    lead = table[start] - np.arange(LEAD, 0, -1)[:, None] * step / (
        SUBSTEPS if referred else 1
    )
    points = np.vstack([table[:start], lead, table[start:]])
    wanted = np.r_[np.arange(start), start + LEAD + np.arange(len(table) - start)]
    fine = np.arange((len(points) - 1) * SUBSTEPS + 1) / SUBSTEPS
    dense = np.column_stack(
        [np.interp(fine, np.arange(len(points)), c) for c in points.T]
    )
    return dense, wanted * SUBSTEPS


def _reads(
    setup: Mapping[str, Any], start: int, count: int
) -> list[tuple[int, int, int]]:
    """(row, reference, kind) of each reading of a run."""
    truth, design = importlib.import_module("truth"), importlib.import_module("design")
    if setup["instrument"] == "relative":
        channels = design.RM[setup["measurement"]][1]
        return [(start + j, start, c) for j in range(1, count) for c in channels]
    if setup["instrument"] == "calliper":
        return [(start + j, start, truth.DIST) for j in range(1, count)]
    kind = truth.HEIGHT if setup["instrument"] == "height_probe" else truth.BAR
    return [(start + j, start + j, kind) for j in range(count)]
