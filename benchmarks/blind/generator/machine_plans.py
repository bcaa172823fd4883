"""Set-ups and runs of each machine's plans."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from numpy.random import Generator

from benchmarks.blind.generator import instruments
from benchmarks.blind.generator.instruments import Setup
from benchmarks.blind.generator.paths import (
    BAR,
    GLIDE_CUP,
    SHORT_BAR,
    TEACH_Z,
    a3_circle,
    delta_circle,
    delta_row,
    glide_bar,
    glide_ring,
    hex_circle,
    line,
)
from benchmarks.blind.generator.runs import Run, spread
from benchmarks.blind.generator.runs import levels as levels_of

SetupsAndRuns = tuple[tuple[Setup, ...], list[list[Run]]]


def _a3(rng: Generator, name: str) -> SetupsAndRuns:
    cup = Setup(
        name="cup",
        instrument=instruments.BAR,
        settings={"length": BAR},
        teach=(TEACH_Z, 0.0, 0.0),
    )
    long = dataclasses.replace(
        cup, name="long_tool", tool=0.1, teach=(TEACH_Z + 0.1, 0.0, 0.0)
    )
    count = 30 if name == "poor" else 24
    heights = (
        (1.066, 1.146, 1.206, 1.266)
        if name == "poor"
        else (1.066, 1.116, 1.166, 1.216, 1.266)
    )
    levels = levels_of("a3", name)
    paths = {f"z{1e3 * z:.0f}": a3_circle(z, 0.0, count) for z in heights}
    reference = "z1206" if name == "poor" else "z1166"
    again = {"full": 4, "single": 4, "poor": 3}[name]
    first = spread(
        rng, 0, paths, reference, levels, True, again=again, twice=name == "single"
    )
    if name != "full":
        return (cup,), [first]
    paths = {
        f"z{1e3 * z + 100:.0f}": a3_circle(z + 0.1, 0.1, count)
        for z in (1.066, 1.166, 1.266)
    }
    return (cup, long), [first, spread(rng, 1, paths, "z1266", levels, True, again=3)]


def _planar(rng: Generator, name: str) -> SetupsAndRuns:
    rm5, rm4 = (
        Setup(name="rm5", instrument=instruments.RM5),
        Setup(name="rm4", instrument=instruments.RM4),
    )
    levels = levels_of("planar", name)
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
    tracker, probe = (
        Setup(name="tracker", instrument=instruments.TRACKER),
        Setup(name="probe", instrument=instruments.PROBE),
    )
    levels = levels_of("delta", name)
    rings: tuple[tuple[float, float], ...] = (
        (0.06, 0.06),
        (0.13, 0.06),
        (0.13, 0.18),
        (0.06, 0.30),
        (0.12, 0.30),
    )
    rings = rings if name == "full" else (rings[1], rings[4])
    paths = {f"r{1e3 * r:.0f}z{1e3 * z:.0f}": delta_circle(r, z, 13) for r, z in rings}
    reference = "r130z180" if name == "full" else "r130z60"
    # one way each but on the reference circle: three channels a row are many readings
    # soon
    ring = spread(
        rng, 0, paths, reference, levels, True, again=3 if name == "full" else 2
    )
    ring = [
        r for k, r in enumerate(ring) if r.path == reference or k % 3 or name == "poor"
    ]
    rows = {
        f"y{1e3 * v:.0f}": delta_row(v, 10)
        for v in (-0.11, -0.075, -0.035, 0.005, 0.04, 0.08, 0.12)
    }
    bed = spread(rng, 1, rows, "y5", levels, False, again=3 if name == "full" else 2)
    return (tracker, probe), [ring, bed]


def _hexapod(rng: Generator, name: str) -> SetupsAndRuns:
    def cup(label: str, tool: float) -> Setup:
        settings = {"length": BAR, "at_x": 0.0, "at_y": 0.0, "at_z": 0.2 + tool}
        return Setup(
            name=label, instrument=instruments.FREE_BAR, tool=tool, settings=settings
        )

    levels = levels_of("hexapod", name)
    count = 26 if name == "poor" else 20
    numbers = range(5) if name == "poor" else range(8)
    paths = {f"c{k + 1}": hex_circle(k, 0.0, count) for k in numbers}
    first = spread(rng, 0, paths, "c2", levels, True, again=2 if name == "poor" else 3)
    if name == "poor":
        return (cup("bar", 0.0),), [first]
    paths = {f"c{k + 1}": hex_circle(k, 0.1, count) for k in (1, 4, 5, 8, 9)}
    return (cup("bar", 0.0), cup("long_tool", 0.1)), [
        first,
        spread(rng, 1, paths, "c2", levels, True, again=2),
    ]


def _hexaglide(rng: Generator, name: str) -> SetupsAndRuns:
    """A tracker with its target on a stem, and a short bar about a taught cup; the poor
    plan has the tracker alone.
    """
    stem = -0.080 if name == "full" else 0.0
    tracker = Setup(name="tracker", instrument=instruments.TRACKER, tool=stem)
    teach = (0.0, 0.0, GLIDE_CUP, 0.0, 0.0, 0.0)
    cup = Setup(
        name="cup",
        instrument=instruments.BAR,
        settings={"length": SHORT_BAR},
        teach=teach,
    )
    levels = levels_of("hexaglide", name)
    count, numbers = (11, range(4)) if name == "full" else (12, range(5))
    rings = {f"t{k + 1}": glide_ring(k, stem, count) for k in numbers}
    first = spread(rng, 0, rings, "t3", levels, True, again=2)
    if name == "poor":
        return (tracker,), [first]
    circles = {f"b{k + 1}": glide_bar(k, 20) for k in range(5)}
    return (tracker, cup), [
        first,
        spread(rng, 1, circles, "b3", levels, True, again=3),
    ]


SETUPS_AND_RUNS: dict[str, Callable[[Generator, str], SetupsAndRuns]] = {
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
