"""The order in which poses are read: a short open path without forbidden moves.

Poses, or runs that stay together (a circle), are visited once each. Lengths may differ
there and back; inf forbids a move. A run that may be taken in both directions is two
states, of which one is visited.

The shortest path over few runs comes from dynamic programming over subsets (Held and
Karp 1962, J. SIAM 10, 196-210). Others are searched. The search starts from nearest
neighbours. It takes the best reversal of a stretch (2-opt; Croes 1958, Oper. Res. 6,
791-812) or shift of up to three neighbours (Or-opt; Or 1976), until none helps. It does
so again after random double bridges (Martin, Otto and Felten 1991, Complex Syst. 5,
299-326), half of them turned, that leave the path not much longer. Prefix sums in both
directions give the lengths of reversals, so lengths need not be symmetric.

Readings of a thermal reference go in between. Of all places that respect the longest
time between two reference readings, those with the least travel are taken, by dynamic
programming along the path (Prins 2004, Comput. Oper. Res. 31, 1985-2002, section 3).
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from oed.base import Array, Index
from oed.instrument import Setup
from oed.measurement import Measurement, Series

TIME_TOLERANCE = 1e-12  #: relative tolerance of the longest time


def interleave(
    path: "Route", reading: float, every: float, travel: Array, begin: float
) -> tuple[Index, float]:
    """The path with reference readings first, last, and at most `every` seconds apart.

    The time counts from the end of one reference reading to the begin of the next.

    path     whose lengths are seconds; runs are not broken up
    reading  seconds of each reading
    travel   (n,) seconds between each pose and the reference pose
    begin    when the machine stands at the reference

    Returns the pose of each reading, -1 at the reference, and when the last one ends.
    Raises ValueError where a run alone takes longer than `every`.
    """
    way = travel[path.indices]
    ends = np.cumsum(path.steps + reading)
    edges = np.append(np.flatnonzero(np.diff(path.run, prepend=-1)), len(ends))
    longest = every * (1.0 + TIME_TOLERANCE)
    least = np.full(len(edges), np.inf)
    least[0] = begin + reading
    origin = np.zeros(len(edges), dtype=np.intp)
    for b in range(1, len(edges)):
        for a in reversed(range(b)):
            first, last = edges[a], edges[b] - 1
            inside = reading + ends[last] - ends[first]
            seconds = float(way[first] + inside + way[last])
            if seconds > longest:
                if a == b - 1:
                    raise ValueError(
                        f"the run of pose {path.indices[first]} takes {seconds:.6g} s with"
                        f" the way from and to the reference, longer than {every:.6g} s:"
                        " read the reference less often, or break the run up"
                    )
                continue
            total = least[a] + seconds + reading
            if total < least[b]:
                least[b], origin[b] = total, a
    cuts = [len(ends)]
    b = len(edges) - 1
    while b > 0:
        b = int(origin[b])
        cuts.append(int(edges[b]))
    return np.insert(path.indices, cuts[::-1], -1), float(least[-1])


#: settings that tell where an instrument stands
PLACE_SETTINGS = ("at_x", "at_y", "at_z")


def travel_times(before: Array, after: Array, speeds: ArrayLike) -> Array:
    """Seconds (n, m) from `before` (n, k) to `after` (m, k), joints or commands, SI:
    the largest move over its speed (k,), or over one speed for all.
    """
    speed = np.broadcast_to(np.asarray(speeds, dtype=float), before.shape[1:])
    if not (speed > 0.0).all():
        raise ValueError("speeds must be positive")
    return np.asarray(
        scipy.spatial.distance.cdist(before / speed, after / speed, "chebyshev")
    )


def travel_between(series: Series, speeds: ArrayLike) -> Array:
    """Seconds (n, n) between n readings' poses, by joints of speeds (nq,), or one."""
    joints = series.q[series.index[:, 0]]
    return travel_times(joints, joints, speeds)


def travel_from_home(
    measurement: Measurement, series: Series, speeds: ArrayLike
) -> Array:
    """Seconds (n,) from home to the poses of a series; home has the reference tool."""
    _, q = measurement.kinematics.sent(measurement.machine.home_command)
    times = travel_times(q, series.q[series.index[:, 0]], speeds)
    return np.asarray(times[0])


