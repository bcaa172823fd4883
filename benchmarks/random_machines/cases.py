"""Random machines without a gap: how often the diagnosis reports one.

    PYTHONPATH=. oed campaign --allow-code benchmarks/random_machines.campaign.toml --seeds 155
    python -m benchmarks.harness random_machines

A case is a random machine with its study and its readings, in files as a user has them.
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.harness import tables
from benchmarks.harness.statistics import share
from benchmarks.random_machines import machines, sessions
from benchmarks.random_machines.sessions import Bench, Mounted
from oed import build_study, diagnose, identify, read_readings
from oed.mechanism import AssemblyError
from oed.model import Machine
from pkm_studies.base import Silent
from pkm_studies.stages import RunState

Record = Mapping[str, Any]
#: verdict where the check of the readings takes a clean machine's for mistaken
MISTAKEN, FAILED = "mistaken", "failed"
Array = np.ndarray
SIGMAS = (0.1e-6, 0.5e-3)
SHARES = (3e-7, 3e-4)  #: least and largest noise over the machine's size
MOST = 700  #: readings of channels of one machine, at most
#: how often each instrument is taken, by what the machine moves
SPACE = ("ball_bar", "ball_bar", "camera", "pose_tracker_position", "laser_ball_bar",
         "calliper", "height")  # fmt: skip
TURNING = (*SPACE, "pose_tracker", "pose_tracker")
CHOICES = {
    "planar_2dof": ("rm1", "rm4", "rm5", "camera", "pose_tracker_position", "calliper"),
    "cables_planar": ("planar_position", "camera", "calliper"),
}
#: units of commands in the readings
COMMANDS = {"m": ("mm", 1e3), "rad": ("deg", 180.0 / math.pi)}


@dataclasses.dataclass(frozen=True)
class Case:
    """A machine without a gap."""

    model: str  #: as drawn
    law: sessions.Law  #: of the noise
    instruments: tuple[str, ...]  #: names of the set-ups' instruments
    study: Mapping[str, Any]  #: tables of the study
    readings: pd.DataFrame  #: the readings file's table


def machine_of(table: Mapping[str, Any]) -> Machine:
    """The toolkit's machine of a `[machine]` table."""
    setup = {"name": "s", "instrument": "pose_tracker_position"}
    tables = {"schema": 1, "name": "random", "machine": table, "setup": [setup]}
    return RunState.start(build_study(tables), None, Silent(), []).resolved.machine


