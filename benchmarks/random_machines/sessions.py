"""Random sessions in plain NumPy: noise, plans, and what instruments read.

Noise comes as unit errors of chains of readings. A chain is one source of error (a
channel) along one run. All laws state their standard deviation, but for the offsets of
runs, which no study states:

white       independent normal errors
along       half to nine tenths of the variance is carried along the run, exponentially
            over 3 to 12 readings
offsets     white, and each chain off by a normal error of 0.5 to 3
tails       independent Student t errors of 4 degrees of freedom

An instrument reads a tool that stands somewhere. It draws its own place and unknowns
within stated tolerances.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.harness.noise import autoregression
from benchmarks.random_machines.machines import parameter_errors, rotations
from oed.mechanism import AssemblyError
from oed.model import Coordinate, Machine

Array = np.ndarray
LAWS = ("white", "along", "offsets", "tails")


@dataclasses.dataclass(frozen=True)
class Law:
    """A law with its numbers: share and reach of what is carried, offsets of runs."""

    name: str
    share: float
    reach: float
    offset: float

    def chain(self, count: int, rng: np.random.Generator) -> Array:
        """Errors (count,) of one chain."""
        normal = rng.standard_normal(count)
        if self.name == "white":
            return normal
        if self.name == "tails":
            return np.asarray(rng.standard_t(4.0, count) / math.sqrt(2.0))
        if self.name == "offsets":
            return np.asarray(normal + self.offset * rng.standard_normal())
        decay = math.exp(-1.0 / self.reach)
        correlated = autoregression(rng.standard_normal(count), decay)
        slow, fast = math.sqrt(self.share), math.sqrt(1.0 - self.share)
        return np.asarray(slow * correlated + fast * normal)


def draw_law(name: str, rng: np.random.Generator) -> Law:
    """A law of LAWS with random numbers."""
    share, reach, offset = rng.uniform((0.5, 3.0, 0.5), (0.9, 12.0, 3.0))
    return Law(name, float(share), float(reach), float(offset))


# -- plans ---------------------------------------------------------------------------------

RUNS, READINGS = (2, 12), (10, 72)
INSIDE = 0.9  #: part of the workspace's half width that paths keep to
TRIES = 12  #: tries to lay a path within reach, each smaller than the one before


@dataclasses.dataclass(frozen=True)
class Plan:
    """How a session goes."""

    runs: int  #: number of paths
    readings: int  #: of each pass of a path
    both: bool  #: whether each path is run in both directions
    columns: frozenset[str]  #: covariates that are written down
    feeds: Sequence[float]  #: mm/min, in turn from path to path
    payloads: Sequence[float]  #: N, in turn
    pause: float  #: s between passes
    step: float  #: s between readings
    regular: bool  #: whether the clock is regular


def draw_plan(size: float, most: int, rng: np.random.Generator) -> Plan:
    """A random plan of at most so many readings, or of the fewest there are."""
    both = bool(rng.random() < 0.5)
    passes = 2 if both else 1
    runs = int(rng.integers(RUNS[0], RUNS[1] + 1))
    runs = max(1 if both else 2, runs // passes)
    readings = int(np.exp(rng.uniform(*np.log(READINGS))))
    fewest = max(READINGS[0], most // (runs * passes))
    readings = max(READINGS[0], min(readings, fewest))
    optional = ("time", "direction", "feed", "payload", "temperature")
    shares = (0.65, 0.9 if both else 0.3, 0.5, 0.4, 0.15)
    columns = {n for n, p in zip(optional, shares, strict=True) if rng.random() < p}
    first_feed = 1e3 * size * math.exp(rng.uniform(*np.log((0.5, 10.0))))
    feeds = [first_feed] if rng.random() < 0.5 else [first_feed, 2.5 * first_feed]
    load = math.exp(rng.uniform(*np.log((5.0, 500.0))))
    payloads = [load] if rng.random() < 0.3 else [0.0, load]
    step, pause = math.exp(rng.uniform(*np.log((1.0, 30.0)))), rng.uniform(0.0, 1200.0)
    regular = bool(rng.random() < 0.5)
    shown, wait = frozenset(columns), float(pause)
    loads = (feeds, payloads)
    return Plan(runs, readings, both, shown, *loads, wait, round(step, 1), regular)


# -- paths -----------------------------------------------------------------------------
def path(
    machine: Machine,
    count: int,
    reachable: Callable[[Array], Array],
    rng: np.random.Generator,
    kind: str = "",
) -> Array:
    """Commands (count, n_dof) of a random path within the workspace.

    kind         loop, line or scatter; a random one by default
    reachable    joints of commands; raises AssemblyError

    Raises AssemblyError where even a short path is out of reach.
    """
    kind = kind or str(rng.choice(["loop", "loop", "line", "scatter"]))
    low, high = (
        np.array([getattr(c, end) for c in machine.workspace()])
        for end in ("lower", "upper")
    )
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    share = rng.uniform(0.4, 1.0)
    for attempt in range(TRIES):
        unit = _unit_path(kind, count, len(low), rng)
        commands = middle + half * INSIDE * share * 0.85**attempt * unit
        if within_reach(machine, commands, reachable):
            return commands
    raise AssemblyError("no path is within reach", np.array([0]))


def _unit_path(kind: str, count: int, width: int, rng: np.random.Generator) -> Array:
    """A path (count, width) in a box from -1 to 1."""
    if kind == "scatter":
        return rng.uniform(-1.0, 1.0, (count, width))
    angle = 2.0 * np.pi * np.arange(count) / count + rng.uniform(0.0, 2.0 * np.pi)
    if kind == "line":
        along = np.linspace(-1.0, 1.0, count)[:, None]
        offset = rng.uniform(-0.4, 0.4, width)
        return np.clip(offset + 0.6 * along * rng.uniform(-1.0, 1.0, width), -1.0, 1.0)
    first, second = rng.uniform(-0.6, 0.6, (2, width))
    offset = rng.uniform(-0.3, 0.3, width)
    loop = np.outer(np.cos(angle), first) + np.outer(np.sin(angle), second)
    return np.clip(offset + loop, -1.0, 1.0)


def within_reach(
    machine: Machine, commands: Array, reachable: Callable[[Array], Array]
) -> bool:
    try:
        joints = reachable(commands)
    except AssemblyError:
        return False
    return _inside(joints, machine.joints) and _inside(commands, machine.workspace())


def _inside(values: Array, coordinates: Sequence[Coordinate]) -> bool:
    low = np.array([c.lower for c in coordinates])
    high = np.array([c.upper for c in coordinates])
    return bool(((values > low) & (values < high)).all())


def circles(count: int, length: float, cup: Array, rng: np.random.Generator) -> Array:
    """Tool points (count, 3) of a ball bar's circle about a cup (3,)."""
    rise = rng.uniform(0.2, 1.2)
    normal = np.array([0.3 * rng.standard_normal(), 0.3 * rng.standard_normal(), 1.0])
    normal /= np.linalg.norm(normal)
    first = np.cross(normal, [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    angle = 2.0 * np.pi * np.arange(count) / count + rng.uniform(0.0, 2.0 * np.pi)
    across = np.outer(np.cos(angle), first) + np.outer(np.sin(angle), second)
    return cup + length * (np.sin(rise) * normal + np.cos(rise) * across)


# -- what is written down --------------------------------------------------------------
def clock(plan: Plan, passes: int, readings: int, rng: np.random.Generator) -> Array:
    """Times (passes, readings), s."""
    times, now = np.empty((passes, readings)), rng.uniform(0.0, 100.0)
    for k in range(passes):
        steps = np.full(readings, plan.step)
        if not plan.regular:
            steps *= rng.uniform(0.7, 1.5, readings)
            now += rng.uniform(0.0, plan.pause)
        times[k] = now + np.cumsum(steps)
        now = times[k, -1] + plan.pause
    return np.round(times, 1)


def temperatures(times: Array, rng: np.random.Generator) -> Array:
    """A shop's slow temperature at each reading, deg C."""
    span = max(float(np.ptp(times)), 1.0)
    swing = rng.uniform(0.2, 3.0)
    phase = rng.uniform(0.0, 2.0 * np.pi)
    slow = swing * np.sin(2.0 * np.pi * 0.7 * times / span + phase)
    return np.asarray(
        np.round(20.0 + slow + 0.05 * rng.standard_normal(times.shape), 2)
    )


def covariates(
    plan: Plan, number: int, forward: bool, times: Array, warm: Array
) -> dict[str, Any]:
    """Columns of one pass of a path: numbers, or one a reading."""
    every = {
        "time": ("time_s", times),
        "direction": ("direction", 1 if forward else -1),
        "feed": ("feed_mm_min", plan.feeds[number % len(plan.feeds)]),
        "payload": ("payload_N", plan.payloads[number % len(plan.payloads)]),
        "temperature": ("temp_leg_C", warm),
    }
    return {name: v for key, (name, v) in every.items() if key in plan.columns}


# -- instruments ---------------------------------------------------------------------------
#: channel values (n, channels) from points (n, 3), rotations (n, 3, 3) and unit errors
Read = Callable[[Array, Array, Array], Array]
XYZ = ("x", "y", "z")


@dataclasses.dataclass(frozen=True)
class Mounted:
    """An instrument as mounted."""

    table: Mapping[str, Any]  #: `[[setup]]` of its study
    noise: Mapping[str, float]  #: its entries of `[noise]`
    channels: Sequence[str]  #: columns of the readings
    sources: int  #: number of independent errors of a reading
    read: Read  #: channel values in the columns' units
    #: whether a run's first pose is its reference, which the others refer to
    reference: bool = False


@dataclasses.dataclass(frozen=True)
class Bench:
    """Where instruments are put up: centre (3,) of the workspace, sizes, SI."""

    centre: Array
    size: float
    sigma: float
    rng: np.random.Generator

    def unknowns(self, *tolerances: float) -> Array:
        """Errors within tolerances."""
        return parameter_errors(np.array(tolerances), self.rng)

    def registered(
        self,
        shift: float,
        turn: float,
        axes: Sequence[int] = (0, 1, 2),
        turns: str = "xyz",
    ) -> tuple[dict[str, float], Array, Array]:
        """A frame of an instrument's own: tolerances (m, rad), offset (3,), rotation (3, 3)."""
        tolerance = {f"shift_{XYZ[k]}_mm": 1e3 * shift for k in axes}
        tolerance |= {f"turn_{k}_mrad": 1e3 * turn for k in turns}
        offset, angles = np.zeros((2, 3))
        offset[list(axes)] = self.unknowns(*[shift] * len(axes))
        angles[3 - len(turns) :] = self.unknowns(*[turn] * len(turns))
        return tolerance, offset, rotations(angles[None])[0]


def _lengths(bench: Bench, names: Sequence[str]) -> dict[str, float]:
    return {f"{name}_um": 1e6 * bench.sigma for name in names}


def _of_lengths(
    bench: Bench,
    table: Mapping[str, Any],
    channels: Sequence[str],
    exact: Callable[[Array], Array],
    reference: bool = False,
) -> Mounted:
    """An instrument that reads lengths (n, channels), exact ones of points (n, 3)."""

    def read(point: Array, rotation: Array, errors: Array) -> Array:
        return 1e3 * (exact(point) + bench.sigma * errors)

    columns, count = [f"{name}_mm" for name in channels], len(channels)
    return Mounted(table, _lengths(bench, channels), columns, count, read, reference)


def ball_bar(bench: Bench, name: str, length: float, cup: Array) -> Mounted:
    """A ball bar whose cup was set by hand near a stated place (3,)."""
    tolerance = min(1e-3, 2e-3 * bench.size)
    table = {"name": name, "instrument": "ball_bar_free_cup", "length_mm": 1e3 * length}
    table |= {f"at_{k}_mm": 1e3 * float(v) for k, v in zip(XYZ, cup, strict=True)}
    table["tolerance"] = {f"cup_{k}_mm": 1e3 * tolerance for k in XYZ}
    true_cup = cup + bench.unknowns(*[tolerance] * 3)

    def exact(point: Array) -> Array:
        return np.linalg.norm(point - true_cup, axis=1)[:, None]

    return _of_lengths(bench, table, ["length"], exact)


def position(bench: Bench, name: str, kind: str) -> Mounted:
    """A camera or tracker that reads positions in a frame of its own."""
    shift = {"camera": 5e-3, "pose_tracker_position": 0.05e-3}.get(kind, 5e-3)
    planar = kind == "planar_position"
    axes, turns = ((0, 1), "z") if planar else ((0, 1, 2), "xyz")
    shift = min(shift, 5e-3 * bench.size)
    tolerance, offset, frame = bench.registered(shift, 1e-3, axes, turns)
    table = {"name": name, "instrument": kind, "tolerance": tolerance}
    names = [f"read_{XYZ[k]}" for k in axes]

    def exact(point: Array) -> Array:
        return (point @ frame.T + offset)[:, list(axes)]

    return _of_lengths(bench, table, names, exact)


def pose_tracker(bench: Bench, name: str) -> Mounted:
    """A tracker of position and orientation."""
    tolerance, offset, frame = bench.registered(0.05e-3, 0.05e-3)
    table = {"name": name, "instrument": "pose_tracker", "tolerance": tolerance}
    angle_sigma = bench.sigma / bench.size
    angles = ("alpha", "beta", "gamma")
    noise = _lengths(bench, [f"read_{k}" for k in XYZ])
    noise |= {f"read_{a}_urad": 1e6 * angle_sigma for a in angles}

    def read(point: Array, rotation: Array, errors: Array) -> Array:
        seen = point @ frame.T + offset + bench.sigma * errors[:, :3]
        turned = frame @ rotation
        flat = np.hypot(turned[:, 1, 2], turned[:, 2, 2])
        alpha = np.arctan2(-turned[:, 1, 2], turned[:, 2, 2])
        beta = np.arctan2(turned[:, 0, 2], flat)
        gamma = np.arctan2(-turned[:, 0, 1], turned[:, 0, 0])
        three = np.column_stack([alpha, beta, gamma]) + angle_sigma * errors[:, 3:]
        return np.hstack([1e3 * seen, np.rad2deg(three)])

    columns = [f"read_{k}_mm" for k in XYZ] + [f"read_{a}_deg" for a in angles]
    return Mounted(table, noise, columns, 6, read)


def laser_ball_bar(bench: Bench, name: str) -> Mounted:
    """A laser ball bar on a gimbal beside the workspace: range and two angles."""
    away = bench.centre + bench.size * np.array([0.6, -1.1, -0.5])
    tolerance, offset, frame = bench.registered(0.1e-3, 0.1e-3)
    angle_sigma = bench.sigma / bench.size
    table: dict[str, Any] = {"name": name, "instrument": "laser_ball_bar_position"}
    table |= {f"at_{k}_mm": 1e3 * float(v) for k, v in zip(XYZ, away, strict=True)}
    table["range_noise_um"] = 1e6 * bench.sigma
    table["angle_noise_urad"] = 1e6 * angle_sigma
    table["tolerance"] = tolerance

    def read(point: Array, rotation: Array, errors: Array) -> Array:
        d = (point - away) @ frame.T + offset
        reach = np.linalg.norm(d, axis=1) + bench.sigma * errors[:, 0]
        up = np.arcsin(d[:, 2] / np.linalg.norm(d, axis=1)) + angle_sigma * errors[:, 1]
        # the error about z is one of the way round, which is shorter higher up
        around = np.arctan2(d[:, 1], d[:, 0]) + angle_sigma * errors[:, 2]
        flat = reach * np.cos(up)
        seen = [flat * np.cos(around), flat * np.sin(around), reach * np.sin(up)]
        return 1e3 * (np.column_stack(seen) + away)

    columns = [f"read_{k}_mm" for k in XYZ]
    return Mounted(table, {}, columns, 3, read)


def height(bench: Bench, name: str) -> Mounted:
    """A length gauge against a table that is nearly level."""
    offset_sd, tilt_sd = min(1e-3, 2e-3 * bench.size), 0.1e-3
    table = {"name": name, "instrument": "length_gauge", "at_z_mm": 0.0}
    table["tolerance"] = {
        "height_mm": 1e3 * offset_sd,
        "tilt_x_mrad": 1e3 * tilt_sd,
        "tilt_y_mrad": 1e3 * tilt_sd,
    }
    offset, tilt_x, tilt_y = bench.unknowns(offset_sd, tilt_sd, tilt_sd)

    def exact(point: Array) -> Array:
        plane = offset + tilt_x * point[:, 1] - tilt_y * point[:, 0]
        return (point[:, 2] - plane)[:, None]

    return _of_lengths(bench, table, ["height"], exact)


def calliper(bench: Bench, name: str) -> Mounted:
    """A calliper: distances from a run's first pose on an object of unknown scale."""
    table: dict[str, Any] = {"name": name, "instrument": "calliper"}
    table["tolerance"] = {"scale_ppm": 100.0}
    scale = float(bench.unknowns(100e-6)[0])

    def exact(point: Array) -> Array:
        distance = np.linalg.norm(point - point[:1], axis=1) * (1.0 + scale)
        return distance[:, None]

    return _of_lengths(bench, table, ["length"], exact, reference=True)


def relative(bench: Bench, name: str, kind: str) -> Mounted:
    """Displacements from a line's first pose, of the planar machine (rm1 to rm5)."""
    axes = {"rm1": (1,), "rm2": (2,), "rm3": (2,), "rm4": (1,), "rm5": (1, 2)}[kind]
    table = {"name": name, "instrument": kind}
    names = [f"d{XYZ[k]}" for k in axes]

    def read(point: Array, rotation: Array, errors: Array) -> Array:
        moved = (point - point[:1])[:, list(axes)]
        return 1e3 * (moved + bench.sigma * (errors - errors[:1]))

    columns = [f"{n}_mm" for n in names]
    return Mounted(table, _lengths(bench, names), columns, len(axes), read, True)


#: instruments that need nothing but a bench and a name
OTHERS: dict[str, Callable[[Bench, str], Mounted]] = {
    "pose_tracker": pose_tracker,
    "laser_ball_bar": laser_ball_bar,
    "height": height,
    "calliper": calliper,
}
