"""How each machine is measured: set-ups, runs, their order, time, direction, feed,
payload and repeats.

A plan is drawn anew for every case (order of runs, pauses), but its set-ups are those
of the study file of its name. Rows are in the order in which they were taken, set-up
after set-up. SI: m, rad, s, m/s, N.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.blind.generator import instruments
from benchmarks.blind.generator.instruments import Setup
from benchmarks.blind.generator.machines import MACHINES, Array, Machine, tip

Index = NDArray[np.int_]
MM_MIN = 1e-3 / 60.0
TEACH, REFERENCE, READ = 0, 1, 2


@dataclasses.dataclass(frozen=True, kw_only=True)
class Run:
    """One pass along a path: commands (m, dof) in the order of travel."""

    setup: int
    path: str
    command: Array
    phase: Array  # (m,) rad along a circle, or -1..1 along a line
    closed: bool
    direction: int
    feed: float
    payload: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class Plan:
    """Rows of a case. Shapes: n rows; `kind` TEACH, REFERENCE or READ; `ref` the row
    read against, or its own number.

    runs    rows of each run, in order of travel (references included);  closed: whether
            each is a closed circle
    columns covariates that the file shows
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
    paths: tuple[str, ...]
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


# -- paths -----------------------------------------------------------------------------

_TEACH_Z, _BAR = 1.286, 0.300


def _a3_circle(z: float, tool: float, count: int) -> tuple[Array, Array]:
    """Commands (count, 3) at height z that keep the bar's length about a cup taught at
    _TEACH_Z + tool.
    """
    psi = 2 * np.pi * (np.arange(count) + 0.37) / count  # no leg turns at a reading
    machine = MACHINES["a3"]

    def excess(theta: Array) -> Array:
        c = np.stack([np.full(count, z), psi, theta], -1)
        pose = machine.inverse(c, np.full(count, tool))
        away = tip(machine, pose.x, pose.R0, np.full(count, tool)) - np.array(
            [0.0, 0.0, _TEACH_Z + tool]
        )
        return np.asarray(np.sqrt((away**2).sum(-1)) - _BAR)

    low, high = np.full(count, 1e-3), np.full(count, np.deg2rad(40.0))
    for _ in range(48):
        mid = (low + high) / 2
        far = excess(mid) > 0
        low, high = np.where(far, low, mid), np.where(far, mid, high)
    return np.stack([np.full(count, z), psi, (low + high) / 2], -1), psi


def _line(axis: int, other: float, count: int) -> tuple[Array, Array]:
    """Commands (count, 2) along y (axis 0) or z (axis 1); places are no multiples of a
    screw's pitch.
    """
    low, high = ((-1.5, 1.5), (0.0, 1.5))[axis]
    s = np.linspace(-1.0, 1.0, count)
    s[1:-1] += (0.31 / count) * np.sin(2.4 * np.arange(1, count - 1) ** 1.3)
    command = np.full((count, 2), other)
    command[:, axis] = (low + high) / 2 + s * (high - low) / 2
    return command, s


def _delta_circle(radius: float, z: float, count: int) -> tuple[Array, Array]:
    a = 2 * np.pi * (np.arange(count) + 0.3) / count
    return np.stack([radius * np.cos(a), radius * np.sin(a), np.full(count, z)], -1), a


def _delta_row(y: float, count: int) -> tuple[Array, Array]:
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


def _hex_circle(number: int, tool: float, count: int) -> tuple[Array, Array]:
    radius = (0.095, 0.060)[number % 2]
    rx, ry, spin, wave = np.deg2rad(_TILTS[number % len(_TILTS)])
    a = 2 * np.pi * (np.arange(count) + 0.37) / count
    z = 0.200 + tool + np.sqrt(_BAR**2 - radius**2)
    tilt = [
        rx + wave * np.cos(2 * a + number),
        ry + wave * np.sin(a),
        np.full(count, spin),
    ]
    return (
        np.stack(
            [radius * np.cos(a), radius * np.sin(a), np.full(count, z), *tilt], -1
        ),
        a,
    )


