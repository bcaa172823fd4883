"""Random plans: runs of poses, and what is written down beside the readings."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from oed.mechanism.kinematics import AssemblyError
from oed.model.machine import Coordinate, Machine

Array = np.ndarray
RUNS, READINGS = (2, 12), (10, 72)
#: part of the workspace's half width that paths keep to
INSIDE = 0.9
#: tries to lay a path within reach, each smaller than the one before
TRIES = 12


@dataclasses.dataclass(frozen=True)
class Plan:
    """How a session goes.

    runs        number of paths
    readings    of each pass of a path
    both        whether each path is run in both directions
    columns     covariates that are written down
    feeds       mm/min, in turn from path to path
    payloads    N, in turn
    pause       s between passes
    step        s between readings
    regular     whether the clock is regular
    """

    runs: int
    readings: int
    both: bool
    columns: frozenset[str]
    feeds: Sequence[float]
    payloads: Sequence[float]
    pause: float
    step: float
    regular: bool

    @property
    def words(self) -> str:
        """The plan's kind, for the table."""
        ways = "both ways" if self.both else "one way"
        return f"{ways}, {'time' if 'time' in self.columns else 'no time'}"


def draw(size: float, most: int, rng: np.random.Generator) -> Plan:
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
    return Plan(
        runs=runs,
        readings=readings,
        both=both,
        columns=frozenset(columns),
        feeds=feeds,
        payloads=payloads,
        pause=float(pause),
        step=round(step, 1),
        regular=regular,
    )


def full(size: float) -> Plan:
    """Six paths both ways in two hours, with all that can be written down."""
    return Plan(
        runs=6,
        readings=15,
        both=True,
        columns=frozenset(("time", "direction", "feed", "payload")),
        feeds=[2e3 * size, 5e3 * size],
        payloads=[0.0, 50.0],
        pause=400.0,
        step=10.0,
        regular=True,
    )


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
