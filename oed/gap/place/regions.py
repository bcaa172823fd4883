"""Looks at a gap: for every place that it may be confined to, what a fault there could
do to the readings.

A leg as a function of its travel, sense, force, time, another's motion, or with a
period along it; an offset or a wave in a run; a shift in a window of the session; a
bump in a window of the phase; all readings of one direction; what was selected before.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from oed.arrays import Array
from oed.gap.data.problem import GapProblem

#: all legs alike, among the blocks
ALL = "all legs"
#: change of a joint that legs' columns stand for, m (or rad): only its ratio among the
#: columns counts
UNIT = 1e-6
#: half-periods of the waves along a leg's travel; periods of the fine ones
SMOOTH = range(6)
FINE = np.arange(2.5, 40.5, 0.5)
#: cells of the session and of the phase that windows are made of; the longest window of
#: the phase, in cells
CELLS, SECTORS, WIDEST = 16, 12, 6
#: readings that a run must have for its waves and its phase to mean something
WAVES = 8
#: form of a look with what was selected; change of a reading against the largest that
#: is none
SELECTED, NOTHING = "selected", 1e-6
#: columns up to which what was selected is looked for in each run
FEW = 8


@dataclasses.dataclass(frozen=True, slots=True)
class Look:
    """One basis (N, k), in units of the noise, for a fault at a place; `cells` of its
    kind that the place holds; `form` tells looks at one place apart. Looks that are
    `own` ask where a known effect acts: a question of its own.
    """

    kind: str
    place: str
    basis: Array
    cells: frozenset[int] = frozenset()
    form: str = ""
    own: bool = False


def looks(
    problem: GapProblem,
    columns: Array | None = None,
    labels: Sequence[str] | None = None,
    known: bool = False,
) -> Iterator[Look]:
    """The whole family."""
    own = bool(known and labels and all(labels))
    if not own:
        yield from _legs(problem)
    yield from (
        dataclasses.replace(look, own=own)
        for look in _selected(problem, columns, labels)
    )
    for family in (_runs, _times, _phases, _directions):
        yield from family(problem)


# -- legs ---


def _joint(problem: GapProblem, limb: int, change: Sequence[Array]) -> Array:
    """Readings (N, k), in units of the noise, per unit of k changes (m, k) of a joint
    at the poses of each series.
    """
    parts = []
    for series, response, values in zip(
        problem.series, problem.responses, change, strict=True
    ):
        total = np.zeros((*response.nuisances.shape[:2], values.shape[1]))
        for slope, place in zip(response.joints, series.index.T, strict=True):
            total += slope[:, :, limb, None] * values[place, None, :]
        parts.append(total.reshape(-1, values.shape[1]))
    return problem.in_noise_units(UNIT * np.concatenate(parts))


def _legs(problem: GapProblem) -> Iterator[Look]:
    """Each leg by itself, and the same change in all of them."""
    each = [list(_leg(problem, limb)) for limb in problem.states[0].limbs]
    for limb, bases in enumerate(each):
        yield from (Look("leg", f"leg {limb + 1}", basis) for basis in bases)
    if len(each) > 1:
        yield from (
            Look("leg", ALL, np.sum(bases, axis=0)) for bases in zip(*each, strict=True)
        )


def _leg(problem: GapProblem, limb: int) -> Iterator[Array]:
    """Bases of one leg: smooth in what it may depend on, each alone and all together;
    with another's motion; periodic; shifted from a time.
    """
    forms = [_forms(problem, k, limb) for k in range(len(problem.states))]
    smooth = [_joint(problem, limb, [f[name] for f in forms]) for name in forms[0]]
    yield from smooth
    yield np.hstack(smooth)
    for step in range(1, len(problem.states[0].limbs)):
        yield _joint(
            problem, limb, [_others(problem, k, limb, step) for k in range(len(forms))]
        )
    turns = [
        2.0 * np.pi * _travel(problem, k, limb)[:, None] * FINE
        for k in range(len(forms))
    ]
    sine, cosine = (
        _joint(problem, limb, [wave(t) for t in turns]) for wave in (np.sin, np.cos)
    )
    yield from (np.column_stack([sine[:, k], cosine[:, k]]) for k in range(len(FINE)))
    starts = starts_of(problem)
    if len(starts) > 1:
        shifts = [
            (np.nan_to_num(s.time, nan=-np.inf)[:, None] >= starts[1:]).astype(float)
            for s in problem.states
        ]
        yield from _joint(problem, limb, shifts).T[:, :, None]


def _travel(problem: GapProblem, number: int, limb: int) -> Array:
    """Place (m,) of a leg in its travel over all series, 0 to 1."""
    every = np.concatenate([s.joints[:, limb] for s in problem.states])
    span = float(np.ptp(every))
    return np.asarray(
        (problem.states[number].joints[:, limb] - every.min())
        / (span if span > 0.0 else 1.0)
    )


def _forms(problem: GapProblem, number: int, limb: int) -> dict[str, Array]:
    """What a leg's error may be a smooth function of, (m, k) each; the same names for
    every leg and series.
    """
    state, u = problem.states[number], _travel(problem, number, limb)
    forms = {
        "travel": np.cos(np.pi * u[:, None] * np.array(SMOOTH)),
        "sense": state.sense[:, limb, None] * np.column_stack([np.ones_like(u), u]),
    }
    force = state.force[:, limb] if np.isfinite(state.force).all() else np.zeros_like(u)
    load = np.nan_to_num(state.payload)
    forms["load"] = force[:, None] * np.column_stack(
        [np.ones_like(u), u, load, load * u]
    )
    if np.isfinite(state.span).all():
        at = np.nan_to_num(
            (state.time - state.span[0]) / max(state.span[1] - state.span[0], 1e-12)
        )
        forms["time"] = np.column_stack([at, at**2, at * u])
    if all(np.isfinite(s.rate).all() for s in problem.states):
        forms["rate"] = state.rate[:, limb, None] * np.column_stack(
            [np.ones_like(u), u]
        )
    return forms


def _others(problem: GapProblem, number: int, limb: int, step: int) -> Array:
    """What a leg's error may be that comes with the motion of another, so many legs on:
    (m, 3).
    """
    state, u = problem.states[number], _travel(problem, number, limb)
    rate = np.where(np.isfinite(state.rate), state.rate, state.sense)[
        :, (limb + step) % len(state.limbs)
    ]
    return np.column_stack([rate, np.abs(rate), rate * u])


def _selected(
    problem: GapProblem, columns: Array | None, labels: Sequence[str] | None
) -> Iterator[Look]:
    """The selected effects' own columns of each leg and set-up, and in each run."""
    if columns is None or labels is None:
        return
    if columns.shape != (len(problem), len(labels)):
        raise ValueError(
            f"columns have the shape {columns.shape}; ({len(problem)}, {len(labels)})"
            " fits the labels"
        )
    for name in dict.fromkeys(labels):
        mine = columns[:, [label == name for label in labels]]
        kind = next((k for k in ("leg", "set-up") if name.startswith(f"{k} ")), "")
        if kind:
            yield Look(kind, name, mine)
        yield from _stretch(problem, mine)
        yield from _touched(problem, mine)
    if 0 < columns.shape[1] <= FEW:
        for k, (place, inside) in enumerate(_places(problem)):
            yield Look(
                "run", place, inside[:, None] * columns, frozenset({k}), SELECTED
            )