@dataclasses.dataclass(frozen=True, slots=True)
class ChangeTimes:
    """Seconds to change parts of a set-up; another instrument is mounted anew."""

    tool: float  #: to change the tool
    place: float  #: to move the cup, or the place or teach pose of the instrument
    settings: float  #: to change other settings, such as the bar's length

    def order_mounting(
        self, setups: Sequence[Setup], rng: np.random.Generator
    ) -> tuple[list[str], float]:
        """Names of set-ups in the order of least re-mounting, and the time for that, s."""
        costs, first = remounting(setups, self)
        route = order_poses(costs, rng, first)
        return [setups[k].name for k in route.indices], route.length


def remounting(setups: Sequence[Setup], changes: ChangeTimes) -> tuple[Array, Array]:
    """Seconds (S, S) to change from one set-up to another, and (S,) to mount each first."""
    first = np.array([s.instrument.cost.setup for s in setups], dtype=float)
    costs = np.zeros((len(setups), len(setups)))
    for i, before in enumerate(setups):
        for j, after in enumerate(setups):
            costs[i, j] = changes.tool * (before.tool != after.tool)
            if before.instrument.name != after.instrument.name:
                costs[i, j] += first[j]
            else:
                costs[i, j] += _change_time(before, after, changes)
    return costs, first


def _change_time(before: Setup, after: Setup, changes: ChangeTimes) -> float:
    """Seconds to change place and settings of one instrument."""
    changed = {
        name
        for name, value in after.settings.items()
        if before.settings.get(name) != value
    }
    moved = changed.intersection(PLACE_SETTINGS)
    place_changes = bool(moved) or before.teach != after.teach
    seconds = changes.place * place_changes
    return seconds + changes.settings * bool(changed - moved)


MAX_KICKS = 200  #: number of random changes of a path, at most
MAX_MOVES = 20_000  #: the same times the number of readings: a minute of work
REFERENCE_RUN = "reference"  #: run of thermal reference readings
MAX_EXACT_RUNS = 12  #: most runs that are ordered exactly: 2^12 subsets
MAX_SHIFTED = 3  #: neighbouring runs that are shifted together, at the most
MIN_GAIN = 1e-9  #: share of the largest length below which a gain counts as none
WORSE_SHARE = 0.01  #: a path longer by this share is still a start for the next change
#: change of length, and the path after it
PathChange = tuple[float, Callable[[], Index]]


@dataclasses.dataclass(frozen=True, eq=False)
class Route:
    """Poses in the order of reading."""

    indices: Index  #: (n,) poses
    run: Index  #: (n,) number of the run that each pose belongs to
    #: (n,) length of the move to each pose, the first from the start (0 without)
    steps: Array
    length: float  #: of the whole path
    exact: bool  #: whether no path is shorter


def order_poses(
    distance: Array,
    rng: np.random.Generator,
    start: Array | None = None,
    runs: Sequence[Sequence[int]] | None = None,
    reversible: bool = False,
    kicks: int = 200,
) -> Route:
    """A short path through all poses.

    distance    (n, n) length of each move, inf where forbidden
    start       (n,) length from where the machine stands to each pose
    runs        poses of each run in its own direction, every pose once
    reversible  whether runs may be taken backwards instead; passes of a protocol in
                both directions are runs of their own (`Series.passes`)
    kicks       random changes where the path is not exact

    The path is never longer than that of nearest neighbours. Raises ValueError where no
    path without a forbidden move is found.
    """
    n = len(distance)
    members = [[i] for i in range(n)] if runs is None else [list(run) for run in runs]
    lengths = np.asarray(distance, dtype=float)
    states = RunStates.of(lengths, start, members, reversible)
    exact = len(members) <= MAX_EXACT_RUNS
    tour = shortest_path(states) if exact else search_path(states, rng, kicks)
    length = states.length(tour)
    if not np.isfinite(length):
        problem = "there is no path" if exact else "no path was found"
        raise ValueError(
            f"{problem} through all {len(members)} runs or poses without a forbidden"
            " move: leave out poses that cannot be reached"
        )
    indices = np.concatenate([states.members[s] for s in tour])
    first_step = 0.0 if start is None else float(start[indices[0]])
    steps = np.append(first_step, distance[indices[:-1], indices[1:]])
    run_lengths = [len(states.members[s]) for s in tour]
    run = np.repeat(states.run[tour], run_lengths)
    return Route(indices, run, steps, length, exact)