#: rings of a hexaglide: radius, height of the middle over home's and how far up and
#: down it goes, m, and angles, deg: constant rx, ry, spin, and the size of a tilt that
#: goes round with it
_RINGS = (
    (0.080, -0.055, 0.030, 0.0, 0.0, 0.0, 7.0),
    (0.055, 0.060, 0.020, 6.0, -3.0, 9.0, 4.0),
    (0.092, 0.020, -0.045, -4.0, 5.0, -9.0, -5.0),
    (0.035, -0.010, 0.080, -7.0, -6.0, 5.0, 4.0),
    (0.070, -0.080, -0.015, 5.0, 7.0, -4.0, -4.0),
)
#: the same for circles about its taught cup: latitude on the ball of the bar's length,
#: deg, and angles
_LATITUDES = (
    (-12.0, 0.0, 0.0, 0.0, 9.0),
    (6.0, 7.0, -2.0, 8.0, -4.0),
    (22.0, -5.0, -6.0, -9.0, 5.0),
    (38.0, 3.0, 8.0, 4.0, -3.0),
    (57.0, -8.0, 2.0, -6.0, 3.0),
)
_GLIDE_HOME, _GLIDE_CUP, _SHORT_BAR = 0.200, 0.170, 0.100


def _glide_tilts(
    a: Array, rx: float, ry: float, spin: float, wave: float
) -> list[Array]:
    return list(
        np.deg2rad(
            [
                rx + wave * np.sin(a + 0.4),
                ry + wave * np.cos(2 * a),
                spin + 0.5 * wave * np.sin(2 * a),
            ]
        )
    )


def _glide_ring(number: int, tool: float, count: int) -> tuple[Array, Array]:
    radius, middle, rise, *angles = _RINGS[number]
    a = 2 * np.pi * (np.arange(count) + 0.41) / count
    z = _GLIDE_HOME + tool + middle + rise * np.sin(a - 0.7)
    return (
        np.stack(
            [radius * np.cos(a), radius * np.sin(a), z, *_glide_tilts(a, *angles)], -1
        ),
        a,
    )


def _glide_bar(number: int, count: int) -> tuple[Array, Array]:
    latitude, *angles = _LATITUDES[number]
    radius, up = (
        _SHORT_BAR * np.cos(np.deg2rad(latitude)),
        _SHORT_BAR * np.sin(np.deg2rad(latitude)),
    )
    a = 2 * np.pi * (np.arange(count) + 0.41) / count
    place = [radius * np.cos(a), radius * np.sin(a), np.full(count, _GLIDE_CUP + up)]
    return np.stack([*place, *_glide_tilts(a, *angles)], -1), a


# -- plans of the machines -------------------------------------------------------------

Made = tuple[tuple[Setup, ...], list[list[Run]]]


def _run(
    setup: int,
    path: str,
    made: tuple[Array, Array],
    way: int,
    feed: float,
    load: float,
    closed: bool,
) -> Run:
    command, phase = made
    if way < 0:
        command, phase = command[::-1], phase[::-1]
    return Run(
        setup=setup,
        path=path,
        command=command,
        phase=phase,
        closed=closed,
        direction=way,
        feed=feed,
        payload=load,
    )


@dataclasses.dataclass(frozen=True)
class _Levels:
    """Feeds (m/s) and payloads (N) of a plan, lower first."""

    feed: tuple[float, float]
    load: tuple[float, float]


