"""Plans of measurement: instruments, set-ups, runs, their order and time, what is recorded.

A plan is drawn anew for every case (order of runs, pauses), but its set-ups are those
of the study file of its name. Rows are in the order in which they were taken, set-up
after set-up. SI: m, rad, s, m/s, N.

Every set-up has six state columns s; which of them a calibration knows as unknowns,
with what tolerance, is in `nuisances`. Instruments take complex input.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.blind.generator.machines import (
    MACHINES,
    Array,
    Machine,
    cayley,
    norm,
    tip,
)

# -- instruments -----------------------------------------------------------------------
STATE = 6  # columns of s
Settings = Mapping[str, float]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Instrument:
    """An instrument."""

    name: str
    channels: tuple[tuple[str, float], ...]  #: column stems, and noise sigma of each, m
    #: (tip, reference tip, s, reference s, settings) -> (n, channels); m
    read: Callable[[Array, Array, Array, Array, Settings], Array]
    nuisances: Mapping[int, float]  #: {state column: tolerance}
    drifts: tuple[int, ...]  #: state columns that move when the mount creeps
    reference: str | None = None  #: "teach", "run" or None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Setup:
    """An instrument as mounted; tool: added along the tool's axis, m; teach: SI."""

    name: str
    instrument: Instrument
    tool: float = 0.0
    settings: Settings = dataclasses.field(default_factory=dict)
    teach: tuple[float, ...] | None = None


def _taught(tip: Array, ref: Array, s: Array, sref: Array, k: Settings) -> Array:
    return norm(tip - ref - s[:, :3])[:, None]


def _free(tip: Array, ref: Array, s: Array, sref: Array, k: Settings) -> Array:
    return norm(tip - s[:, :3] - np.array([k["at_x"], k["at_y"], k["at_z"]]))[:, None]


def _rm4(tip: Array, ref: Array, s: Array, sref: Array, k: Settings) -> Array:
    d = tip - ref
    return (d[:, 1] - s[:, 0] * d[:, 2] + s[:, 1] - sref[:, 1])[:, None]


def _rm5(tip: Array, ref: Array, s: Array, sref: Array, k: Settings) -> Array:
    d = tip - ref
    across = d[:, 2] - s[:, 0] * d[:, 1] + s[:, 2] - sref[:, 2]
    return np.stack([d[:, 1] + s[:, 1] - sref[:, 1], across], -1)


def _probe(tip: Array, ref: Array, s: Array, sref: Array, k: Settings) -> Array:
    return (tip[:, 2] + s[:, 0])[:, None]


def _tracker(tip: Array, ref: Array, s: Array, sref: Array, k: Settings) -> Array:
    flat = np.array([0.5, 0.5, 0.0])  # half the angle: the Gibbs vector of a small turn
    turn = cayley(s[:, 3:6] * flat) @ cayley(s[:, 3:6] * np.array([0.0, 0.0, 0.5]))
    return np.einsum("nij,nj->ni", turn, tip) + s[:, :3]


_CUP = (0, 1, 2)
BAR = Instrument(
    name="ball_bar",
    channels=(("length", 0.5e-6),),
    read=_taught,
    nuisances=dict.fromkeys(_CUP, 0.02e-3),
    drifts=_CUP,
    reference="teach",
)
FREE_BAR = Instrument(
    name="ball_bar_free_cup",
    channels=(("length", 0.5e-6),),
    read=_free,
    nuisances=dict.fromkeys(_CUP, 1.0e-3),
    drifts=_CUP,
)
RM4 = Instrument(
    name="rm4",
    channels=(("dy", 3e-6),),
    read=_rm4,
    nuisances={0: 0.02e-3},
    drifts=(1,),
    reference="run",
)
RM5 = Instrument(
    name="rm5",
    channels=(("dy", 1e-6), ("dz", 3e-6)),
    read=_rm5,
    nuisances={0: 0.02e-3},
    drifts=(1, 2),
    reference="run",
)
PROBE = Instrument(
    name="height_probe",
    channels=(("height", 20e-6),),
    read=_probe,
    nuisances={0: 0.05e-3},
    drifts=(0,),
)
TRACKER = Instrument(
    name="pose_tracker_position",
    channels=tuple((f"read_{n}", 10e-6) for n in "xyz"),
    read=_tracker,
    nuisances=dict.fromkeys(range(6), 0.05e-3),
    drifts=(0, 1, 2),
)
BARS = ("ball_bar", "ball_bar_free_cup")