# -- the shortest path -----------------------------------------------------------------
@dataclasses.dataclass(frozen=True, eq=False)
class RunStates:
    """Runs in their directions; state 0 is where the machine starts and ends."""

    cost: Array  #: (S, S) from leaving one state to having passed the next
    flip: Index  #: (S,) the same run in the other direction, or itself
    run: Index  #: (S,) number of the run
    members: list[Index]  #: (S) poses of each state

    @classmethod
    def of(
        cls,
        distance: Array,
        start: Array | None,
        runs: list[list[int]],
        reversible: bool,
    ) -> "RunStates":
        """States of runs of poses; arguments as for `order.order_poses`."""
        members, numbers, flip = [np.zeros(0, np.intp)], [-1], [0]
        for number, run in enumerate(runs):
            forwards = len(members)
            if reversible and len(run) > 1:
                directions, flipped = [run, run[::-1]], [forwards + 1, forwards]
            else:
                directions, flipped = [run], [forwards]
            flip += flipped
            members += [np.array(poses, dtype=np.intp) for poses in directions]
            numbers += [number] * len(directions)
        states = members[1:]
        entry = np.array([poses[0] for poses in states])
        leave = np.array([poses[-1] for poses in states])
        inner = np.array([distance[poses[:-1], poses[1:]].sum() for poses in states])
        cost = np.zeros((len(members), len(members)))
        cost[0, 1:] = (0.0 if start is None else start[entry]) + inner
        cost[1:, 1:] = distance[np.ix_(leave, entry)] + inner
        return cls(cost, np.array(flip), np.array(numbers), members)

    def length(self, tour: Index) -> float:
        """Length of a path of states, given without state 0."""
        closed = np.concatenate([[0], tour, [0]])
        return float(self.cost[closed[:-1], closed[1:]].sum())


def shortest_path(states: RunStates) -> Index:
    """The shortest path, one state of each run."""
    cost = states.cost[1:, 1:]
    bit = 1 << states.run[1:]
    full = (1 << (states.run[-1] + 1)) - 1
    best = np.full((full + 1, len(cost)), np.inf)
    before = np.full((full + 1, len(cost)), -1)
    best[bit, np.arange(len(cost))] = states.cost[0, 1:]
    for subset in range(1, full):
        free = np.flatnonzero((subset & bit) == 0)
        lengths = best[subset][:, None] + cost[:, free]
        last = lengths.argmin(axis=0)
        best[subset | bit[free], free] = lengths[last, np.arange(free.size)]
        before[subset | bit[free], free] = last
    total = best[full] + states.cost[1:, 0]
    if not np.isfinite(total.min()):
        # no path is allowed: any one shows it, by its length
        return 1 + np.unique(states.run[1:], return_index=True)[1]
    state = int(total.argmin())
    subset = full
    tour = []
    while state >= 0:
        tour.append(state + 1)
        state, subset = int(before[subset, state]), int(subset ^ bit[state])
    return np.array(tour[::-1], dtype=np.intp)


def search_path(states: RunStates, rng: np.random.Generator, kicks: int) -> Index:
    """Nearest neighbours, improved, then changed at random and improved again."""
    finite = states.cost[np.isfinite(states.cost)]
    largest = float(finite.max(initial=0.0))
    count = int(states.run[-1]) + 1
    # one forbidden move costs more than any path without
    penalty = (count + 1) * largest + 1.0
    cost = np.where(np.isfinite(states.cost), states.cost, penalty)
    priced = dataclasses.replace(states, cost=cost)
    tolerance = MIN_GAIN * max(largest, 1e-300)
    current = best = _improve(_nearest_neighbours(priced), priced, tolerance)
    for _ in range(kicks):
        changed = _improve(_double_bridge(current, states, rng), priced, tolerance)
        if priced.length(changed) < priced.length(current) * (1.0 + WORSE_SHARE):
            current = changed
        if priced.length(current) < priced.length(best) - tolerance:
            best = current
    return best


