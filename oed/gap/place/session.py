"""Windows of the session: what a fault from one time to another does to the readings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from oed.arrays import Array
from oed.gap.data.problem import GapProblem
from oed.gap.place.regions import Region, channel_offsets, joint_change

#: cells of the session that windows are made of
CELLS = 16


def clock(problem: GapProblem) -> Array:
    """Time (N,) of each reading, s; NaN where unknown."""
    if "time" not in problem.rows.columns:
        return np.full(len(problem), np.nan)
    return np.asarray(problem.rows["time"].to_numpy(dtype=float))


def cell_starts(problem: GapProblem) -> Array:
    """Times at which the cells of the session start, s; empty without times.

    Each cell has about as many readings as another.
    """
    times = clock(problem)
    times = np.sort(times[np.isfinite(times)])
    if not len(times):
        return times
    first = np.arange(CELLS) * len(times) // CELLS
    return np.unique(times[first])


def time_windows(problem: GapProblem) -> Iterator[Region]:
    """Shifts of the reading, of the legs, or of the tool along its axis, for a while.

    The start of the session is the reference: a shift until t is indistinguishable from
    one back from t on.
    """
    starts, times = cell_starts(problem), clock(problem)
    stops = np.append(starts[1:], np.inf)
    for a in range(1, len(starts)):
        for b in range(a, len(starts)):
            inside = times[(times >= starts[a]) & (times < stops[b])]
            first, last = float(inside.min()), float(inside.max())
            yield from window(problem, first, last, frozenset(range(a, b + 1)))


def window(
    problem: GapProblem,
    first: float,
    last: float,
    cells: frozenset[int],
) -> Iterator[Region]:
    """Regions of the readings taken from `first` to `last`, s."""
    limbs = [f"leg {limb + 1}" for limb in problem.states[0].limbs]
    place = time_span(clock(problem), first, last)
    for form in ("reading", "legs", *limbs, "tool"):
        basis = window_basis(problem, first, last, form)
        yield Region("time", place, basis, cells, form)


def window_basis(problem: GapProblem, first: float, last: float, form: str) -> Array:
    """Basis (N, k) of one form of the readings taken from `first` to `last`, s."""
    if form == "reading":
        times = clock(problem)
        inside = (times >= first) & (times <= last)
        return np.asarray(inside[:, None] * channel_offsets(problem))
    shifts = [_within(s.time, first, last) for s in problem.states]
    if form == "tool":
        return tool_growth(problem, shifts)
    changes = [
        joint_change(problem, limb, shifts)
        for limb in problem.states[0].limbs
        if form in ("legs", f"leg {limb + 1}")
    ]
    return np.hstack(changes)


def _within(times: Array, first: float, last: float) -> Array:
    """One (m, 1) for times from `first` to `last`, else zero."""
    return ((times >= first) & (times <= last)).astype(float)[:, None]


def tool_growth(problem: GapProblem, shares: Sequence[Array]) -> Array:
    """Readings (N, k), in units of the noise, where the tool grows along its axis.

    It is longer by shares (m, k) of a unit at the poses of each series.
    """
    growth = [s.joints_per_extension for s in problem.states]
    parts = []
    for limb in problem.states[0].limbs:
        pairs = zip(shares, growth, strict=True)
        change = [share * by_limb[:, limb, None] for share, by_limb in pairs]
        parts.append(joint_change(problem, limb, change))
    return np.asarray(np.sum(parts, axis=0))


def time_span(times: Array, first: float, last: float) -> str:
    """Name of a window of the session by its first and last reading's time, s.

    It begins and ends somewhere between these and the readings next to them, most
    likely halfway.
    """
    before, after = times[times < first], times[times > last]
    begin, end = first, last
    if before.size:
        begin = 0.5 * (first + float(before.max()))
    if after.size:
        end = 0.5 * (last + float(after.min()))
    return f"time {_number(begin)}-{_number(end)}"


def _number(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")
