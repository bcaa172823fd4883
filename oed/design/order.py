"""In which order chosen poses are read: an open path with little travel that takes no
forbidden move.

Poses, or runs that stay together (a circle), are visited once each. Lengths may differ
there and back; inf forbids a move. A run in its two directions is two states, of which
one is visited. Up to `EXACT` runs the shortest path comes from dynamic programming over
subsets (Held and Karp 1962, J. SIAM 10, 196-210). Above, a path by nearest neighbours
is improved by the best reversal of a stretch (2-opt; Croes 1958, Oper. Res. 6, 791-812)
or shift of up to three neighbours (Or-opt; Or 1976), and again after random double
bridges (Martin, Otto and Felten 1991, Complex Syst. 5, 299-326), half of them turned,
that leave it not much longer. Reversals are told by prefix sums in both directions, so
that lengths need not be symmetric.

Thermal reference readings are put between: of all places that keep the time between two
of them, those that cost least travel, by dynamic programming along the path (Prins
2004, Comput. Oper. Res. 31, 1985-2002, section 3).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist

from oed.arrays import Array, Index, Mask
from oed.instrument import Setup
from oed.measurement import Measurement, Series

#: most runs that are ordered exactly: 2^12 subsets
EXACT = 12
#: neighbouring runs that are shifted together
SHIFTED = 3
#: share of the largest length below which a gain counts as none
GAIN = 1e-9
#: a path this share longer is still gone on from
WORSE = 0.01


@dataclasses.dataclass(frozen=True, eq=False)
class Route:
    """Poses in the order of reading.

    indices  (n,) poses;  run (n,) number of the run that each belongs to
    steps    (n,) length of the move to each pose, the first from the start (0 without
             one)
    length   of the whole path, with the way to the finish if there is one
    exact    whether no path is shorter
    """

    indices: Index
    run: Index
    steps: Array
    length: float
    exact: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Schedule:
    """Readings in time.

    pose     (m,) pose of each reading, -1 at the thermal reference
    begins   (m,) when each reading begins, s
    seconds  until the last reading ends
    """

    pose: Index
    begins: Array
    seconds: float

    @property
    def reference(self) -> Mask:
        """Which readings (m,) are of the thermal reference."""
        return np.asarray(self.pose < 0)


# -- lengths of moves ------------------------------------------------------------------


def travel_times(before: Array, after: Array, speeds: ArrayLike) -> Array:
    """Seconds (n, m) from `before` (n, k) to `after` (m, k), joints or commands: the
    largest move over its speed (k,) or one speed, SI. Joints that move together at full
    speed take that; a straight move in the command takes longer.
    """
    speed = np.broadcast_to(np.asarray(speeds, dtype=float), before.shape[1:])
    if not (speed > 0.0).all():
        raise ValueError("speeds must be positive")
    return np.asarray(cdist(before / speed, after / speed, "chebyshev"))


def travel(measurement: Measurement, series: Series, speeds: ArrayLike) -> Array:
    """Seconds (n, n) between the poses that the n readings of a series read, by their
    joints; speeds (nq,) or one.
    """
    joints = series.q[series.index[:, 0]]
    return travel_times(joints, joints, speeds)


def travel_from(
    measurement: Measurement,
    series: Series,
    speeds: ArrayLike,
    command: ArrayLike | None = None,
) -> Array:
    """Seconds (n,) from a command (n_dof,), by default home, to the poses that a series
    reads.
    """
    if command is None:  # home is told for the reference tool
        _, q = measurement.kinematics.inverse(measurement.machine.home_command)
    else:
        tool = np.array(measurement.setups[series.setup].tool)
        _, q = measurement.kinematics.inverse(
            np.asarray(command, dtype=float)[None], None, tool
        )
    return np.asarray(travel_times(q, series.q[series.index[:, 0]], speeds)[0])


def free_moves(command: Array, clear: Callable[[Array, Array], Mask]) -> Mask:
    """Which moves (n, n) between commands (n, n_dof) are free; `clear(before, after)`
    tells it for k moves at once and is taken to hold both ways
    (`clearance.Clearance.free`).
    """
    i, j = np.triu_indices(len(command), 1)
    free = np.eye(len(command), dtype=bool)
    free[i, j] = free[j, i] = clear(command[i], command[j])
    return free


def around(direct: Array, free: Mask, out: Array, back: Array) -> tuple[Array, Mask]:
    """Lengths (n, m) of moves, and which of them go by way of a retract pose: those
    that are not free.

    out (n,) is the length from each pose to the retract pose, back (m,) from there; inf
    where that is not free. Moves that are free neither way have length inf.
    """
    length = np.where(free, direct, out[:, None] + back[None, :])
    return length, np.asarray(~free & np.isfinite(length))


# -- the path --------------------------------------------------------------------------


def order(
    distance: Array,
    rng: np.random.Generator,
    start: Array | None = None,
    finish: Array | None = None,
    runs: Sequence[Sequence[int]] | None = None,
    reversible: bool = False,
    kicks: int = 200,
) -> Route:
    """A short path through all poses.

    distance (n, n) of each move, inf where forbidden; start (n,) to each pose from
    where the machine stands, finish (n,) from each pose to where it is to end (None:
    anywhere, at no cost). `runs` hold the poses of each run in their own direction,
    every pose once; `reversible` ones may be taken backwards instead (passes of a
    protocol in both directions are runs of their own: `Series.passes`). `kicks` random
    changes are tried where the path is not exact; it is never longer than that of
    nearest neighbours. Raises ValueError where no path without a forbidden move is
    found.
    """
    n = len(distance)
    units = [[i] for i in range(n)] if runs is None else [list(run) for run in runs]
    _refuse(distance, start, finish, units)
    if n == 0:
        return Route(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0), 0.0, True)
    states = _States.of(
        np.asarray(distance, dtype=float), start, finish, units, reversible
    )
    exact = len(units) <= EXACT
    tour = _held_karp(states) if exact else _search(states, rng, kicks)
    length = states.length(tour)
    if not np.isfinite(length):
        why = "there is no path" if exact else "no path was found"
        raise ValueError(
            f"{why} through all {len(units)} runs or poses without a forbidden move: "
            "give a retract pose, or leave out poses that cannot be reached"
        )
    indices = np.concatenate([states.members[s] for s in tour])
    first = 0.0 if start is None else float(start[indices[0]])
    steps = np.append(first, distance[indices[:-1], indices[1:]])
    run = np.repeat(states.unit[tour], [len(states.members[s]) for s in tour])
    return Route(indices, run, steps, length, exact)


def order_setups(
    costs: Array, rng: np.random.Generator, first: Array | None = None
) -> Route:
    """Order of S set-ups with least re-mounting: costs (S, S) of changing from one to
    another, first (S,) of mounting each on the bare machine (`remounting`); inf where
    it cannot be done.
    """
    return order(costs, rng, start=first)


@dataclasses.dataclass(frozen=True, slots=True)
class Changes:
    """Seconds to change the tool, to move the cup (or where else the instrument stands,
    or is taught), and to change what the settings tell (the bar's length). Another
    instrument is mounted anew.
    """

    tool: float
    place: float
    settings: float


def remounting(setups: Sequence[Setup], changes: Changes) -> tuple[Array, Array]:
    """Seconds (S, S) to change from one set-up to another, and (S,) to mount each
    first.
    """
    first = np.array([s.instrument.cost.setup for s in setups], dtype=float)
    costs = np.zeros((len(setups), len(setups)))
    for i, a in enumerate(setups):
        for j, b in enumerate(setups):
            changed = {n for n in b.settings if a.settings.get(n) != b.settings[n]}
            placed = {n for n in changed if n in ("at_x", "at_y", "at_z")}
            costs[i, j] = changes.tool * (a.tool != b.tool)
            if a.instrument.name != b.instrument.name:
                costs[i, j] += first[j]
            else:
                costs[i, j] += changes.place * (bool(placed) or a.teach != b.teach)
                costs[i, j] += changes.settings * bool(changed - placed)
    return costs, first


@dataclasses.dataclass(frozen=True, eq=False)
class _States:
    """Runs in their directions; state 0 is where the machine starts and ends.

    cost     (S, S) from leaving one state to having passed the next
    flip     (S,) the same run the other way round, or itself
    unit     (S,) number of the run;  members (S) its poses
    """

    cost: Array
    flip: Index
    unit: Index
    members: list[Index]

    @classmethod
    def of(
        cls,
        distance: Array,
        start: Array | None,
        finish: Array | None,
        units: list[list[int]],
        reversible: bool,
    ) -> _States:
        members, unit, flip = [np.zeros(0, np.intp)], [-1], [0]
        for number, run in enumerate(units):
            ways = [run, run[::-1]] if reversible and len(run) > 1 else [run]
            flip += (
                [len(members) + 1, len(members)] if len(ways) == 2 else [len(members)]
            )
            members += [np.array(way, dtype=np.intp) for way in ways]
            unit += [number] * len(ways)
        entry, leave = (
            np.array([m[0] for m in members[1:]]),
            np.array([m[-1] for m in members[1:]]),
        )
        inner = np.array([distance[m[:-1], m[1:]].sum() for m in members[1:]])
        cost = np.zeros((len(members), len(members)))
        cost[0, 1:] = (0.0 if start is None else start[entry]) + inner
        cost[1:, 0] = 0.0 if finish is None else finish[leave]
        cost[1:, 1:] = distance[np.ix_(leave, entry)] + inner
        return cls(cost, np.array(flip), np.array(unit), members)

    def length(self, tour: Index) -> float:
        """Length of a path of states, without state 0."""
        closed = np.concatenate([[0], tour, [0]])
        return float(self.cost[closed[:-1], closed[1:]].sum())


def _refuse(
    distance: Array, start: Array | None, finish: Array | None, units: list[list[int]]
) -> None:
    n = len(distance)
    if np.shape(distance) != (n, n):
        raise ValueError(f"distances must be square, not of shape {np.shape(distance)}")
    for name, values in (("start", start), ("finish", finish)):
        if values is not None and np.shape(values) != (n,):
            raise ValueError(
                f"{name} must give one length for each of {n} poses, not be of shape"
                f" {np.shape(values)}"
            )
    given = [
        distance[~np.eye(n, dtype=bool)],
        *(v for v in (start, finish) if v is not None),
    ]
    if any(np.isnan(v).any() or (v < 0.0).any() for v in given):
        raise ValueError("lengths must be numbers, not negative; inf forbids a move")
    if sorted(i for run in units for i in run) != list(range(n)) or not all(units):
        raise ValueError(
            f"runs must hold each of the poses 0 to {n - 1} once, and none may be empty"
        )


def _held_karp(states: _States) -> Index:
    """Shortest path over all states, one of each run."""
    cost, bit = states.cost[1:, 1:], 1 << states.unit[1:]
    full = (1 << (states.unit[-1] + 1)) - 1
    best = np.full((full + 1, len(cost)), np.inf)
    before = np.full((full + 1, len(cost)), -1)
    best[bit, np.arange(len(cost))] = states.cost[0, 1:]
    for subset in range(1, full):
        free = np.flatnonzero((subset & bit) == 0)
        ways = best[subset][:, None] + cost[:, free]
        last = ways.argmin(axis=0)
        best[subset | bit[free], free] = ways[last, np.arange(free.size)]
        before[subset | bit[free], free] = last
    total = best[full] + states.cost[1:, 0]
    if not np.isfinite(total.min()):
        return (
            1 + np.unique(states.unit[1:], return_index=True)[1]
        )  # none is allowed: any will do to say so
    state, subset, tour = int(total.argmin()), full, []
    while state >= 0:
        tour.append(state + 1)
        state, subset = int(before[subset, state]), int(subset ^ bit[state])
    return np.array(tour[::-1], dtype=np.intp)


def _search(states: _States, rng: np.random.Generator, kicks: int) -> Index:
    """Nearest neighbours, improved, kicked, improved."""
    finite = states.cost[np.isfinite(states.cost)]
    largest = float(finite.max(initial=0.0))
    count = int(states.unit[-1]) + 1
    # one forbidden move is dearer than any path without
    cost = np.where(np.isfinite(states.cost), states.cost, (count + 1) * largest + 1.0)
    priced = dataclasses.replace(states, cost=cost)
    tolerance = GAIN * max(largest, 1e-300)
    here = best = _improve(_nearest(priced), priced, tolerance)
    for _ in range(kicks):
        a, b, c = np.sort(rng.choice(np.arange(count + 1), 3, replace=False))
        part = here[a:b] if rng.random() < 0.5 else states.flip[here[a:b]][::-1]
        kicked = _improve(
            np.concatenate([here[:a], here[b:c], part, here[c:]]), priced, tolerance
        )
        if priced.length(kicked) < priced.length(here) * (1.0 + WORSE):
            here = kicked
        if priced.length(here) < priced.length(best) - tolerance:
            best = here
    return best


def _nearest(states: _States) -> Index:
    """The shortest of the paths that always go to the nearest state left, over all
    first states.
    """
    tours = [_nearest_from(states, first) for first in range(1, len(states.unit))]
    return min(tours, key=states.length)


def _nearest_from(states: _States, first: int) -> Index:
    tour = [first]
    left = states.unit != states.unit[first]
    left[0] = False
    while left.any():
        row = np.where(left, states.cost[tour[-1]], np.inf)
        tour.append(int(row.argmin()))
        left &= states.unit != states.unit[tour[-1]]
    return np.array(tour, dtype=np.intp)


def _improve(tour: Index, states: _States, tolerance: float) -> Index:
    """The best reversal or shift, until none helps."""
    while True:
        closed = np.concatenate([[0], tour, [0]])
        shifts = [
            _shift(closed, states, size)
            for size in range(1, min(SHIFTED, len(tour) - 1) + 1)
        ]
        moves = [_reversal(closed, states), *shifts]
        delta, better = min(moves, key=lambda move: move[0])
        if delta > -tolerance:
            return tour
        tour = better()


def _sums(closed: Index, states: _States) -> tuple[Array, Array]:
    """Length up to each place (n + 2,) of the closed path, forwards and backwards with
    every run flipped.
    """
    flipped = states.flip[closed]
    forth = np.append(0.0, np.cumsum(states.cost[closed[:-1], closed[1:]]))
    back = np.append(0.0, np.cumsum(states.cost[flipped[1:], flipped[:-1]]))
    return forth, back


def _reversal(closed: Index, states: _States) -> tuple[float, Callable[[], Index]]:
    """Best change of length by turning round the places i to j, and the path then."""
    cost, flipped = states.cost, states.flip[closed]
    forth, back = _sums(closed, states)
    into = cost[np.ix_(closed[:-2], flipped[1:-1])]
    out = cost[np.ix_(flipped[1:-1], closed[2:])]
    delta = (
        into
        + out
        + (back[None, 1:-1] - back[1:-1, None])
        - (forth[None, 2:] - forth[:-2, None])
    )
    delta[np.tril_indices(len(delta), -1)] = np.inf
    i, j = np.unravel_index(int(delta.argmin()), delta.shape)
    tour = closed[1:-1]
    return float(delta[i, j]), lambda: np.concatenate(
        [tour[:i], states.flip[tour[i : j + 1]][::-1], tour[j + 1 :]]
    )


def _shift(
    closed: Index, states: _States, size: int
) -> tuple[float, Callable[[], Index]]:
    """Best change of length by putting `size` neighbours elsewhere, either way round,
    and the path then.
    """
    cost, flipped = states.cost, states.flip[closed]
    forth, back = _sums(closed, states)
    i = np.arange(1, len(closed) - size)  # first place of the neighbours
    j = i + size - 1
    k = np.arange(len(closed) - 1)  # they go between the places k and k + 1
    step = cost[closed[:-1], closed[1:]]
    taken = cost[closed[i - 1], closed[j + 1]] - step[i - 1] - step[j]
    turned = (back[j] - back[i]) - (forth[j] - forth[i])
    same = cost[np.ix_(closed[k], closed[i])].T + cost[np.ix_(closed[j], closed[k + 1])]
    other = (
        cost[np.ix_(closed[k], flipped[j])].T
        + cost[np.ix_(flipped[i], closed[k + 1])]
        + turned[:, None]
    )
    delta = np.minimum(same, other) + taken[:, None] - step[None, :]
    delta[(k[None, :] >= i[:, None] - 1) & (k[None, :] <= j[:, None])] = np.inf
    a, b = np.unravel_index(int(delta.argmin()), delta.shape)

    def better() -> Index:
        part = closed[i[a] : j[a] + 1]
        part = part if same[a, b] <= other[a, b] else states.flip[part][::-1]
        rest = np.delete(closed, np.s_[i[a] : j[a] + 1])
        place = k[b] + 1 if k[b] < i[a] else k[b] + 1 - size
        return np.insert(rest, place, part)[1:-1]

    return float(delta[a, b]), better


# -- thermal reference -----------------------------------------------------------------


def interleave(
    path: Route,
    reading: ArrayLike,
    every: float,
    to_reference: Array,
    from_reference: Array,
    reference_reading: float,
    begin: float = 0.0,
) -> Schedule:
    """The path with readings of a thermal reference pose: first, last, and so often
    that from the end of one to the begin of the next no more than `every` seconds pass.

    reading (n,) or one: seconds a reading, by pose number; path lengths, to_reference
    (n,) and from_reference (n,) are seconds too. Runs are not broken up. `begin` is
    when the machine stands at the reference. Raises ValueError where a run alone takes
    longer than `every`.
    """
    each = np.broadcast_to(np.asarray(reading, dtype=float), path.indices.shape)[
        path.indices
    ]
    cuts = (
        np.flatnonzero(np.append(True, path.run[1:] != path.run[:-1]))
        if len(each)
        else np.zeros(0, np.intp)
    )
    bounds = np.append(cuts, len(each))
    # when each pose's reading ends, from the begin of the first move within the path
    ends = np.cumsum(path.steps + each)
    outs, backs = from_reference[path.indices], to_reference[path.indices]

    def away(i: int, j: int) -> float:
        """Seconds between references around the places i to j - 1 of the path."""
        return float(outs[i] + each[i] + ends[j - 1] - ends[i] + backs[j - 1])

    least = np.full(len(bounds), np.inf)
    least[0] = 0.0
    origin = np.zeros(len(bounds), dtype=np.intp)
    for b in range(1, len(bounds)):
        for a in range(b - 1, -1, -1):
            seconds = away(bounds[a], bounds[b])
            if seconds > every * (1.0 + 1e-12) and a == b - 1:
                raise ValueError(
                    f"the run of pose {path.indices[bounds[a]]} takes {seconds:.6g} s"
                    f" with the way from and to the reference, longer than {every:.6g}"
                    " s: read the reference less often, or break the run up"
                )
            if (
                seconds <= every * (1.0 + 1e-12)
                and least[a] + seconds + reference_reading < least[b]
            ):
                least[b], origin[b] = least[a] + seconds + reference_reading, a
    stretches = []
    b = len(bounds) - 1
    while b > 0:
        stretches.append((int(bounds[origin[b]]), int(bounds[b])))
        b = int(origin[b])
    return _timed(path, each, outs, backs, stretches[::-1], reference_reading, begin)


def _timed(
    path: Route,
    each: Array,
    outs: Array,
    backs: Array,
    stretches: list[tuple[int, int]],
    reference_reading: float,
    begin: float,
) -> Schedule:
    pose, begins, clock = [-1], [begin], begin + reference_reading
    for i, j in stretches:
        for k in range(i, j):
            clock += float(outs[k] if k == i else path.steps[k])
            pose.append(int(path.indices[k]))
            begins.append(clock)
            clock += float(each[k])
        clock += float(backs[j - 1])
        pose.append(-1)
        begins.append(clock)
        clock += reference_reading
    return Schedule(np.array(pose, dtype=np.intp), np.array(begins), clock)