def _double_bridge(tour: Index, states: RunStates, rng: np.random.Generator) -> Index:
    """The path with two neighbouring parts exchanged, the first one perhaps turned."""
    cuts = rng.choice(np.arange(len(tour) + 1), 3, replace=False)
    a, b, c = np.sort(cuts)
    part = tour[a:b]
    if rng.random() >= 0.5:
        part = states.flip[part][::-1]
    return np.concatenate([tour[:a], tour[b:c], part, tour[c:]])


def _nearest_neighbours(states: RunStates) -> Index:
    """The shortest path that always goes to the nearest state, over all first states."""
    firsts = range(1, len(states.run))
    tours = [_nearest_neighbours_from(states, first) for first in firsts]
    return min(tours, key=states.length)


def _nearest_neighbours_from(states: RunStates, first: int) -> Index:
    tour = [first]
    remaining = states.run != states.run[first]
    remaining[0] = False
    while remaining.any():
        costs = np.where(remaining, states.cost[tour[-1]], np.inf)
        tour.append(int(costs.argmin()))
        remaining &= states.run != states.run[tour[-1]]
    return np.array(tour, dtype=np.intp)


def _improve(tour: Index, states: RunStates, tolerance: float) -> Index:
    """The best reversal or shift, until none helps."""
    while True:
        path = _ClosedPath.of(tour, states)
        changes = [_best_reversal(path, states)]
        for size in range(1, min(MAX_SHIFTED, len(tour) - 1) + 1):
            changes.append(_best_shift(path, states, size))
        delta, changed = min(changes, key=lambda change: change[0])
        if delta > -tolerance:
            return tour
        tour = changed()


class _ClosedPath(NamedTuple):
    """A path from home and back, and what its moves cost."""

    closed: Index  #: (n + 2,) states
    moves: Array  #: (n + 2, n + 2) cost from each place to each
    #: the same into and out of flipped runs
    into: Array
    out: Array
    forwards: Array  #: (n + 2,) length up to each place
    backwards: Array  #: the same backwards, where every run is flipped

    @classmethod
    def of(cls, tour: Index, states: RunStates) -> "_ClosedPath":
        """The path (n,) of states."""
        closed = np.concatenate([[0], tour, [0]])
        flipped = states.flip[closed]
        rows = states.cost[closed]
        moves, into = rows[:, closed], rows[:, flipped]
        forwards = np.cumsum(moves.diagonal(1))
        backwards = np.cumsum(states.cost[flipped[1:], flipped[:-1]])
        return cls(
            closed,
            moves,
            into,
            states.cost[flipped][:, closed],
            np.append(0.0, forwards),
            np.append(0.0, backwards),
        )


def _best_reversal(path: _ClosedPath, states: RunStates) -> PathChange:
    """The best reversal of the places i to j."""
    forwards, backwards = path.forwards, path.backwards
    inside = backwards[None, 1:-1] - backwards[1:-1, None]
    removed = forwards[None, 2:] - forwards[:-2, None]
    delta = path.into[:-2, 1:-1] + path.out[1:-1, 2:] + inside - removed
    delta[np.tri(len(delta), k=-1, dtype=bool)] = np.inf
    i, j = np.unravel_index(int(delta.argmin()), delta.shape)
    tour = path.closed[1:-1]

    def reverse() -> Index:
        turned = states.flip[tour[i : j + 1]][::-1]
        return np.concatenate([tour[:i], turned, tour[j + 1 :]])

    return float(delta[i, j]), reverse


def _best_shift(path: _ClosedPath, states: RunStates, size: int) -> PathChange:
    """The best shift of `size` neighbours to another place, in either direction."""
    closed, forwards, backwards = path.closed, path.forwards, path.backwards
    i = np.arange(1, len(closed) - size)  # first place of the neighbours
    j = i + size - 1  # their last place
    k = np.arange(len(closed) - 1)  # they go between the places k and k + 1
    firsts, lasts = slice(1, len(closed) - size), slice(size, -1)
    step = path.moves.diagonal(1)
    removed = path.moves.diagonal(size + 1) - step[i - 1] - step[j]
    turned = (backwards[j] - backwards[i]) - (forwards[j] - forwards[i])
    same_direction = path.moves[:-1, firsts].T + path.moves[lasts, 1:]
    other_direction = path.into[:-1, lasts].T + path.out[firsts, 1:] + turned[:, None]
    delta = np.minimum(same_direction, other_direction)
    delta = delta + removed[:, None] - step[None, :]
    overlaps = (k[None, :] >= i[:, None] - 1) & (k[None, :] <= j[:, None])
    delta[overlaps] = np.inf
    a, b = np.unravel_index(int(delta.argmin()), delta.shape)

    def shift() -> Index:
        part = closed[i[a] : j[a] + 1]
        if same_direction[a, b] > other_direction[a, b]:
            part = states.flip[part][::-1]
        others = np.delete(closed, np.s_[i[a] : j[a] + 1])
        insertion = k[b] + 1 if k[b] < i[a] else k[b] + 1 - size
        return np.insert(others, insertion, part)[1:-1]

    return float(delta[a, b]), shift