def draw(number: int, seed: int) -> Case:
    """Case `number` of a seed: models and laws take turns, the rest is random."""
    rng = np.random.default_rng([seed, number])
    model = machines.MODELS[number % len(machines.MODELS)]
    law = sessions.LAWS[(number // len(machines.MODELS) + number) % len(sessions.LAWS)]
    own = machine_of({"model": model})
    while True:  # a random geometry may have no workspace
        drawn = machines.draw(model, own, rng)
        try:
            return case_of(drawn, sessions.draw_law(law, rng), rng)
        except AssemblyError:
            continue


def _sigma(size: float, rng: np.random.Generator) -> float:
    low, high = np.clip(np.array(SHARES) * size, *SIGMAS)
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def case_of(
    drawn: machines.Drawn,
    law: sessions.Law,
    rng: np.random.Generator,
    kinds: Sequence[str] = (),
    plan: sessions.Plan | None = None,
) -> Case:
    """A drawn machine, read by instruments of these kinds, or by random ones.

    Raises AssemblyError where no path is within reach.
    """
    machine = machine_of(drawn.table)
    free = np.array([p.name not in machine.frame for p in machine.parameters])
    tolerance = np.array([p.tolerance for p in machine.parameters]) * free
    errors = machines.parameter_errors(tolerance, rng, rng.uniform(0.3, 1.0))
    truth = machines.Truth(machine, machine.nominal + errors)
    sigma = _sigma(drawn.size, rng)
    centre = truth.nominal(machine.home_command[None])[0][0]
    bench = Bench(centre, drawn.size, sigma, rng)
    if not kinds:
        count = 1 + (rng.random() < 0.35)
        kinds = [str(k) for k in rng.choice(_choices(machine, drawn.model), count)]
    if plan is None:
        plan = sessions.draw_plan(drawn.size, MOST // (3 * len(kinds)), rng)
    session = _Session(machine, truth, bench, plan, law)
    setups = [session.take(f"s{k + 1}", kind) for k, kind in enumerate(kinds)]
    tables = {
        "schema": 1,
        "name": "random",
        "seed": 1,
        "machine": dict(drawn.table),
        "setup": [s.table for s in setups],
        "noise": {str(s.table["name"]): dict(s.noise) for s in setups if s.noise},
    }
    readings = pd.concat(session.rows, ignore_index=True)
    return Case(drawn.model, law, tuple(kinds), tables, readings)


def _choices(machine: Machine, model: str) -> tuple[str, ...]:
    if model in CHOICES:
        return CHOICES[model]
    turns = any(c.unit == "rad" for c in machine.pose)
    return TURNING if turns else SPACE


class _Session:
    """Readings set-up after set-up, on one clock."""

    def __init__(
        self,
        machine: Machine,
        truth: machines.Truth,
        bench: Bench,
        plan: sessions.Plan,
        law: sessions.Law,
    ) -> None:
        self.machine, self.truth, self.bench = machine, truth, bench
        self.plan, self.law = plan, law
        self.rows: list[pd.DataFrame] = []
        self._now = 0.0

    def take(self, name: str, kind: str) -> Mounted:
        """Read all paths of a set-up."""
        rng, plan = self.bench.rng, self.plan
        length, cup = self._bar()
        mounted = self._mount(name, kind, length, cup)
        passes = (True, False) if plan.both else (True,)
        times = sessions.clock(plan, plan.runs * len(passes), plan.readings, rng)
        times += self._now
        self._now = float(times.max()) + 600.0
        warm = sessions.temperatures(times, rng)
        taken = 0
        for number in range(plan.runs):
            path = self._path(kind, length, cup)
            for forward in passes:
                commands = path if forward else path[::-1]
                said = sessions.covariates(
                    plan, number, forward, times[taken], warm[taken]
                )
                label = f"{number + 1}{'+' if forward else '-'}"
                row = self._pass(mounted, label, commands, said)
                self.rows.append(row)
                taken += 1
        return mounted

    def _bar(self) -> tuple[float, Array]:
        """Length of a ball bar and the place (3,) of its cup."""
        reach = [
            0.5 * (c.upper - c.lower) for c in self.machine.workspace() if c.unit == "m"
        ]
        if len(reach) == 3:
            middle = [0.5 * (c.upper + c.lower) for c in self.machine.workspace()[:3]]
            length = 0.75 * min(reach)
            return length, np.array(middle) - np.array([0.0, 0.0, 0.4 * length])
        length = 0.8 * self.bench.size
        return length, self.bench.centre - np.array([0.0, 0.0, length])

    def _mount(self, name: str, kind: str, length: float, cup: Array) -> Mounted:
        if kind == "ball_bar":
            return sessions.ball_bar(self.bench, name, length, cup)
        if kind.startswith("rm"):
            return sessions.relative(self.bench, name, kind)
        if kind in sessions.OTHERS:
            return sessions.OTHERS[kind](self.bench, name)
        return sessions.position(self.bench, name, kind)

    def _path(self, kind: str, length: float, cup: Array) -> Array:
        rng, count = self.bench.rng, self.plan.readings
        if kind.startswith("rm"):
            return self._straight(kind)
        wanted = "loop" if kind == "ball_bar" else ""
        path = sessions.path(self.machine, count, self.truth.joints, rng, wanted)
        if kind != "ball_bar":
            return path
        names = [c.name for c in self.machine.command]
        if names[:3] == ["x", "y", "z"]:
            path[:, :3] = sessions.circles(count, length, cup, rng)
        else:
            self._lead(path, length, cup)
        if not sessions.within_reach(self.machine, path, self.truth.joints):
            raise AssemblyError("the ball bar leads out of reach", np.array([0]))
        return path

    def _lead(self, path: Array, length: float, cup: Array) -> None:
        """Set the heights of a tripod's path so that the bar keeps its length."""
        for _ in range(6):
            point = self.truth.nominal(path)[0]
            flat = ((point[:, :2] - cup[:2]) ** 2).sum(axis=1)
            path[:, 0] += cup[2] + np.sqrt(length**2 - flat) - point[:, 2]

    def _straight(self, kind: str) -> Array:
        """A line along y, or along z (rm2, rm4), of the planar machine."""
        rng, count = self.bench.rng, self.plan.readings
        low, high = (
            np.array([getattr(c, end) for c in self.machine.workspace()])
            for end in ("lower", "upper")
        )
        path = np.tile(rng.uniform(low, high), (count, 1))
        moving = 1 if kind in ("rm2", "rm4") else 0
        path[:, moving] = np.linspace(low[moving], high[moving], count)
        return path

    def _pass(
        self, mounted: Mounted, label: str, commands: Array, said: Mapping[str, Any]
    ) -> pd.DataFrame:
        """Rows of one pass of a path."""
        rng, count = self.bench.rng, len(commands)
        chains = [self.law.chain(count, rng) for _ in range(mounted.sources)]
        point, rotation = self.truth.tool(commands)
        values = mounted.read(point, rotation, np.column_stack(chains))
        rows: dict[str, Any] = {
            "setup": mounted.table["name"],
            "run": label,
            "order": np.arange(1, count + 1),
        }
        for k, coordinate in enumerate(self.machine.command):
            unit, factor = COMMANDS[coordinate.unit]
            rows[f"{coordinate.name}_{unit}"] = factor * commands[:, k]
        rows |= said
        for k, column in enumerate(mounted.channels):
            rows[column] = values[:, k]
        table = pd.DataFrame(rows)
        if mounted.reference and "length_mm" in mounted.channels:
            table.loc[0, "length_mm"] = np.nan
        return table


def write(case: Case, folder: Path) -> Path:
    """Write the readings into a folder; returns their path. Raises OSError."""
    path = folder / "random.readings.csv"
    case.readings.to_csv(path, index=False, float_format="%.17g")
    return path


# -- the diagnosis -------------------------------------------------------------------------
def alarm(setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """The diagnosis of one machine; one that fails leaves its traceback.

    The setting names the stream, the seed of all machines.
    """
    case = draw(seed, setting["stream"])
    facts = {"model": case.model, "law": case.law.name, "setups": len(case.instruments)}
    try:
        return facts | answer(case)
    except Exception:  # whatever fails is a defect to be read in the row
        return facts | {"verdict": FAILED, "traceback": traceback.format_exc()}


def answer(case: Case) -> dict[str, Any]:
    """What the diagnosis of a case says."""
    with tempfile.TemporaryDirectory() as folder:
        path = write(case, Path(folder))
        readings = read_readings(build_study(case.study, folder), path)
        state = diagnose(identify(readings)).state
    gap = state.result.gap
    if gap is None:
        return {"verdict": MISTAKEN, "words": list(state.warnings)}
    answers = [[a.effects, round(a.probability, 4)] for a in gap.answers[:5]]
    return {"verdict": gap.verdict, "answers": answers}


# -- table -----------------------------------------------------------------------------
def is_alarm(record: Record) -> bool:
    """Whether anything but "none" was said of a machine without a gap."""
    return bool(record["verdict"] != "none")


def table(records: Sequence[Record]) -> str:
    """False alarms of all machines, by noise law and by number of set-ups."""
    lines = [tables.head("", "machines", "false alarms", "95 % interval")]
    lines.append(_row("all", records))
    for field in ("law", "setups"):
        for value in sorted({r[field] for r in records}):
            of_value = [r for r in records if r[field] == value]
            lines.append(_row(f"{field} {value}", of_value))
    return "\n".join(lines)


def _row(name: str, records: Sequence[Record]) -> str:
    alarms = share(name, [is_alarm(r) for r in records])
    hits, low, high = (100.0 * v for v in (alarms.value, alarms.low, alarms.high))
    count = sum(map(is_alarm, records))
    interval = f"{low:.1f}..{high:.1f} %"
    return tables.row(name, len(records), f"{count} ({hits:.1f} %)", interval)
