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
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.visits.rows import with_runs
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

    original = {n: getattr(make, n) for n in ("design", "draw", "sized", "sensors")}
    replaced = {
        "design": design,
        "draw": draw_effect,
        "sized": sized,
        "sensors": lambda *_: {},
    }
    try:
        for name, function in replaced.items():
            setattr(make, name, function)
        case, y, label = make.make_case(
            machine, kind, law, np.random.default_rng(seed), severity
        )
    finally:
        for name, function in original.items():
            setattr(make, name, function)
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
    for state, pool, amplitude, change in first.effects:
        effect = _effect(make, first, both, state, pool)
        again = both.readings(geometry + effect(amplitude)) - both.readings(geometry)
        there = again[: len(change)]
        factor = float(there @ change / max(there @ there, 1e-300))
        again = both.readings(geometry + effect(factor * amplitude)) - both.readings(
            geometry
        )
        if np.linalg.norm(again[: len(change)] - change) > ALIKE * np.linalg.norm(
            change
        ):
            raise ValueError("the draw of an effect depends on the second visit")
        total = total + effect(factor * amplitude)
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
    with _reductions({both.n: first.case.n, len(both.Q): len(first.case.Q)}):
        _, effect, _ = make.draw(frozen, rng, pool, first.case.m.name)

    def plain(size: float) -> Any:
        with _reductions({both.n: first.case.n, len(both.Q): len(first.case.Q)}):
            change = effect(size)
        return type(change)({k: np.array(v) for k, v in change.items()})

    return plain


@contextmanager
def _reductions(lengths: Mapping[int, int]) -> Iterator[None]:
    effects = importlib.import_module("effects")
    effects.np = _Numpy(lengths)
    try:
        yield
    finally:
        effects.np = np
