"""The configurations by name."""

from __future__ import annotations

import functools
from collections.abc import Callable

from benchmarks.coverage import a3, delta, hexapod, planar
from benchmarks.coverage.bench import Bench

CONFIGURATIONS: dict[str, Callable[[], Bench]] = {
    "a3_30": a3.thirty,
    "a3_60": a3.sixty,
    "a3_circles": a3.four_circles,
    "planar": planar.planar,
    "delta": delta.delta,
    "hexapod": hexapod.hexapod,
}


@functools.cache
def configuration(name: str) -> Bench:
    """A configuration, compiled once."""
    return CONFIGURATIONS[name]()
