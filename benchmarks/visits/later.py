"""A case of the second generator that is visited again: the same machine, effects, noise law.

The generator draws effects over the rows of one session. Here their draws are repeated
over the rows of both, with all reductions (means, ranges, ends of time) over those of the
first, so that the first session's readings are the same. Temperatures are not recorded.
"""

from __future__ import annotations

import copy
import dataclasses
import importlib
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from oed.base import Array

#: largest share by which a repeated draw may miss the first session's change
ALIKE = 1e-3
#: ranges of the numbers of a noise law, and their names in a label
RANGES = {
    (0.6, 1.5): "repeat_over_sigma",
    (0.8, 0.95): "rho",
    (0.4, 0.9): "ar_over_sigma",
}
#: what an effect is drawn over: rows of readings, and of the paths between them
ARRAYS = ("t", "x0", "q0", "qd", "vel", "Q", "QD", "u", "payload", "dir", "feed", "cup")
#: from the last reading of the first visit, between runs, and for a change (s)
PAUSE, BETWEEN, CHANGE = 600.0, 120.0, 240.0
SUBSTEPS, LEAD = 4, 2  #: substeps from pose to pose, and poses of the lead-in


@dataclasses.dataclass
class First:
    """A case as first drawn, and what draws it again.

    case, y, label  the generator's case, readings (mm) and label
    after_design    state of its random numbers after the design
    effects         state before each effect's draw, its pool, amplitude and first change
    """

    case: Any
    y: Array
    label: Mapping[str, Any]
    after_design: Any
    effects: list[tuple[Any, Mapping[str, Any], float, Array]]
    seed: Sequence[int]


class _FirstRows(np.ndarray):
    """Values whose reductions are those of the first session's rows."""

    count, every = 0, -1

    def __array_finalize__(self, source: Any) -> None:
        self.count = getattr(source, "count", 0)
        self.every = getattr(source, "every", -1)

    def _rows(self) -> Array:
        plain = np.asarray(self)
        whole = self.ndim and len(self) == self.every
        return plain[: self.count] if whole else plain

    def max(self, *args: Any, **options: Any) -> Any:
        """Largest of the first session."""
        return self._rows().max(*args, **options)

    def min(self, *args: Any, **options: Any) -> Any:
        """Smallest of the first session."""
        return self._rows().min(*args, **options)

    def mean(self, *args: Any, **options: Any) -> Any:
        """Mean of the first session."""
        return self._rows().mean(*args, **options)


class _Numpy:
    """NumPy whose `ptp` is over the first session's rows."""

    def __init__(self, lengths: Mapping[int, int]) -> None:
        self._lengths = lengths

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)

    def ptp(self, values: Any, axis: int | None = None) -> Any:
        """Range, of the first session where there are rows of both."""
        plain = np.asarray(values)
        return np.ptp(plain[: self._lengths.get(len(plain), len(plain))], axis=axis)


class _SameLaw:
    """Random numbers that draw the noise law of a label again."""

    def __init__(self, rng: np.random.Generator, law: Mapping[str, Any]) -> None:
        self._rng, self._law = rng, law

    def __getattr__(self, name: str) -> Any:
        return getattr(self._rng, name)

    def uniform(self, low: float, high: float, size: Any = None) -> Any:
        """A number of the law, or a new one."""
        name = RANGES.get((low, high))
        if size is None and name in self._law:
            return self._law[name]
        return self._rng.uniform(low, high, size)


def modules(folder: Path) -> Any:
    """The generator's `make`; its other modules are its attributes' modules."""
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    return importlib.import_module("make")