# -- readings of a plan ----------------------------------------------------------------
@dataclasses.dataclass(frozen=True, eq=False)
class ReadingOrder:
    """Readings of one set-up in an order of short joint travel."""

    measurement: Measurement
    series: Series  #: as given
    path: Route  #: through its readings, s
    speeds: Sequence[float]  #: of the joints, SI
    from_home: bool  #: whether the machine begins at home
    as_given: float  #: joint travel in the given order, s

    @classmethod
    def of_readings(
        cls,
        measurement: Measurement,
        series: Series,
        speeds: Sequence[float],
        rng: np.random.Generator,
        *,
        from_home: bool,
        keeps_runs: bool,
    ) -> "ReadingOrder":
        """The readings of one set-up by short joint travel; those of a run stay together.

        speeds      of the joints, SI
        keeps_runs  whether runs keep their own order and direction
        """
        distance = travel_between(series, speeds)
        start = travel_from_home(measurement, series, speeds) if from_home else None
        path = order_poses(
            distance,
            rng,
            start,
            runs=_runs(series, distance, keeps_runs, rng),
            reversible=not keeps_runs,
            kicks=_kicks(len(series)),
        )
        as_given = float(
            distance[np.arange(len(series) - 1), np.arange(1, len(series))].sum()
        )
        as_given += 0.0 if start is None else float(start[0])
        return cls(measurement, series, path, speeds, from_home, as_given)

    @property
    def ordered(self) -> Series:
        """The readings in order."""
        return self.series.take(self.path.indices)

    @property
    def reading(self) -> float:
        """Time of one reading, s."""
        return self.measurement.reading_seconds(self.series.setup)

    @property
    def seconds(self) -> float:
        """Time until the last reading ends, s."""
        return self.path.length + self.reading * len(self.series)

    def add_references(
        self, command: Array | None, every: float
    ) -> tuple[Series, float]:
        """The readings with those of a thermal reference in between; the time, s.

        command  (n_dof,) of the reference, SI; None: that of the first reading
        every    longest time between two, s; ValueError where a run takes longer
        """
        commands = self.series.reading_commands()
        setup = self.series.setup
        if command is None:
            command = np.asarray(commands[self.path.indices[0]])
        reference = self.measurement.series(setup, command[None])
        joints = self.series.q[self.series.index[:, 0]]
        travel = travel_times(reference.q[:1], joints, self.speeds)[0]
        begin = 0.0
        if self.from_home:
            begin = float(travel_from_home(self.measurement, reference, self.speeds)[0])
        poses, seconds = interleave(self.path, self.reading, every, travel, begin)
        planned = [command if k < 0 else commands[k] for k in poses]
        runs = [REFERENCE_RUN if k < 0 else str(self.series.run[k]) for k in poses]
        return self.measurement.series(setup, np.array(planned), runs), seconds


def _kicks(count: int) -> int:
    """Random changes of a path, fewer the longer each takes."""
    return min(MAX_KICKS, MAX_MOVES // count)


def _runs(
    series: Series, distance: Array, keeps_runs: bool, rng: np.random.Generator
) -> list[list[int]] | None:
    """Runs, ordered unless they keep their order; None for readings by themselves."""
    labels = list(dict.fromkeys(series.run))
    if len(labels) == 1 and not keeps_runs:
        return None
    runs = []
    for label in labels:
        members = np.flatnonzero(series.run == label)
        if not keeps_runs:
            within = distance[np.ix_(members, members)]
            path = order_poses(within, rng, kicks=_kicks(len(members)))
            members = members[path.indices]
        runs.append([int(k) for k in members])
    return runs