# -- runs: passes along paths ----------------------------------------------------------
Index = NDArray[np.int_]
MM_MIN = 1e-3 / 60.0

#: commands (m, dof) along a path in its order, and their phases (m,)
Path = tuple[Array, Array]


@dataclasses.dataclass(frozen=True)
class Run:
    """One pass along a path."""

    setup: int  #: number of the set-up
    path: str  #: name of the path
    command: Array  #: (m, dof) in the order of travel
    phase: Array  #: (m,) rad along a circle, or -1..1 along a line
    closed: bool  #: whether the path is a closed circle
    direction: int  #: +1 or -1
    feed: float  #: m/s
    payload: float  #: N


@dataclasses.dataclass(frozen=True)
class Levels:
    """Feeds (m/s) and payloads (N) of a plan, lower first."""

    feed: tuple[float, float]
    load: tuple[float, float]


def spread(
    rng: Generator,
    setup: int,
    paths: dict[str, Path],
    reference: str,
    levels: Levels,
    closed: bool,
    *,
    again: int,
    twice: bool = False,
) -> list[Run]:
    """Every path both ways, feeds and payloads balanced over them.

    The reference path comes `again` times in between. With `twice` every path is also
    passed with the other feed and payload. Half of the other combinations of direction,
    feed and payload are passed on the reference path.
    """

    def run(name: str, way: int, a: int, b: int) -> Run:
        """One pass with feed number a and payload number b."""
        command, phase = (values[::way] for values in paths[name])
        return Run(
            setup, name, command, phase, closed, way, levels.feed[a], levels.load[b]
        )

    runs = []
    for k, name in enumerate(paths):
        for j, way in enumerate((1, -1)):
            a, b = (k + j + int(rng.integers(2))) % 2, (k // 2 + j) % 2
            runs.append(run(name, way, a, b))
            if twice:
                runs.append(run(name, way, 1 - a, 1 - b))
    others = [(-1, 0, 0), (1, 1, 0), (1, 0, 1), (-1, 1, 1)]
    runs += [run(reference, *other) for other in others[: max(0, min(4, again))]]
    rng.shuffle(runs)
    base = run(reference, 1, 0, 0)
    for place in np.linspace(0, len(runs), again).astype(int)[::-1]:
        runs.insert(int(place), base)
    return runs


#: feeds (mm/min) and payloads (N) of the machines, lower first
FEEDS = {"a3": (600, 2400), "planar": (2000, 8000), "delta": (1500, 6000)}
FEEDS["hexapod"] = FEEDS["a3"]
LOADS = {"a3": (0, 300), "planar": (0, 500), "delta": (0, 5), "hexapod": (0, 200)}


def plan_levels(machine: str, name: str) -> Levels:
    """Feeds and payloads of a machine's plan; a poor plan has one of each."""
    feed, load = FEEDS[machine], LOADS[machine]
    if name == "poor":
        middle = np.sqrt(feed[0] * feed[1]) * MM_MIN
        return Levels((middle, middle), (0.0, 0.0))
    slow, fast = (value * MM_MIN for value in feed)
    return Levels((slow, fast), (float(load[0]), float(load[1])))


# -- paths: commands with their phases -------------------------------------------------


TEACH_Z, BAR_LENGTH = 1.286, 0.300


def a3_circle(z: float, tool: float, count: int) -> Path:
    """Commands (count, 3) at height z that keep the bar's length about the taught cup."""
    psi = 2 * np.pi * (np.arange(count) + 0.37) / count  # no leg turns at a reading
    machine = MACHINES["a3"]

    length, cup = np.full(count, tool), np.array([0.0, 0.0, TEACH_Z + tool])

    def excess(theta: Array) -> Array:
        pose = machine.inverse(np.stack([np.full(count, z), psi, theta], -1), length)
        away = tip(machine, pose.x, pose.R0, length) - cup
        return np.asarray(np.sqrt((away**2).sum(-1)) - BAR_LENGTH)

    low, high = np.full(count, 1e-3), np.full(count, np.deg2rad(40.0))
    for _ in range(48):
        mid = (low + high) / 2
        far = excess(mid) > 0
        low, high = np.where(far, low, mid), np.where(far, mid, high)
    return np.stack([np.full(count, z), psi, (low + high) / 2], -1), psi


def line(axis: int, other: float, count: int) -> Path:
    """Commands (count, 2) along y (axis 0) or z (1), at no multiples of a pitch."""
    low, high = ((-1.5, 1.5), (0.0, 1.5))[axis]
    s = np.linspace(-1.0, 1.0, count)
    s[1:-1] += (0.31 / count) * np.sin(2.4 * np.arange(1, count - 1) ** 1.3)
    command = np.full((count, 2), other)
    command[:, axis] = (low + high) / 2 + s * (high - low) / 2
    return command, s


def delta_circle(radius: float, z: float, count: int) -> Path:
    a = 2 * np.pi * (np.arange(count) + 0.3) / count
    return np.stack([radius * np.cos(a), radius * np.sin(a), np.full(count, z)], -1), a


def delta_row(y: float, count: int) -> Path:
    half = np.sqrt(0.135**2 - y**2)
    s = np.linspace(-1.0, 1.0, count)
    return np.stack([half * s, np.full(count, y), np.zeros(count)], -1), s


#: orientation along a hexapod's circle, deg: constant rx, ry, spin, and the size of a
#: tilt that goes round with it
_TILTS = (
    (0.0, 0.0, 0.0, 0.0),
    (11.0, 0.0, 6.0, 0.0),
    (-8.0, 9.0, -9.0, 0.0),
    (0.0, -12.0, 12.0, 0.0),
    (0.0, 0.0, -12.0, 10.0),
    (4.0, 4.0, 10.0, -9.0),
    (-11.0, -6.0, 0.0, 0.0),
    (9.0, 10.0, -4.0, 0.0),
    (0.0, 5.0, 3.0, 9.0),
    (-5.0, 0.0, -13.0, -8.0),
)


def hex_circle(number: int, tool: float, count: int) -> Path:
    radius = (0.095, 0.060)[number % 2]
    rx, ry, spin, wave = np.deg2rad(_TILTS[number % len(_TILTS)])
    a = 2 * np.pi * (np.arange(count) + 0.37) / count
    z = 0.200 + tool + np.sqrt(BAR_LENGTH**2 - radius**2)
    place = [radius * np.cos(a), radius * np.sin(a), np.full(count, z)]
    tilt = [rx + wave * np.cos(2 * a + number), ry + wave * np.sin(a)]
    return np.stack([*place, *tilt, np.full(count, spin)], -1), a


# -- set-ups and runs of each machine --------------------------------------------------


A3_HEIGHTS: tuple[float, ...] = (1.066, 1.116, 1.166, 1.216, 1.266)
SetupsAndRuns = tuple[tuple[Setup, ...], list[list[Run]]]


def _a3(rng: Generator, name: str) -> SetupsAndRuns:
    cup, long = (
        Setup(name=label, instrument=BAR, tool=tool, teach=(TEACH_Z + tool, 0.0, 0.0))
        for label, tool in (("cup", 0.0), ("long_tool", 0.1))
    )
    levels, count, heights = plan_levels("a3", name), 24, A3_HEIGHTS
    if name == "poor":
        count, heights = 30, (1.066, 1.146, 1.206, 1.266)
    paths = {f"z{1e3 * z:.0f}": a3_circle(z, 0.0, count) for z in heights}
    reference = "z1206" if name == "poor" else "z1166"
    again = {"full": 4, "single": 4, "poor": 3}[name]
    twice = name == "single"
    first = spread(rng, 0, paths, reference, levels, True, again=again, twice=twice)
    if name != "full":
        return (cup,), [first]
    high = {f"z{1e3 * z + 100:.0f}": z + 0.1 for z in A3_HEIGHTS[::2]}
    paths = {label: a3_circle(z, 0.1, count) for label, z in high.items()}
    return (cup, long), [first, spread(rng, 1, paths, "z1266", levels, True, again=3)]


def _planar(rng: Generator, name: str) -> SetupsAndRuns:
    rm5, rm4 = (Setup(name=i.name, instrument=i) for i in (RM5, RM4))
    levels = plan_levels("planar", name)
    z = (0.0, 0.375, 0.75, 1.125, 1.5) if name == "full" else (0.0, 0.75, 1.5)
    y = (-1.5, -0.75, 0.0, 0.75, 1.5) if name == "full" else (-1.5, 0.0, 1.5)
    flat = {f"z{1e3 * v:.0f}": line(0, v, 13) for v in z}
    steep = {f"y{1e3 * v:.0f}": line(1, v, 13) for v in y}
    again = 3 if name == "full" else 2
    runs = [
        spread(rng, 0, flat, "z750", levels, False, again=again),
        spread(rng, 1, steep, "y0", levels, False, again=again),
    ]
    return (rm5, rm4), runs


def _delta(rng: Generator, name: str) -> SetupsAndRuns:
    tracker = Setup(name="tracker", instrument=TRACKER)
    probe = Setup(name="probe", instrument=PROBE)
    levels = plan_levels("delta", name)
    again = 3 if name == "full" else 2
    rings = [(0.06, 0.06), (0.13, 0.06), (0.13, 0.18), (0.06, 0.30), (0.12, 0.30)]
    rings = rings if name == "full" else [rings[1], rings[4]]
    paths = {f"r{1e3 * r:.0f}z{1e3 * z:.0f}": delta_circle(r, z, 13) for r, z in rings}
    reference = "r130z180" if name == "full" else "r130z60"
    # some circles are left out: three channels a row are many readings soon
    ring = spread(rng, 0, paths, reference, levels, True, again=again)
    if name != "poor":
        ring = [r for k, r in enumerate(ring) if r.path == reference or k % 3]
    places = (-0.11, -0.075, -0.035, 0.005, 0.04, 0.08, 0.12)
    rows = {f"y{1e3 * v:.0f}": delta_row(v, 10) for v in places}
    bed = spread(rng, 1, rows, "y5", levels, False, again=again)
    return (tracker, probe), [ring, bed]


def _hexapod(rng: Generator, name: str) -> SetupsAndRuns:
    def cup(label: str, tool: float) -> Setup:
        settings = {"at_x": 0.0, "at_y": 0.0, "at_z": 0.2 + tool}
        return Setup(name=label, instrument=FREE_BAR, tool=tool, settings=settings)

    levels = plan_levels("hexapod", name)
    count = 26 if name == "poor" else 20
    numbers = range(5) if name == "poor" else range(8)
    paths = {f"c{k + 1}": hex_circle(k, 0.0, count) for k in numbers}
    first = spread(rng, 0, paths, "c2", levels, True, again=2 if name == "poor" else 3)
    if name == "poor":
        return (cup("bar", 0.0),), [first]
    paths = {f"c{k + 1}": hex_circle(k, 0.1, count) for k in (1, 4, 5, 8, 9)}
    second = spread(rng, 1, paths, "c2", levels, True, again=2)
    return (cup("bar", 0.0), cup("long_tool", 0.1)), [first, second]


SETUPS_AND_RUNS: dict[str, Callable[[Generator, str], SetupsAndRuns]] = dict(
    a3=_a3, planar=_planar, delta=_delta, hexapod=_hexapod
)
PLANS = {
    "a3": ("full", "single", "poor"),
    **dict.fromkeys(("planar", "delta", "hexapod"), ("full", "poor")),
}


# -- rows of a case --------------------------------------------------------------------


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
    bars = any(s.instrument.name in BARS for s in setups)
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
        self, rng: Generator, machine: Machine, setups: tuple[Setup, ...], total: int
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
        rows: dict[str, Any] = {k: np.concatenate(v) for k, v in self._rows.items()}
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