def _spread(
    rng: Generator,
    setup: int,
    paths: dict[str, tuple[Array, Array]],
    reference: str,
    levels: _Levels,
    closed: bool,
    *,
    again: int,
    twice: bool = False,
) -> list[Run]:
    """Every path both ways, feeds and payloads balanced over them; the reference path
    `again` times in between.

    With `twice` every path is also passed with the other feed and payload. Half of the
    other combinations of direction, feed and payload are passed on the reference path.
    """
    runs = []
    for k, (name, made) in enumerate(paths.items()):
        for j, way in enumerate((1, -1)):
            a, b = (k + j + int(rng.integers(2))) % 2, (k // 2 + j) % 2
            runs.append(
                _run(setup, name, made, way, levels.feed[a], levels.load[b], closed)
            )
            if twice:
                runs.append(
                    _run(
                        setup,
                        name,
                        made,
                        way,
                        levels.feed[1 - a],
                        levels.load[1 - b],
                        closed,
                    )
                )
    made = paths[reference]
    others = [(-1, 0, 0), (1, 1, 0), (1, 0, 1), (-1, 1, 1)][: max(0, min(4, again))]
    runs += [
        _run(setup, reference, made, w, levels.feed[a], levels.load[b], closed)
        for w, a, b in others
    ]
    rng.shuffle(runs)
    base = _run(setup, reference, made, 1, levels.feed[0], levels.load[0], closed)
    for place in np.linspace(0, len(runs), again).astype(int)[::-1]:
        runs.insert(int(place), base)
    return runs


def _a3(rng: Generator, name: str) -> Made:
    cup = Setup(
        name="cup",
        instrument=instruments.BAR,
        settings={"length": _BAR},
        teach=(_TEACH_Z, 0.0, 0.0),
    )
    long = dataclasses.replace(
        cup, name="long_tool", tool=0.1, teach=(_TEACH_Z + 0.1, 0.0, 0.0)
    )
    count = 30 if name == "poor" else 24
    heights = (
        (1.066, 1.146, 1.206, 1.266)
        if name == "poor"
        else (1.066, 1.116, 1.166, 1.216, 1.266)
    )
    levels = _levels("a3", name)
    paths = {f"z{1e3 * z:.0f}": _a3_circle(z, 0.0, count) for z in heights}
    reference = "z1206" if name == "poor" else "z1166"
    again = {"full": 4, "single": 4, "poor": 3}[name]
    first = _spread(
        rng, 0, paths, reference, levels, True, again=again, twice=name == "single"
    )
    if name != "full":
        return (cup,), [first]
    paths = {
        f"z{1e3 * z + 100:.0f}": _a3_circle(z + 0.1, 0.1, count)
        for z in (1.066, 1.166, 1.266)
    }
    return (cup, long), [first, _spread(rng, 1, paths, "z1266", levels, True, again=3)]


def _levels(machine: str, name: str) -> _Levels:
    feed = {
        "a3": (600, 2400), "planar": (2000, 8000), "delta": (1500, 6000), "hexapod": (600, 2400),
        "hexaglide": (1000, 4000),
    }[machine]  # fmt: skip
    load = {
        "a3": (0, 300),
        "planar": (0, 500),
        "delta": (0, 5),
        "hexapod": (0, 200),
        "hexaglide": (0, 150),
    }[machine]
    if name == "poor":
        middle = np.sqrt(feed[0] * feed[1]) * MM_MIN
        return _Levels((middle, middle), (0.0, 0.0))
    return _Levels(
        (feed[0] * MM_MIN, feed[1] * MM_MIN), (float(load[0]), float(load[1]))
    )


def _planar(rng: Generator, name: str) -> Made:
    rm5, rm4 = (
        Setup(name="rm5", instrument=instruments.RM5),
        Setup(name="rm4", instrument=instruments.RM4),
    )
    levels = _levels("planar", name)
    z = (0.0, 0.375, 0.75, 1.125, 1.5) if name == "full" else (0.0, 0.75, 1.5)
    y = (-1.5, -0.75, 0.0, 0.75, 1.5) if name == "full" else (-1.5, 0.0, 1.5)
    flat = {f"z{1e3 * v:.0f}": _line(0, v, 13) for v in z}
    steep = {f"y{1e3 * v:.0f}": _line(1, v, 13) for v in y}
    again = 3 if name == "full" else 2
    runs = [
        _spread(rng, 0, flat, "z750", levels, False, again=again),
        _spread(rng, 1, steep, "y0", levels, False, again=again),
    ]
    return (rm5, rm4), runs


def _delta(rng: Generator, name: str) -> Made:
    tracker, probe = (
        Setup(name="tracker", instrument=instruments.TRACKER),
        Setup(name="probe", instrument=instruments.PROBE),
    )
    levels = _levels("delta", name)
    rings: tuple[tuple[float, float], ...] = (
        (0.06, 0.06),
        (0.13, 0.06),
        (0.13, 0.18),
        (0.06, 0.30),
        (0.12, 0.30),
    )
    rings = rings if name == "full" else (rings[1], rings[4])
    paths = {f"r{1e3 * r:.0f}z{1e3 * z:.0f}": _delta_circle(r, z, 13) for r, z in rings}
    reference = "r130z180" if name == "full" else "r130z60"
    # one way each but on the reference circle: three channels a row are many readings
    # soon
    ring = _spread(
        rng, 0, paths, reference, levels, True, again=3 if name == "full" else 2
    )
    ring = [
        r for k, r in enumerate(ring) if r.path == reference or k % 3 or name == "poor"
    ]
    rows = {
        f"y{1e3 * v:.0f}": _delta_row(v, 10)
        for v in (-0.11, -0.075, -0.035, 0.005, 0.04, 0.08, 0.12)
    }
    bed = _spread(rng, 1, rows, "y5", levels, False, again=3 if name == "full" else 2)
    return (tracker, probe), [ring, bed]


def _hexapod(rng: Generator, name: str) -> Made:
    def cup(label: str, tool: float) -> Setup:
        settings = {"length": _BAR, "at_x": 0.0, "at_y": 0.0, "at_z": 0.2 + tool}
        return Setup(
            name=label, instrument=instruments.FREE_BAR, tool=tool, settings=settings
        )

    levels = _levels("hexapod", name)
    count = 26 if name == "poor" else 20
    numbers = range(5) if name == "poor" else range(8)
    paths = {f"c{k + 1}": _hex_circle(k, 0.0, count) for k in numbers}
    first = _spread(rng, 0, paths, "c2", levels, True, again=2 if name == "poor" else 3)
    if name == "poor":
        return (cup("bar", 0.0),), [first]
    paths = {f"c{k + 1}": _hex_circle(k, 0.1, count) for k in (1, 4, 5, 8, 9)}
    return (cup("bar", 0.0), cup("long_tool", 0.1)), [
        first,
        _spread(rng, 1, paths, "c2", levels, True, again=2),
    ]


def _hexaglide(rng: Generator, name: str) -> Made:
    """A tracker with its target on a stem, and a short bar about a taught cup; the poor
    plan has the tracker alone.
    """
    stem = -0.080 if name == "full" else 0.0
    tracker = Setup(name="tracker", instrument=instruments.TRACKER, tool=stem)
    teach = (0.0, 0.0, _GLIDE_CUP, 0.0, 0.0, 0.0)
    cup = Setup(
        name="cup",
        instrument=instruments.BAR,
        settings={"length": _SHORT_BAR},
        teach=teach,
    )
    levels = _levels("hexaglide", name)
    count, numbers = (11, range(4)) if name == "full" else (12, range(5))
    rings = {f"t{k + 1}": _glide_ring(k, stem, count) for k in numbers}
    first = _spread(rng, 0, rings, "t3", levels, True, again=2)
    if name == "poor":
        return (tracker,), [first]
    circles = {f"b{k + 1}": _glide_bar(k, 20) for k in range(5)}
    return (tracker, cup), [
        first,
        _spread(rng, 1, circles, "b3", levels, True, again=3),
    ]


_MADE: dict[str, Callable[[Generator, str], Made]] = {
    "a3": _a3,
    "planar": _planar,
    "delta": _delta,
    "hexapod": _hexapod,
    "hexaglide": _hexaglide,
}
PLANS = {
    "a3": ("full", "single", "poor"),
    **dict.fromkeys(("planar", "delta", "hexapod", "hexaglide"), ("full", "poor")),
}
TEMPERATURES = ("temp_leg_C", "temp_frame_C", "temp_bar_C")


def draw(rng: Generator, machine: str, name: str) -> Plan:
    """A plan of a machine; `name` is one of PLANS[machine]."""
    setups, blocks = _MADE[machine](rng, name)
    return _lay_out(
        rng, MACHINES[machine], name, setups, blocks, _columns(rng, setups, name)
    )


def _columns(rng: Generator, setups: tuple[Setup, ...], name: str) -> tuple[str, ...]:
    """Covariates in the file: all in a good plan, temperatures in some; a poor plan
    lacks one to three.
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


def _lay_out(
    rng: Generator,
    machine: Machine,
    name: str,
    setups: tuple[Setup, ...],
    blocks: Sequence[Sequence[Run]],
    columns: tuple[str, ...],
) -> Plan:
    rows: dict[str, list[Array]] = {}
    runs: list[Index] = []
    closed, paths, pauses = [], [], []
    seen: dict[tuple[object, ...], int] = {}
    total = sum(len(b) for b in blocks)
    clock, at = 600.0 * rng.uniform(0.5, 2.0), 0
    gap = rng.uniform(6.2, 7.6) * 3600.0 / total
    for k, block in enumerate(blocks):
        if k:
            pauses.append(
                (clock, clock + rng.uniform(1500.0, 3600.0))
            )  # another set-up is mounted
            clock = pauses[-1][1]
        teach = setups[k].instrument.reference == "teach"
        if teach:
            _append(
                rows,
                setup=k,
                run=-1,
                kind=TEACH,
                ref=at,
                order=0,
                time=clock - 120.0,
                command=[setups[k].teach],
            )
            taught, at = at, at + 1
        lunch = int(rng.integers(len(block) // 3, 2 * len(block) // 3 + 1))
        for j, run in enumerate(block):
            if j == lunch and rng.random() < 0.7:
                pauses.append((clock, clock + rng.uniform(1200.0, 3000.0)))
                clock = pauses[-1][1]
            key = (k, run.path, run.direction, run.feed, run.payload)
            seen[key] = seen.get(key, 0) + 1
            here = at + np.arange(len(run.command))
            by_run = setups[k].instrument.reference == "run"
            ref = (
                np.full(len(here), at)
                if by_run
                else np.full(len(here), taught)
                if teach
                else here
            )
            kind = np.full(len(here), READ)
            kind[0] = REFERENCE if by_run else READ
            seconds = clock + _travel(machine, setups[k].tool, run)
            _append(
                rows, setup=k, run=len(runs), kind=kind, ref=ref, order=1 + np.arange(len(here)), time=seconds,
                command=run.command, direction=run.direction, feed=run.feed, payload=run.payload,
                repeat=seen[key], phase=run.phase,
            )  # fmt: skip
            runs.append(here)
            closed.append(run.closed)
            paths.append(run.path)
            at += len(here)
            clock = seconds[-1] + gap * rng.uniform(0.6, 1.2)
    whole: dict[str, Any] = {key: np.concatenate(parts) for key, parts in rows.items()}
    return Plan(
        machine=machine, name=name, setups=setups, runs=tuple(runs), closed=tuple(closed), paths=tuple(paths),
        pauses=tuple(pauses), columns=columns, **whole,
    )  # fmt: skip


def _travel(machine: Machine, tool: float, run: Run) -> Array:
    """Seconds (m,) since the run's first row, at its feed."""
    length = np.full(len(run.command), tool)
    pose = machine.inverse(run.command, length)
    steps = np.linalg.norm(
        np.diff(tip(machine, pose.x, pose.R0, length), axis=0), axis=1
    )
    return np.concatenate([[0.0], np.cumsum(steps)]) / run.feed


_WHOLE = ("setup", "run", "kind", "ref", "order", "repeat")
_DEFAULT = {"direction": 0.0, "feed": 0.0, "payload": 0.0, "repeat": 0, "phase": 0.0}


def _append(rows: dict[str, list[Array]], **values: object) -> None:
    """Rows for a run; scalars are repeated."""
    command = np.atleast_2d(np.asarray(values.pop("command"), dtype=float))
    rows.setdefault("command", []).append(command)
    for key, value in {**_DEFAULT, **values}.items():
        dtype = int if key in _WHOLE else float
        rows.setdefault(key, []).append(
            np.broadcast_to(np.asarray(value, dtype=dtype), len(command)).copy()
        )
