"""Orders of poses, set-ups and reference readings, against all permutations and
geometry written out here.
"""

from collections.abc import Callable
from itertools import combinations, pairwise, permutations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import planar_geometry as planar

from oed.design import move_times, order, path_search, schedule
from oed.design.clearance import Clearance, Surroundings
from oed.design.segments import sphere
from oed.instrument import Protocol, mount
from oed.measurement import Measurement
from pkm_models.instruments import ball_bar, calliper, height_probe
from pkm_models.machines import planar_2dof


def problem(
    seed: int, n: int, forbidden: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lengths (n, n) that differ there and back, some of them forbidden, from the start
    (n,) and to the finish (n,).
    """
    rng = np.random.default_rng(seed)
    distance = rng.uniform(size=(n, n))
    distance[rng.uniform(size=(n, n)) < forbidden] = np.inf
    return distance, rng.uniform(size=n), rng.uniform(size=n)


def along(
    path: list[int] | tuple[int, ...] | np.ndarray, distance: np.ndarray
) -> float:
    return float(sum(distance[a, b] for a, b in pairwise(path)))


def shortest(distance: np.ndarray, start: np.ndarray, finish: np.ndarray) -> float:
    """Of all permutations."""
    return min(
        start[p[0]] + along(p, distance) + finish[p[-1]]
        for p in permutations(range(len(distance)))
    )


def nearest_neighbours(distance: np.ndarray) -> float:
    """Least length over all first poses; inf where it runs into a forbidden move."""
    lengths = []
    for first in range(len(distance)):
        path = [first]
        while len(path) < len(distance):
            on_left = [j for j in range(len(distance)) if j not in path]
            path.append(min(on_left, key=lambda j: distance[path[-1], j]))
        lengths.append(along(path, distance))
    return min(lengths)


def plane(seed: int, n: int) -> np.ndarray:
    x = np.random.default_rng(seed).uniform(size=(n, 2))
    return np.linalg.norm(x[:, None] - x, axis=-1)


# -- one path --------------------------------------------------------------------------


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("ends", [False, True])
def test_small_paths_are_the_shortest_of_all(
    monkeypatch: pytest.MonkeyPatch, exact: bool, ends: bool
) -> None:
    """3 to 6 poses, half of the moves forbidden; the search finds what is exact, or
    nearly, and says which it is.
    """
    monkeypatch.setattr(order, "EXACT", 12 if exact else 2)
    excess, impossible = [], 0
    for seed in range(24):
        n = 3 + seed % 4
        distance, start, finish = problem(seed, n, forbidden=0.5)
        start, finish = (start, finish) if ends else (np.zeros(n), np.zeros(n))
        best = shortest(distance, start, finish)
        given_ends = {"start": start, "finish": finish} if ends else {}
        if np.isinf(best):
            impossible += 1
            with pytest.raises(
                ValueError, match="there is no path" if exact else "no path was found"
            ):
                order.order_poses(
                    distance, np.random.default_rng(seed), kicks=60, **given_ends
                )
            continue
        path = order.order_poses(
            distance, np.random.default_rng(seed), kicks=60, **given_ends
        )
        total = (
            start[path.indices[0]]
            + along(path.indices, distance)
            + finish[path.indices[-1]]
        )
        assert path.length == pytest.approx(total, abs=1e-12)
        assert path.steps.sum() == pytest.approx(
            total - finish[path.indices[-1]], abs=1e-12
        )
        assert path.exact is exact
        excess.append(path.length / best - 1)
    assert impossible >= 1
    assert min(excess) > -1e-12
    assert max(excess) < (1e-12 if exact else 0.05)
    assert np.mean(np.array(excess) < 1e-12) > 0.95


@given(
    seed=st.integers(0, 10**6),
    n=st.integers(1, 25),
    forbidden=st.sampled_from([0.0, 0.1]),
)
@settings(max_examples=40, deadline=None)
def test_every_pose_once_and_never_longer_than_nearest_neighbours(
    seed: int, n: int, forbidden: float
) -> None:
    distance, _, _ = problem(seed, n, forbidden)
    try:
        path = order.order_poses(distance, np.random.default_rng(seed), kicks=5)
    except ValueError:
        assert np.isinf(nearest_neighbours(distance))
        return
    assert sorted(path.indices) == list(range(n))
    assert np.isfinite(path.steps).all()
    assert path.length == pytest.approx(along(path.indices, distance))
    assert path.length <= nearest_neighbours(distance) + 1e-12
    again = order.order_poses(distance, np.random.default_rng(seed), kicks=5)
    assert (again.indices == path.indices).all()


@pytest.mark.parametrize("symmetric", [True, False])
def test_search_comes_near_the_exact_path_where_both_can_be_had(
    monkeypatch: pytest.MonkeyPatch, symmetric: bool
) -> None:
    excess = []
    for seed in range(6):
        distance = plane(seed, 11) if symmetric else problem(seed, 11)[0]
        exact = order.order_poses(distance, np.random.default_rng(0))
        monkeypatch.setattr(order, "EXACT", 2)
        route = order.order_poses(distance, np.random.default_rng(0))
        monkeypatch.undo()
        assert exact.exact
        assert not route.exact
        excess.append(route.length / exact.length - 1)
    assert min(excess) > -1e-12
    assert np.median(excess) < 1e-12
    assert max(excess) < 0.02


@pytest.mark.parametrize("seed", range(4))
def test_the_best_reversal_and_shift_are_those_of_all(seed: int) -> None:
    """Every stretch turned round, every one to three neighbours put elsewhere either
    way round: lengths added up.
    """
    runs = [[3, 0, 5], [1], [2, 7], [6, 4], [8], [9, 10], [11]]
    distance, start, finish = problem(seed, 12)
    states = path_search.RunStates.of(distance, start, finish, runs, True)
    tour = np.random.default_rng(seed).permutation([1, 3, 4, 6, 8, 9, 11])
    assert states.run[tour].tolist() != list(range(7))
    length, closed = states.length(tour), np.concatenate([[0], tour, [0]])

    def turned(part: np.ndarray) -> np.ndarray:
        return states.flip[part][::-1]

    def gain(paths: list[np.ndarray]) -> float:
        assert all(sorted(states.run[p]) == list(range(7)) for p in paths)
        return min(states.length(p) for p in paths) - length

    delta, changed = path_search._best_reversal(closed, states)
    stretches = [(i, j) for i in range(7) for j in range(i + 1, 8)]
    assert delta == pytest.approx(
        gain([np.r_[tour[:i], turned(tour[i:j]), tour[j:]] for i, j in stretches])
    )
    assert states.length(changed()) - length == pytest.approx(delta)
    for size in (1, 2, 3):
        paths = []
        for i in range(8 - size):
            part, rest = tour[i : i + size], np.delete(tour, np.s_[i : i + size])
            for k in (k for k in range(len(rest) + 1) if k != i):
                paths += [np.r_[rest[:k], p, rest[k:]] for p in (part, turned(part))]
        delta, changed = path_search._best_shift(closed, states, size)
        assert delta == pytest.approx(gain(paths))
        assert states.length(changed()) - length == pytest.approx(delta)


def test_around_a_ring_all_gaps_but_the_widest_are_walked(
    rng: np.random.Generator,
) -> None:
    """The shortest open path on a convex ring does not cross itself; with one wide gap
    it is the ring without it.
    """
    angle = np.sort(rng.uniform(0.0, 1.7 * np.pi, 40))
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    shuffled = rng.permutation(40)
    distance = np.linalg.norm(ring[shuffled][:, None] - ring[shuffled], axis=-1)
    path = order.order_poses(distance, rng)
    assert path.length == pytest.approx(
        np.linalg.norm(np.diff(ring, axis=0), axis=1).sum()
    )
    walked = shuffled[path.indices]
    assert walked.tolist() in (list(range(40)), list(range(39, -1, -1)))


def test_lengths_that_make_no_sense_are_refused(rng: np.random.Generator) -> None:
    with pytest.raises(ValueError, match="must be square"):
        order.order_poses(np.ones((3, 2)), rng)
    with pytest.raises(ValueError, match="not negative"):
        order.order_poses(np.array([[0.0, -1.0], [1.0, 0.0]]), rng)
    with pytest.raises(ValueError, match="start must give one length"):
        order.order_poses(np.ones((3, 3)), rng, start=np.ones(2))
    with pytest.raises(ValueError, match="each of the poses 0 to 2 once"):
        order.order_poses(np.ones((3, 3)), rng, runs=[[0, 1], [1, 2]])
    nothing = order.order_poses(np.zeros((0, 0)), rng)
    assert nothing.length == 0.0
    assert nothing.indices.size == 0


# -- runs that stay together -----------------------------------------------------------


@pytest.mark.parametrize("reversible", [True, False])
@pytest.mark.parametrize("exact", [True, False])
def test_runs_stay_together_in_the_best_order(
    monkeypatch: pytest.MonkeyPatch, reversible: bool, exact: bool
) -> None:
    monkeypatch.setattr(order, "EXACT", 12 if exact else 2)
    runs = [[3, 0, 5], [1], [2, 7], [6, 4], [8]]
    excess = []
    for seed in range(10):
        distance, start, _ = problem(seed, 9)
        best = np.inf
        for p in permutations(runs):
            for ways in product(*[(r, r[::-1]) if reversible else (r,) for r in p]):
                whole = [i for r in ways for i in r]
                best = min(best, start[whole[0]] + along(whole, distance))
        path = order.order_poses(
            distance,
            np.random.default_rng(seed),
            start=start,
            runs=runs,
            reversible=reversible,
        )
        excess.append(path.length / best - 1)
        for number, run in enumerate(runs):
            places = np.flatnonzero(path.run == number)
            assert (np.diff(places) == 1).all()
            assert path.indices[places].tolist() in (
                [run, run[::-1]] if reversible else [run]
            )
    assert min(excess) > -1e-12
    assert max(excess) < (1e-12 if exact else 0.05)
    assert np.median(excess) < 1e-12


def test_the_passes_of_a_protocol_are_runs_that_follow_each_other() -> None:
    """A line there and back: the way back begins where the way there ended, and costs
    no travel.
    """
    setup = mount(height_probe.instrument, "probe")
    m = Measurement(planar_2dof.machine, [setup])
    command = np.column_stack([np.linspace(-1, 1, 4), np.full(4, 0.5)])
    protocol = Protocol(both_directions=True, average=False)
    series = m.series("probe", command, run=["line"] * 4).expand_passes(protocol)
    labels = list(dict.fromkeys(series.run))
    runs = [np.flatnonzero(series.run == label).tolist() for label in labels]
    path = order.order_poses(
        move_times.travel_between(m, series, 0.1), np.random.default_rng(0), runs=runs
    )
    assert [labels[k] for k in path.run[[0, 4]]] in (
        ["line, forward 1", "line, backward 1"],
        labels[::-1],
    )
    assert path.steps[4] == 0.0


# -- travel, forbidden moves, retract pose ---------------------------------------------


def test_travel_is_the_slowest_joints(rng: np.random.Generator) -> None:
    m = Measurement(planar_2dof.machine, [mount(height_probe.instrument, "probe")])
    command = rng.uniform([-1.5, 0.0], [1.5, 1.5], (12, 2))
    q, speeds = planar.inverse(command), np.array([0.1, 0.04])
    series = m.series("probe", command)
    expected = [[max(abs(a - b) / speeds) for b in q] for a in q]
    assert move_times.travel_between(m, series, speeds) == pytest.approx(
        np.array(expected), abs=1e-9
    )
    home = planar.inverse(np.zeros(2))
    assert move_times.travel_from(m, series, speeds) == pytest.approx(
        (np.abs(q - home) / speeds).max(axis=1), abs=1e-9
    )
    there = planar.inverse(np.array([1.0, 1.0]))
    from_there = move_times.travel_from(m, series, speeds, [1.0, 1.0])
    assert from_there == pytest.approx(
        (np.abs(q - there) / speeds).max(axis=1), abs=1e-9
    )
    assert move_times.travel_times(command, command[:3], 2.0).shape == (12, 3)
    with pytest.raises(ValueError, match="speeds must be positive"):
        move_times.travel_between(m, series, [0.1, 0.0])


def test_a_wall_between_two_groups_is_gone_round_by_the_retract_pose(
    rng: np.random.Generator,
) -> None:
    """A sphere between the groups blocks every straight move across; high above it
    there is room.
    """
    at = {"at_x": 0.0, "at_y": 0.0, "at_z": -1.0}
    m = Measurement(planar_2dof.machine, [mount(ball_bar.free_cup, "bar", **at)])
    groups = np.vstack(
        [rng.uniform([s - 0.1, 0.45], [s + 0.1, 0.55], (8, 2)) for s in (-0.7, 0.7)]
    )
    command = groups[rng.permutation(16)]
    on_left = command[:, 0] < 0
    about = Surroundings(
        obstacles=(sphere((0.0, 0.0, 0.5), 0.15),), links=0.02, ignore=(0, 2)
    )
    clear = Clearance(m, "bar", about).free_moves
    free = move_times.free_moves(command, clear)
    assert (free == (on_left[:, None] == on_left)).all()
    direct = move_times.travel_between(m, m.series("bar", command), 0.1)
    with pytest.raises(ValueError, match="give a retract pose"):
        order.order_poses(np.where(free, direct, np.inf), rng)
    retract = np.array([0.0, 1.4])
    reached = clear(command, np.broadcast_to(retract, command.shape))
    assert reached.all()
    legs = np.where(
        reached,
        move_times.travel_from(m, m.series("bar", command), 0.1, retract),
        np.inf,
    )
    distance, via = move_times.via_retract(direct, free, legs, legs)
    path = order.order_poses(distance, rng)
    i, j = path.indices[:-1], path.indices[1:]
    assert via[i, j].sum() == 1
    k = int(np.flatnonzero(via[i, j])[0])
    assert on_left[i[k]] != on_left[j[k]]
    assert path.steps[1:][k] == pytest.approx(legs[i[k]] + legs[j[k]])
    assert (path.steps[1:][~via[i, j]] == direct[i, j][~via[i, j]]).all()


def test_a_retract_pose_that_can_not_be_reached_does_not_help() -> None:
    free = np.array([[True, False], [False, True]])
    length, via = move_times.via_retract(
        np.ones((2, 2)), free, np.array([1.0, np.inf]), np.array([2.0, 3.0])
    )
    assert length.tolist() == [[1.0, 4.0], [np.inf, 1.0]]
    assert via.tolist() == [[False, True], [False, False]]


# -- thermal reference -----------------------------------------------------------------


def replay(
    pose: np.ndarray, move: Callable[[int, int], float], reading: Callable[[int], float]
) -> list[float]:
    """When each reading begins, for a machine that stands at its first pose at 0."""
    clock = [0.0]
    for a, b in pairwise(pose):
        clock.append(clock[-1] + reading(a) + move(a, b))
    return clock


@pytest.mark.parametrize("with_runs", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_reference_readings_cost_the_least_of_all_ways_to_place_them(
    seed: int, with_runs: bool
) -> None:
    rng = np.random.default_rng(seed)
    distance, to_reference, from_reference = problem(seed, 8)
    reading, stay = rng.uniform(0.5, 1.5, 8), 2.0
    runs = [[0, 1, 2], [3], [4, 5], [6], [7]] if with_runs else None
    path = order.order_poses(distance, rng, start=from_reference, runs=runs)
    every = 6.5

    def move(a: int, b: int) -> float:
        if a < 0 or b < 0:
            return float(from_reference[b] if a < 0 else to_reference[a])
        return float(distance[a, b])

    def takes(a: int) -> float:
        return stay if a < 0 else float(reading[a])

    best = np.inf
    for count in range(8):
        for cuts in combinations(range(1, 8), count):
            if any(path.run[c] == path.run[c - 1] for c in cuts):
                continue
            pose = np.concatenate([[-1], np.insert(path.indices, cuts, -1), [-1]])
            begins = np.array(replay(pose, move, takes))
            marks = begins[pose < 0]
            if (marks[1:] - (marks[:-1] + stay) <= every).all():
                best = min(best, begins[-1] + stay)
    timed = schedule.interleave(
        path, reading, every, to_reference, from_reference, stay
    )
    assert timed.seconds == pytest.approx(best)
    assert timed.begins == pytest.approx(replay(timed.pose, move, takes))
    assert timed.pose[timed.pose >= 0].tolist() == path.indices.tolist()
    assert timed.reference[[0, -1]].all()
    assert 3 <= timed.reference.sum() < 9
    with pytest.raises(
        ValueError, match="longer than 1 s: read the reference less often"
    ):
        schedule.interleave(path, reading, 1.0, to_reference, from_reference, stay)


def test_without_need_the_reference_is_read_first_and_last_alone() -> None:
    path = order.order_poses(plane(1, 20), np.random.default_rng(0))
    timed = schedule.interleave(
        path, 6.0, 1e6, np.full(20, 3.0), np.full(20, 2.0), 10.0, begin=100.0
    )
    assert timed.pose.tolist() == [-1, *path.indices, -1]
    assert timed.seconds == pytest.approx(100 + 10 + 2 + path.length + 20 * 6 + 3 + 10)


# -- set-ups ---------------------------------------------------------------------------


def test_set_ups_are_ordered_with_least_remounting() -> None:
    """Two tools, two cup places, two bars and a calliper: each difference is paid once,
    in Gray's order.
    """
    places = {
        0: {"at_x": 0.0, "at_y": 0.0, "at_z": 0.0},
        1: {"at_x": 0.0, "at_y": 0.3, "at_z": 0.0},
    }
    setups = [
        mount(
            ball_bar.free_cup,
            f"{tool}{place}{length}",
            tool=(0.0, 0.0, tool),
            length=length,
            **places[place],
        )
        for tool, place, length in product((0.0, 0.05), (0, 1), (0.15, 0.3))
    ]
    setups.append(mount(calliper.instrument, "calliper"))
    changes = move_times.ChangeTimes(tool=600.0, place=100.0, settings=10.0)
    costs, first = move_times.remounting(setups, changes)
    assert costs[0, 1] == 10.0
    assert costs[0, 2] == 100.0
    assert costs[0, 7] == 710.0
    assert costs[7, 0] == 710.0
    assert costs[0, 8] == calliper.instrument.cost.setup
    assert costs[7, 8] == calliper.instrument.cost.setup + 600.0
    assert (np.diag(costs) == 0.0).all()
    path = order.order_setups(costs, np.random.default_rng(0), first)
    bars = ball_bar.free_cup.cost.setup
    # tool once, cup once with each tool, bar once at each cup and tool
    assert path.length == pytest.approx(
        bars + calliper.instrument.cost.setup + 600 + 2 * 100 + 4 * 10
    )
    assert path.exact


def test_taught_set_ups_move_with_their_teach_pose() -> None:
    setups = [
        mount(ball_bar.instrument, n, teach=t)
        for n, t in (("a", (0.0, 0.2)), ("b", (0.3, 0.2)))
    ]
    costs, _ = move_times.remounting(
        setups, move_times.ChangeTimes(tool=600.0, place=100.0, settings=10.0)
    )
    assert costs.tolist() == [[0.0, 100.0], [100.0, 0.0]]


def test_orders_of_set_ups_are_the_cheapest_of_all_permutations() -> None:
    for seed in range(6):
        costs, first, _ = problem(seed, 6)
        path = order.order_setups(costs, np.random.default_rng(0), first)
        assert path.length == pytest.approx(shortest(costs, first, np.zeros(6)))
