"""Runs of a plan: passes along paths, with direction, feed and payload balanced."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.blind.generator.machine import Array

Index = NDArray[np.int_]
MM_MIN = 1e-3 / 60.0

#: commands (m, dof) along a path in its order, and their phases (m,)
Path = tuple[Array, Array]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Run:
    """One pass along a path.

    setup        number of the set-up
    path         name of the path
    command      (m, dof) in the order of travel
    phase        (m,) rad along a circle, or -1..1 along a line
    closed       whether the path is a closed circle
    direction    +1 or -1
    feed         m/s
    payload      N
    """

    setup: int
    path: str
    command: Array
    phase: Array
    closed: bool
    direction: int
    feed: float
    payload: float


def _pass(
    setup: int,
    path: str,
    route: Path,
    way: int,
    feed: float,
    load: float,
    closed: bool,
) -> Run:
    command, phase = route
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
    runs = []
    for k, (name, route) in enumerate(paths.items()):
        for j, way in enumerate((1, -1)):
            a, b = (k + j + int(rng.integers(2))) % 2, (k // 2 + j) % 2
            feed, load = levels.feed[a], levels.load[b]
            runs.append(_pass(setup, name, route, way, feed, load, closed))
            if twice:
                feed, load = levels.feed[1 - a], levels.load[1 - b]
                runs.append(_pass(setup, name, route, way, feed, load, closed))
    route = paths[reference]
    others = [(-1, 0, 0), (1, 1, 0), (1, 0, 1), (-1, 1, 1)]
    for way, a, b in others[: max(0, min(4, again))]:
        feed, load = levels.feed[a], levels.load[b]
        runs.append(_pass(setup, reference, route, way, feed, load, closed))
    rng.shuffle(runs)
    feed, load = levels.feed[0], levels.load[0]
    base = _pass(setup, reference, route, 1, feed, load, closed)
    for place in np.linspace(0, len(runs), again).astype(int)[::-1]:
        runs.insert(int(place), base)
    return runs


#: feeds (mm/min) and payloads (N) of the machines, lower first
FEEDS = {
    "a3": (600, 2400),
    "planar": (2000, 8000),
    "delta": (1500, 6000),
    "hexapod": (600, 2400),
    "hexaglide": (1000, 4000),
}
LOADS = {
    "a3": (0, 300),
    "planar": (0, 500),
    "delta": (0, 5),
    "hexapod": (0, 200),
    "hexaglide": (0, 150),
}


def levels(machine: str, name: str) -> Levels:
    """Feeds and payloads of a machine's plan; a poor plan has one of each."""
    feed, load = FEEDS[machine], LOADS[machine]
    if name == "poor":
        middle = np.sqrt(feed[0] * feed[1]) * MM_MIN
        return Levels((middle, middle), (0.0, 0.0))
    return Levels(
        (feed[0] * MM_MIN, feed[1] * MM_MIN), (float(load[0]), float(load[1]))
    )