def _stretch(problem: GapProblem, columns: Array) -> Iterator[Look]:
    """The stretch of the session outside which selected columns (N, k) change nothing,
    if there is one; what changes at the session's start is told from its end on, as by
    `_times`.
    """
    starts, clock = starts_of(problem), clock_of(problem)
    size = np.abs(columns).max(axis=1, initial=0.0)
    inside = (size > NOTHING * max(float(size.max(initial=0.0)), 1e-300)) & np.isfinite(
        clock
    )
    if len(starts) < 2 or not inside.any():
        return
    first, last, end = (
        float(clock[inside].min()),
        float(clock[inside].max()),
        float(np.nanmax(clock)),
    )
    if first <= starts[0] and last >= end:
        return
    if first <= starts[0]:
        first, last = float(clock[clock > last].min()), end
    low, high = (
        int(np.searchsorted(starts, t, side="right")) - 1 for t in (first, last)
    )
    yield Look(
        "time",
        span(clock, first, last),
        columns,
        frozenset(range(low, high + 1)),
        SELECTED,
    )


def _touched(problem: GapProblem, columns: Array) -> Iterator[Look]:
    """The runs outside which selected columns (N, k) change nothing, if there are any:
    each is told by all of them.
    """
    size = np.abs(columns).max(axis=1, initial=0.0)
    changed = size > NOTHING * max(float(size.max(initial=0.0)), 1e-300)
    runs = list(_places(problem))
    inside = [k for k, (_, here) in enumerate(runs) if changed[here > 0.0].any()]
    if len(inside) < len(runs):
        yield from (
            Look("run", runs[k][0], columns, frozenset({k}), SELECTED) for k in inside
        )


