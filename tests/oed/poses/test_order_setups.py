"""Orders with reference readings and set-ups."""

from itertools import combinations, pairwise, product

import numpy as np
import pytest
from shipped_models import ball_bar, calliper

from kernel.orders import plane, problem, shortest
from oed.instrument import mount
from oed.poses import order


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
