"""The configurations by name."""

from __future__ import annotations

import functools
from collections.abc import Callable

from benchmarks.coverage import a3, delta, hexapod, planar
from benchmarks.coverage.bench import Bench
from oed.noise import NoiseStatement

#: that the cup stays where it is: no law of the noise seats it anew
STAYS, ABOUT = NoiseStatement(seating=0.0), "the study states `seating_um = 0`"


def stating_the_seat(plan: Callable[[], Bench]) -> Callable[[], Bench]:
    """A configuration whose study states that the cup stays where it is."""
    return lambda: plan().stating(STAYS, ABOUT)


CONFIGURATIONS: dict[str, Callable[[], Bench]] = {
    "a3_30": a3.thirty,
    "a3_30_stated": stating_the_seat(a3.thirty),
    "a3_60": a3.sixty,
    "a3_60_stated": stating_the_seat(a3.sixty),
    "a3_circles": a3.four_circles,
    "planar": planar.planar,
    "delta": delta.delta,
    "hexapod": hexapod.hexapod,
}


@functools.cache
def configuration(name: str) -> Bench:
    """A configuration, compiled once."""
    return CONFIGURATIONS[name]()