# -- runs, times, phases, directions ---


def _channels(problem: GapProblem) -> Array:
    """One column (N, channels) for each kind of reading."""
    return np.asarray(problem.group[:, None] == np.unique(problem.group), dtype=float)


def _waves(problem: GapProblem) -> Array:
    """Offset and harmonics of the phase (N, k) in each kind of reading: two, or one
    where there are several kinds.
    """
    phase, kinds = problem.rows["phase"].to_numpy(dtype=float), _channels(problem)
    orders = (1, 2) if kinds.shape[1] == 1 else (1,)
    forms = [np.ones_like(phase)] + [
        wave(k * phase) for k in orders for wave in (np.cos, np.sin)
    ]
    return np.hstack([f[:, None] * kinds for f in forms])


def _runs(problem: GapProblem) -> Iterator[Look]:
    """An offset of each run; harmonics in it where it is long enough."""
    offsets, waves = _channels(problem), _waves(problem)
    for k, (place, inside) in enumerate(_places(problem)):
        for basis in (offsets, waves)[
            : 2 if inside.sum() >= WAVES * offsets.shape[1] else 1
        ]:
            yield Look("run", place, inside[:, None] * basis, frozenset({k}))


def _places(problem: GapProblem) -> Iterator[tuple[str, Array]]:
    """Name of each run, where there are several, and which readings (N,) it has."""
    if len(problem.blocks) < 2:
        return
    labels = (
        problem.rows[["setup", "run"]].iloc[[b[0] for b in problem.blocks]].astype(str)
    )
    alike = labels["run"].duplicated(keep=False).to_numpy()
    for k, (members, setup, run) in enumerate(
        zip(problem.blocks, labels["setup"], labels["run"], strict=True)
    ):
        inside = np.zeros(len(problem))
        inside[members] = 1.0
        yield f"run {setup} {run}" if alike[k] else f"run {run}", inside


def clock_of(problem: GapProblem) -> Array:
    """Time (N,) of each reading, s; NaN where unknown."""
    if "time" not in problem.rows.columns:
        return np.full(len(problem), np.nan)
    return np.asarray(problem.rows["time"].to_numpy(dtype=float))