def draw(
    make: Any, machine: str, kind: str, law: str, severity: float, seed: Sequence[int]
) -> First:
    """A case with what draws it again."""
    draws: list[tuple[Any, Any, Any]] = []
    chosen: list[tuple[Any, Mapping[str, Any], float, Array]] = []
    states: list[Any] = []

    def design(name: str, rng: np.random.Generator, poor: bool) -> Any:
        case = original["design"](name, rng, poor)
        states.append(copy.deepcopy(rng.bit_generator.state))
        return case

    def draw_effect(case: Any, rng: np.random.Generator, pool: Any, name: str) -> Any:
        state = copy.deepcopy(rng.bit_generator.state)
        drawn = original["draw"](case, rng, pool, name)
        draws.append((drawn[1], state, pool))
        return drawn

    def sized(*arguments: Any) -> Any:
        result = original["sized"](*arguments)
        state, pool = next((s, p) for f, s, p in draws if f is result[1])
        chosen.append((state, pool, result[3], result[5]))
        return result

    replaced = {
        "design": design,
        "draw": draw_effect,
        "sized": sized,
        "sensors": lambda *_: {},
    }
    original = {name: getattr(make, name) for name in replaced}
    with mock.patch.multiple(make, **replaced):
        rng = np.random.default_rng(seed)
        case, y, label = make.make_case(machine, kind, law, rng, severity)
    return First(case, y, label, states[0], chosen, seed)


def visit_again(
    make: Any, first: First, runs: Sequence[Mapping[str, Any]]
) -> tuple[Array, Array]:
    """Readings (n,), mm, of further runs, and the time of each row (r,), s.

    runs  set-up (number), columns of commanded poses, direction, feed (mm/min), payload

    Raises ValueError where a draw cannot be repeated.
    """
    both, rows = with_runs(first.case, runs)
    geometry = _geometry(make, first, both)
    both.at(geometry)  # legs' forces and directions are those of the machine as built
    total = importlib.import_module("truth").Pert()
    still = both.readings(geometry)
    for state, pool, amplitude, change in first.effects:
        effect = _effect(make, first, both, state, pool)
        there = (both.readings(geometry + effect(amplitude)) - still)[: len(change)]
        factor = float(there @ change / max(there @ there, 1e-300))
        acting = effect(factor * amplitude)
        there = (both.readings(geometry + acting) - still)[: len(change)]
        if np.linalg.norm(there - change) > ALIKE * np.linalg.norm(change):
            raise ValueError("the draw of an effect depends on the second visit")
        total = total + acting
    later = np.arange(first.case.ny, both.ny)
    exact = both.readings(geometry + total)[later]
    rng = _SameLaw(np.random.default_rng([*first.seed, 2]), first.label["law"])
    noise = importlib.import_module("effects").noise
    if not np.isfinite(exact).all():
        raise ValueError("a path of the second visit leaves the workspace")
    errors = noise(rows, rng, first.label["law"]["law"])[0]
    return exact + errors, rows.t


def _geometry(make: Any, first: First, both: Any) -> Any:
    rng = np.random.default_rng(first.seed)
    rng.bit_generator.state = first.after_design
    if first.label["kind"] != "class":
        rng.random()
    geometry = importlib.import_module("truth").Pert()
    for _, sd, change in both.params():
        geometry = geometry + change * (sd * rng.normal())
    return geometry


def _effect(make: Any, first: First, both: Any, state: Any, pool: Any) -> Any:
    """The effect's draw over the rows of both sessions."""
    rng = np.random.default_rng(first.seed)
    rng.bit_generator.state = state
    frozen = copy.copy(both)
    for name in ARRAYS:
        values = np.array(getattr(both, name)).view(_FirstRows)
        values.every = len(values)
        values.count = len(getattr(first.case, name))
        setattr(frozen, name, values)
    frozen.temps = {}
    lengths = {both.n: first.case.n, len(both.Q): len(first.case.Q)}
    reductions = mock.patch.object(
        importlib.import_module("effects"), "np", _Numpy(lengths)
    )
    with reductions:
        _, effect, _ = make.draw(frozen, rng, pool, first.case.m.name)

    def plain(size: float) -> Any:
        with reductions:
            change = effect(size)
        return type(change)({k: np.array(v) for k, v in change.items()})

    return plain


# -- rows of further runs, and the paths between them ----------------------------------
def with_runs(case: Any, runs: Sequence[Mapping[str, Any]]) -> tuple[Any, Any]:
    """The case with further runs, and these alone."""
    truth = importlib.import_module("truth")
    later = _Rows(case)
    for run in runs:
        later.add(run)
    alone = later.case(truth, with_first=False)
    return later.case(truth, with_first=True), alone


