"""Orders of poses and runs, and next readings, against all permutations and plans."""

import itertools
from itertools import combinations, pairwise, permutations, product

import numpy as np
import pytest
from oracles import planar_geometry as planar
from shipped_models import ball_bar, calliper, height_probe, planar_2dof

from oed.instrument import Protocol, mount
from oed.measurement import Measurement
from oed.poses import Belief, next_reading, order


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


def plane(seed: int, n: int) -> np.ndarray:
    x = np.random.default_rng(seed).uniform(size=(n, 2))
    return np.linalg.norm(x[:, None] - x, axis=-1)


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("placed", [False, True])
def test_small_paths_are_the_shortest_of_all(monkeypatch, exact, placed):
    """3 to 6 poses, half of the moves forbidden; the search says which it is."""
    monkeypatch.setattr(order, "MAX_EXACT_RUNS", 12 if exact else 2)
    excess, impossible = [], 0
    for seed in range(24):
        n = 3 + seed % 4
        distance, first, _ = problem(seed, n, forbidden=0.5)
        start = first if placed else None
        first = first if placed else np.zeros(n)
        best = shortest(distance, first, np.zeros(n))
        if np.isinf(best):
            impossible += 1
            with pytest.raises(
                ValueError, match="there is no path" if exact else "no path was found"
            ):
                order.order_poses(
                    distance, np.random.default_rng(seed), start, kicks=60
                )
            continue
        path = order.order_poses(distance, np.random.default_rng(seed), start, kicks=60)
        total = first[path.indices[0]] + along(path.indices, distance)
        assert path.length == pytest.approx(total, abs=1e-12)
        assert path.steps.sum() == pytest.approx(total, abs=1e-12)
        assert path.exact is exact
        excess.append(path.length / best - 1)
    assert impossible >= 1
    assert min(excess) > -1e-12
    assert max(excess) < (1e-12 if exact else 0.05)
    assert np.mean(np.array(excess) < 1e-12) > 0.95


@pytest.mark.parametrize("seed", range(4))
def test_the_best_reversal_and_shift_are_those_of_all(seed):
    """Every stretch turned round, every one to three neighbours put elsewhere."""
    runs = [[3, 0, 5], [1], [2, 7], [6, 4], [8], [9, 10], [11]]
    distance, start, _ = problem(seed, 12)
    states = order.RunStates.of(distance, start, runs, True)
    tour = np.random.default_rng(seed).permutation([1, 3, 4, 6, 8, 9, 11])
    assert states.run[tour].tolist() != list(range(7))
    length, path = states.length(tour), order._ClosedPath.of(tour, states)

    def turned(part: np.ndarray) -> np.ndarray:
        return states.flip[part][::-1]

    def gain(paths: list[np.ndarray]) -> float:
        assert all(sorted(states.run[p]) == list(range(7)) for p in paths)
        return min(states.length(p) for p in paths) - length

    delta, changed = order._best_reversal(path, states)
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
        delta, changed = order._best_shift(path, states, size)
        assert delta == pytest.approx(gain(paths))
        assert states.length(changed()) - length == pytest.approx(delta)


@pytest.mark.parametrize("reversible", [True, False])
@pytest.mark.parametrize("exact", [True, False])
def test_runs_stay_together_in_the_best_order(monkeypatch, reversible, exact):
    monkeypatch.setattr(order, "MAX_EXACT_RUNS", 12 if exact else 2)
    runs = [[3, 0, 5], [1], [2, 7], [6, 4], [8]]
    excess = []
    for seed in range(5):
        distance, start, _ = problem(seed, 9)
        best = np.inf
        for p in permutations(runs):
            for ways in product(*[(r, r[::-1]) if reversible else (r,) for r in p]):
                whole = [i for r in ways for i in r]
                best = min(best, start[whole[0]] + along(whole, distance))
        rng, rules = (
            np.random.default_rng(seed),
            {"runs": runs, "reversible": reversible},
        )
        path = order.order_poses(distance, rng, start=start, **rules)
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


def test_the_passes_of_a_protocol_are_runs_that_follow_each_other():
    """A line there and back: the way back begins where the way there ended, and costs no travel."""
    setup = mount(height_probe.instrument, "probe")
    m = Measurement(planar_2dof.machine, [setup])
    command = np.column_stack([np.linspace(-1, 1, 4), np.full(4, 0.5)])
    protocol = Protocol(both_directions=True, average=False)
    series = m.series("probe", command, run=["line"] * 4).expand_passes(protocol)
    labels = list(dict.fromkeys(series.run))
    runs = [np.flatnonzero(series.run == label).tolist() for label in labels]
    path = order.order_poses(
        order.travel_between(series, 0.1), np.random.default_rng(0), runs=runs
    )
    assert [labels[k] for k in path.run[[0, 4]]] in (
        ["line, forward 1", "line, backward 1"],
        labels[::-1],
    )
    assert path.steps[4] == 0.0