def starts_of(problem: GapProblem) -> Array:
    """Times at which the cells of the session start, s, with about as many readings in
    each; empty without times.
    """
    times = clock_of(problem)
    times = np.sort(times[np.isfinite(times)])
    return (
        np.unique(times[np.arange(CELLS) * len(times) // CELLS])
        if len(times)
        else times
    )


def _times(problem: GapProblem) -> Iterator[Look]:
    """Shifts of the reading, of the legs, or of the tool along its axis, from one cell
    of the session to another.

    The start of the session is what they are told against: a shift until t cannot be
    told from one back from t on.
    """
    starts, clock = starts_of(problem), clock_of(problem)
    stops = np.append(starts[1:], np.inf)
    for a in range(1, len(starts)):
        for b in range(a, len(starts)):
            inside = clock[(clock >= starts[a]) & (clock < stops[b])]
            yield from window(
                problem,
                float(inside.min()),
                float(inside.max()),
                frozenset(range(a, b + 1)),
            )


def window(
    problem: GapProblem, first: float, last: float, cells: frozenset[int]
) -> Iterator[Look]:
    """Looks at the readings taken from `first` to `last`, s."""
    clock = clock_of(problem)
    place = span(clock, first, last)
    yield Look(
        "time",
        place,
        ((clock >= first) & (clock <= last))[:, None] * _channels(problem),
        cells,
        "reading",
    )
    there = [
        ((s.time >= first) & (s.time <= last)).astype(float)[:, None]
        for s in problem.states
    ]
    legs = [_joint(problem, limb, there) for limb in problem.states[0].limbs]
    yield Look("time", place, np.hstack(legs), cells, "legs")
    yield from (
        Look("time", place, leg, cells, f"leg {limb}")
        for limb, leg in enumerate(legs, start=1)
    )
    yield Look("time", place, lengthened(problem, there), cells, "tool")


def lengthened(problem: GapProblem, shares: Sequence[Array]) -> Array:
    """Readings (N, k), in units of the noise, where the tool is longer along its axis
    by shares (m, k) of a unit at the poses of each series.
    """
    limbs = problem.states[0].limbs
    ways = [s.lengthening for s in problem.states]
    each = [
        _joint(
            problem, i, [v * w[:, i, None] for v, w in zip(shares, ways, strict=True)]
        )
        for i in limbs
    ]
    return np.asarray(np.sum(each, axis=0))


def span(clock: Array, first: float, last: float) -> str:
    """A stretch of the session by its first and last reading's time, s: it begins and
    ends somewhere between these and the readings next to them, most likely halfway.
    """
    before, after = clock[clock < first], clock[clock > last]
    begin = 0.5 * (first + float(before.max())) if before.size else first
    end = 0.5 * (last + float(after.min())) if after.size else last
    return f"time {_number(begin)}-{_number(end)}"


def _number(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")


def _phases(problem: GapProblem) -> Iterator[Look]:
    """Bumps in windows of the phase: the same both ways, or with the direction's sign."""
    valid = np.zeros(len(problem), dtype=bool)
    phase = problem.rows["phase"].to_numpy(dtype=float)
    for members in problem.blocks:
        valid[members] = len(np.unique(np.round(phase[members], 9))) >= WAVES
    sector = np.minimum((phase / (2.0 * np.pi) * SECTORS).astype(int), SECTORS - 1)
    way = _way(problem)
    signs = [np.ones(len(problem))] + ([way] if way.min() < 0.0 < way.max() else [])
    for start in range(SECTORS if valid.any() else 0):
        for length in range(1, WIDEST + 1):
            cells = frozenset((start + k) % SECTORS for k in range(length))
            inside = valid & np.isin(sector, list(cells))
            ends = (
                360 * start // SECTORS,
                360 * ((start + length - 1) % SECTORS + 1) // SECTORS,
            )
            for sign in signs:
                basis = (inside * sign)[:, None] * _channels(problem)
                yield Look("phase", f"phase {ends[0]}-{ends[1]}", basis, cells)


def _way(problem: GapProblem) -> Array:
    """Direction (N,) of each reading's run, +1 or -1; 0 where unknown."""
    if "direction" not in problem.rows.columns:
        return np.zeros(len(problem))
    return np.asarray(
        np.sign(np.nan_to_num(problem.rows["direction"].to_numpy(dtype=float)))
    )


def _directions(problem: GapProblem) -> Iterator[Look]:
    """Offset and harmonics of all readings of a direction, where both were taken."""
    way = _way(problem)
    if not way.min(initial=0.0) < 0.0 < way.max(initial=0.0):
        return
    for sign in (1, -1):
        yield Look(
            "direction",
            f"direction {sign:+d}",
            (way == sign)[:, None] * _waves(problem),
            frozenset({sign}),
        )