class _Rows:
    """Rows of further runs of a case: arrays of each run, to be joined."""

    def __init__(self, case: Any) -> None:
        self.first = case
        self.names = list(case.cmd)
        self.runs: list[dict[str, Any]] = []
        self.parts: list[dict[str, Array]] = []
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
        if not np.isfinite(self._pose_and_joints(dense, tool)[1]).all():
            dense, at = _path(table, referred, from_inside=True)
        point, joints = self._pose_and_joints(dense, tool)
        way = np.linalg.norm(np.diff(point, axis=0), axis=1)
        elapsed = np.r_[0.0, np.cumsum(way)] / (run["feed"] / 60.0)
        rates, velocity = np.zeros_like(joints), np.zeros_like(point)
        if instrument == "calliper":
            elapsed = np.arange(len(dense)) * 7.5
        else:
            rates = np.gradient(joints, self.clock + elapsed, axis=0)
            velocity = np.gradient(point, self.clock + elapsed, axis=0)
        rows = sum(len(part["command"]) for part in self.parts)
        on_paths = sum(len(part["path_time"]) for part in self.parts)
        self.parts.append(
            {
                "command": table,
                "time": np.round(self.clock + elapsed[at], 1),
                "reads": np.array(_reads(case.setups[setup], rows, len(table))),
                "at": on_paths + at,
                "path_time": self.clock + elapsed,
                "joints": joints,
                "rates": rates,
                "velocity": velocity[at],
            }
        )
        stated = {name: run[name] for name in ("dir", "feed", "payload")}
        number = len(self.runs)
        self.runs.append({"setup": setup, "run": number, **stated, "ref": False})
        self.clock += elapsed[-1] + BETWEEN

    def _pose_and_joints(self, poses: Array, tool: float) -> tuple[Array, Array]:
        """Tool points (n, 3) and joints (n, K) of poses (n, p); NaN where out of reach."""
        m = self.first.m
        x, rotation = m.pose(dict(zip(self.names, poses.T, strict=True)), tool)
        offset = np.array([0, 0, -1.0]) * np.full((len(poses), 1, 1), tool)
        with np.errstate(invalid="ignore"):
            return x, np.asarray(m.inverse(x, rotation, m.A + offset))

    def _joined(self, name: str) -> Array:
        return np.concatenate([part[name] for part in self.parts])

    def _stated(self, name: str, per: str = "command") -> Array:
        """What is stated of each run, at its rows or along its path."""
        counts = [len(part[per]) for part in self.parts]
        return np.repeat([run[name] for run in self.runs], counts)

    def case(self, truth: Any, *, with_first: bool) -> Any:
        """These rows as a case, after those of the first session or alone."""
        one = self.first
        runs, rows, on_paths = 0, 0, 0
        if with_first:
            runs, rows, on_paths = len(one.runs), one.n, len(one.tD)

        def joined(before: Any, after: Array) -> Array:
            return np.concatenate([before, after]) if with_first else after

        reads = [tuple(r) for r in self._joined("reads") + np.array([rows, rows, 0])]
        if with_first:
            reads = [*zip(one.row, one.ref, one.kind, strict=True), *reads]
        commands = zip(self.names, self._joined("command").T, strict=True)
        case = truth.Case(
            one.m,
            one.setups,
            joined(one.setup, self._stated("setup")),
            joined(one.run, runs + self._stated("run")),
            {name: joined(one.cmd[name], column) for name, column in commands},
            joined(one.t, self._joined("time")),
            *(
                joined(getattr(one, n), self._stated(n))
                for n in ("dir", "feed", "payload")
            ),
            reads,
        )
        case.lead, case.grating, case.tight = one.lead, one.grating, one.tight
        case.temps = {}
        case.runs = [*one.runs, *self.runs] if with_first else self.runs
        case.idx = joined(one.idx, on_paths + self._joined("at")).astype(int)
        case.tD = joined(one.tD, self._joined("path_time"))
        case.payD = joined(one.payD, self._stated("payload", "path_time"))
        case.runD = joined(one.runD, runs + self._stated("run", "path_time"))
        case.Q = joined(one.Q, self._joined("joints"))
        case.QD = joined(one.QD, self._joined("rates"))
        case.qd = case.QD[case.idx]
        case.vel = joined(one.vel, self._joined("velocity"))
        sigma = np.array([setup["sigma_um"] for setup in one.setups])
        case.sigma = sigma[case.setup[case.row]] * 1e-3
        return case


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
