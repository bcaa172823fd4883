"""Plans of measurement: set-ups, runs, their order, time, direction, feed, payload.

A plan is drawn anew for every case (order of runs, pauses), but its set-ups are those
of the study file of its name. Rows are in the order in which they were taken, set-up
after set-up. SI: m, rad, s, m/s, N.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.random import Generator

from benchmarks.blind.generator import instruments
from benchmarks.blind.generator.instruments import Setup
from benchmarks.blind.generator.machine import Array, Machine, tip
from benchmarks.blind.generator.machine_plans import SETUPS_AND_RUNS
from benchmarks.blind.generator.machines import MACHINES
from benchmarks.blind.generator.runs import Index, Run

TEACH, REFERENCE, READ = 0, 1, 2


@dataclasses.dataclass(frozen=True, kw_only=True)
class Plan:
    """Rows of a case, n of them.

    machine      the machine
    name         of the plan
    setups       its set-ups
    command      (n, dof) commands
    setup        (n,) number of the set-up
    run          (n,) number of the run, -1 for taught poses
    kind         (n,) TEACH, REFERENCE or READ
    ref          (n,) the row read against, or the row itself
    order        (n,) number in the run
    time         (n,) s
    direction, feed, payload, repeat, phase    (n,) of the run
    runs         rows of each run, in order of travel (references included)
    closed       whether each run is a closed circle
    pauses       (start, end) of the pauses, s
    columns      covariates that the file shows
    """

    machine: Machine
    name: str
    setups: tuple[Setup, ...]
    command: Array
    setup: Index
    run: Index
    kind: Index
    ref: Index
    order: Index
    time: Array
    direction: Array
    feed: Array
    payload: Array
    repeat: Index
    phase: Array
    runs: tuple[Index, ...]
    closed: tuple[bool, ...]
    pauses: tuple[tuple[float, float], ...]
    columns: tuple[str, ...]

    @property
    def tool(self) -> Array:
        """Tool (n,) of each row, m."""
        return np.array([s.tool for s in self.setups])[self.setup]

    def run_name(self, k: int) -> str:
        """Label of a run in the file."""
        return f"R{k + 1:02d}"

    @property
    def study(self) -> str:
        """Study file of the set-ups."""
        return f"{self.machine.name}_{self.name}.study.toml"


TEMPERATURES = ("temp_leg_C", "temp_frame_C", "temp_bar_C")


_WHOLE = ("setup", "run", "kind", "ref", "order", "repeat")
_DEFAULT = {"direction": 0.0, "feed": 0.0, "payload": 0.0, "repeat": 0, "phase": 0.0}


def draw(rng: Generator, machine: str, name: str) -> Plan:
    """A plan of a machine; `name` is one of PLANS[machine]."""
    setups, blocks = SETUPS_AND_RUNS[machine](rng, name)
    columns = _columns(rng, setups, name)
    session = _Session(rng, MACHINES[machine], setups, sum(len(b) for b in blocks))
    for k, block in enumerate(blocks):
        session.take_setup(k, block)
    return session.plan(name, columns)


def _columns(rng: Generator, setups: tuple[Setup, ...], name: str) -> tuple[str, ...]:
    """Covariates in the file.

    All in a good plan, temperatures in some; a poor plan lacks one to three.
    """
    shown = ["time_s", "direction", "feed_mm_min", "payload_N", "repeat"]
    bars = any(s.instrument.name in instruments.BARS for s in setups)
    if rng.random() < (0.5 if name != "poor" else 0.25):
        shown += [t for t in TEMPERATURES if t != "temp_bar_C" or bars]
    if name == "poor":
        lost = ("time_s", "direction", "feed_mm_min", "payload_N")
        for gone in rng.choice(lost, int(rng.integers(1, 4)), replace=False):
            shown.remove(str(gone))
    return tuple(shown)


class _Session:
    """Rows of a plan in the order in which they are taken, with the clock."""

    def __init__(
        self,
        rng: Generator,
        machine: Machine,
        setups: tuple[Setup, ...],
        total: int,
    ) -> None:
        """Start the clock; `total` is the number of runs."""
        self._rng, self._machine, self._setups = rng, machine, setups
        self._rows: dict[str, list[Array]] = {}
        self._count = 0
        self._runs: list[Run] = []
        self._members: list[Index] = []
        self._pauses: list[tuple[float, float]] = []
        self._passes: dict[tuple[object, ...], int] = {}
        self._clock = 600.0 * rng.uniform(0.5, 2.0)
        self._gap = rng.uniform(6.2, 7.6) * 3600.0 / total

    def take_setup(self, k: int, runs: Sequence[Run]) -> None:
        """Take all runs of a set-up, after mounting it where it is not the first."""
        if k:
            self._pause(1500.0, 3600.0)
        taught = None
        if self._setups[k].instrument.reference == "teach":
            taught = self._teach(k)
        first, last = len(runs) // 3, 2 * len(runs) // 3 + 1
        lunch = int(self._rng.integers(first, last))
        for number, run in enumerate(runs):
            if number == lunch and self._rng.random() < 0.7:
                self._pause(1200.0, 3000.0)
            self._take_run(k, run, taught)

    def plan(self, name: str, columns: tuple[str, ...]) -> Plan:
        """The plan of all that was taken."""
        rows: dict[str, Any] = {}
        for key, parts in self._rows.items():
            rows[key] = np.concatenate(parts)
        return Plan(
            machine=self._machine,
            name=name,
            setups=self._setups,
            runs=tuple(self._members),
            closed=tuple(run.closed for run in self._runs),
            pauses=tuple(self._pauses),
            columns=columns,
            **rows,
        )

    def _pause(self, shortest: float, longest: float) -> None:
        end = self._clock + self._rng.uniform(shortest, longest)
        self._pauses.append((self._clock, end))
        self._clock = end

    def _teach(self, k: int) -> int:
        """Take the taught pose of a set-up; the number of its row."""
        self._append(
            setup=k,
            run=-1,
            kind=TEACH,
            ref=self._count,
            order=0,
            time=self._clock - 120.0,
            command=[self._setups[k].teach],
        )
        self._count += 1
        return self._count - 1

    def _take_run(self, k: int, run: Run, taught: int | None) -> None:
        key = (k, run.path, run.direction, run.feed, run.payload)
        self._passes[key] = self._passes.get(key, 0) + 1
        size = len(run.command)
        members = self._count + np.arange(size)
        kind, ref = np.full(size, READ), members
        if self._setups[k].instrument.reference == "run":
            kind[0] = REFERENCE
            ref = np.full(size, self._count)
        elif taught is not None:
            ref = np.full(size, taught)
        seconds = self._clock + _travel(self._machine, self._setups[k].tool, run)
        self._append(
            setup=k,
            run=len(self._runs),
            kind=kind,
            ref=ref,
            order=1 + np.arange(size),
            time=seconds,
            command=run.command,
            direction=run.direction,
            feed=run.feed,
            payload=run.payload,
            repeat=self._passes[key],
            phase=run.phase,
        )
        self._runs.append(run)
        self._members.append(members)
        self._count += size
        self._clock = seconds[-1] + self._gap * self._rng.uniform(0.6, 1.2)

    def _append(self, **values: object) -> None:
        """Add rows; scalars are repeated."""
        command = np.atleast_2d(np.asarray(values.pop("command"), dtype=float))
        self._rows.setdefault("command", []).append(command)
        for key, value in {**_DEFAULT, **values}.items():
            dtype = int if key in _WHOLE else float
            column = np.broadcast_to(np.asarray(value, dtype=dtype), len(command))
            self._rows.setdefault(key, []).append(column.copy())


def _travel(machine: Machine, tool: float, run: Run) -> Array:
    """Seconds (m,) since the run's first row, at its feed."""
    length = np.full(len(run.command), tool)
    pose = machine.inverse(run.command, length)
    points = tip(machine, pose.x, pose.R0, length)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)]) / run.feed