def test_travel_is_the_slowest_joints(rng):
    m = Measurement(planar_2dof.machine, [mount(height_probe.instrument, "probe")])
    command = rng.uniform([-1.5, 0.0], [1.5, 1.5], (12, 2))
    q, speeds = planar.inverse(command), np.array([0.1, 0.04])
    series = m.series("probe", command)
    expected = [[max(abs(a - b) / speeds) for b in q] for a in q]
    assert order.travel_between(series, speeds) == pytest.approx(
        np.array(expected), abs=1e-9
    )
    home = planar.inverse(np.zeros(2))
    assert order.travel_from_home(m, series, speeds) == pytest.approx(
        (np.abs(q - home) / speeds).max(axis=1), abs=1e-9
    )
    assert order.travel_times(command, command[:3], 2.0).shape == (12, 3)
    with pytest.raises(ValueError, match="speeds must be positive"):
        order.travel_between(series, [0.1, 0.0])


def replay(pose, move, reading):
    """When each reading begins, for a machine that stands at its first pose at 0."""
    clock = [0.0]
    for a, b in pairwise(pose):
        clock.append(clock[-1] + reading(a) + move(a, b))
    return clock


@pytest.mark.parametrize("with_runs", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_reference_readings_cost_the_least_of_all_ways_to_place_them(seed, with_runs):
    rng = np.random.default_rng(seed)
    distance, travel, _ = problem(seed, 8)
    reading, begin = float(rng.uniform(0.6, 1.0)), 3.0
    runs = [[0, 1, 2], [3], [4, 5], [6], [7]] if with_runs else None
    path = order.order_poses(distance, rng, start=travel, runs=runs)
    every = 6.5

    def move(a: int, b: int) -> float:
        if a < 0 or b < 0:
            return float(travel[b] if a < 0 else travel[a])
        return float(distance[a, b])

    def takes(a: int) -> float:
        return reading

    best = np.inf
    for count in range(8):
        for cuts in combinations(range(1, 8), count):
            if any(path.run[c] == path.run[c - 1] for c in cuts):
                continue
            pose = np.concatenate([[-1], np.insert(path.indices, cuts, -1), [-1]])
            begins = np.array(replay(pose, move, takes))
            marks = begins[pose < 0]
            if (marks[1:] - (marks[:-1] + reading) <= every).all():
                best = min(best, begins[-1] + reading)
    pose, seconds = order.interleave(path, reading, every, travel, begin)
    assert seconds == pytest.approx(begin + best)
    assert seconds == pytest.approx(begin + replay(pose, move, takes)[-1] + reading)
    assert pose[pose >= 0].tolist() == path.indices.tolist()
    assert (pose[[0, -1]] == -1).all()
    assert 3 <= (pose < 0).sum() < 9
    with pytest.raises(
        ValueError, match="longer than 1 s: read the reference less often"
    ):
        order.interleave(path, reading, 1.0, travel, begin)


def test_without_need_the_reference_is_read_first_and_last_alone():
    path = order.order_poses(plane(1, 20), np.random.default_rng(0))
    pose, seconds = order.interleave(path, 6.0, 1e6, np.full(20, 3.0), 100.0)
    assert pose.tolist() == [-1, *path.indices, -1]
    assert seconds == pytest.approx(100 + 6 + 3 + path.length + 20 * 6 + 3 + 6)


def test_set_ups_are_ordered_with_least_remounting():
    """Each difference of set-ups is paid once, in Gray's order."""
    places = {
        0: {"at_x": 0.0, "at_y": 0.0, "at_z": 0.0},
        1: {"at_x": 0.0, "at_y": 0.3, "at_z": 0.0},
    }
    setups = []
    for tool, place, length in product((0.0, 0.05), (0, 1), (0.15, 0.3)):
        bar = {"tool": (0.0, 0.0, tool), "length": length, **places[place]}
        setups.append(mount(ball_bar.free_cup, f"{tool}{place}{length}", **bar))
    setups.append(mount(calliper.instrument, "calliper"))
    changes = order.ChangeTimes(tool=600.0, place=100.0, settings=10.0)
    costs, first = order.remounting(setups, changes)
    assert costs[0, 1] == 10.0
    assert costs[0, 2] == 100.0
    assert costs[0, 7] == 710.0
    assert costs[7, 0] == 710.0
    assert costs[0, 8] == calliper.instrument.cost.setup
    assert costs[7, 8] == calliper.instrument.cost.setup + 600.0
    assert (np.diag(costs) == 0.0).all()
    path = order.order_poses(costs, np.random.default_rng(0), first)
    bars = ball_bar.free_cup.cost.setup
    # tool once, cup once with each tool, bar once at each cup and tool
    assert path.length == pytest.approx(
        bars + calliper.instrument.cost.setup + 600 + 2 * 100 + 4 * 10
    )
    assert path.exact


def test_taught_set_ups_move_with_their_teach_pose():
    setups = [
        mount(ball_bar.instrument, n, teach=t)
        for n, t in (("a", (0.0, 0.2)), ("b", (0.3, 0.2)))
    ]
    costs, _ = order.remounting(
        setups, order.ChangeTimes(tool=600.0, place=100.0, settings=10.0)
    )
    assert costs.tolist() == [[0.0, 100.0], [100.0, 0.0]]


def test_orders_of_set_ups_are_the_cheapest_of_all_permutations():
    for seed in range(6):
        costs, first, _ = problem(seed, 6)
        path = order.order_poses(costs, np.random.default_rng(0), first)
        assert path.length == pytest.approx(shortest(costs, first, np.zeros(6)))


@pytest.fixture
def belief(rng: np.random.Generator) -> Belief:
    root = rng.standard_normal((6, 4))
    return Belief.build(np.linalg.inv(root.T @ root), rng.standard_normal((2, 3, 4)))


def exact(belief: Belief, rows: np.ndarray) -> np.ndarray:
    """Variances (K,) after rows (m, n), by the sum of informations."""
    covariance = np.linalg.inv(np.linalg.inv(belief.covariance) + rows.T @ rows)
    return np.array([np.trace(w @ covariance) for w in belief.weights])


@pytest.mark.parametrize("channels", [1, 2])
def test_variances_are_those_of_the_summed_information(channels, belief, rng):
    blocks = rng.standard_normal((5, channels, 4))
    after = belief.variances_after(blocks)
    for block, variances in zip(blocks, after, strict=True):
        assert variances == pytest.approx(exact(belief, block))
        assert belief.after(block).variances == pytest.approx(variances)
    several = belief.update_all(blocks, [0, 3])
    assert several.variances == pytest.approx(exact(belief, np.vstack(blocks[[0, 3]])))
    scores = [np.log(exact(belief, block)).sum() for block in blocks]
    assert belief.best_candidate(blocks) == int(np.argmin(scores))


def test_limits_count_for_what_lacks_them(belief, rng):
    blocks = rng.standard_normal((8, 1, 4))
    first = np.sqrt(belief.variances[0])
    limits = np.array([0.1 * first, np.nan])
    variances = np.array([exact(belief, block) for block in blocks])
    assert belief.best_candidate(blocks, limits) == int(np.argmin(variances[:, 0]))
    assert belief.open_components(limits) == [0]
    assert belief.open_components(np.array([2.0 * first, np.nan])) == []
    assert belief.open_components(None) == [0, 1]


def test_no_single_exchange_betters_the_remaining_readings(belief, rng, monkeypatch):
    blocks = rng.standard_normal((9, 1, 4))
    monkeypatch.setattr(next_reading, "MAX_SWEEPS", 20)  # until nothing changes

    def value(plan: list[int]) -> float:
        return float(np.log(exact(belief, blocks[plan][:, 0])).sum())

    plan = belief.best_remaining(blocks, 3)
    for place, other in itertools.product(range(3), range(9)):
        changed = [*plan[:place], other, *plan[place + 1 :]]
        assert value(changed) >= value(plan) - 1e-9
    alone = [value([k]) for k in plan]
    assert alone[0] == min(alone)


def test_the_fewest_readings_are_those_of_all_plans(belief, rng):
    """Readings may be taken again."""
    blocks = rng.standard_normal((6, 1, 4))
    limits = 0.6 * np.sqrt(belief.variances)

    def reaches(plan: tuple[int, ...]) -> bool:
        return bool((exact(belief, blocks[list(plan), 0]) <= limits**2).all())

    plans = itertools.combinations_with_replacement
    sizes = (n for n in range(1, 7) if any(map(reaches, plans(range(6), n))))
    fewest = next(sizes)
    found = belief.fewest_remaining(blocks, 20, limits)
    assert found is not None
    plan, count = found
    assert fewest <= count <= fewest + 1
    assert len(plan) in (count - 1, count)
    assert belief.fewest_remaining(blocks, 1, 1e-3 * limits) is None
    assert fewest > 1
    assert belief.fewest_remaining(blocks, fewest - 1, limits) is None
    assert belief.fewest_remaining(blocks, 5, 1e3 * limits) == ([], 0)
