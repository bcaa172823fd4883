"""Grids and tables of commands against the functions that they must reproduce."""

import itertools
import math

import numpy as np
import pytest
from shipped_models import a3_head, hexapod

from oed.base import grid_nodes
from oed.compensate import InterpolationTable
from oed.compensate.command_grid import CommandGrid, GridAxis, joint_motion
from oed.mechanism import Kinematics

#: rms of u (1 - u) / 2 over an interval: what a parabola of curvature 1 loses
PARABOLA = 1.0 / math.sqrt(120.0)
TURN = 2.0 * np.pi


def as_is(command: np.ndarray) -> np.ndarray:
    """Components that are the joints."""
    return np.broadcast_to(np.eye(2), (len(command), 2, 2))


def chosen(axes, correction, target, largest=10000):
    rng = np.random.default_rng(5)
    return CommandGrid.choose(axes, correction, as_is, np.full(2, target), largest, rng)


def parabolas(command: np.ndarray) -> np.ndarray:
    """Curvatures 8 and 2 along two axes in joint 1, nothing in joint 2."""
    first = 4.0 * command[:, 0] ** 2 + command[:, 1] ** 2
    return np.stack([first, np.zeros(len(first))], axis=1)[:, None]


def test_a_parabola_gets_the_nodes_that_its_curvature_needs():
    """Along both axes the error is equally large, so one has twice the intervals."""
    axes = (GridAxis("a", "m", -1.0, 1.0), GridAxis("b", "m", -1.0, 1.0))
    grid = chosen(axes, parabolas, 1e-3)
    intervals = np.array(grid.counts) - 1
    assert intervals[0] / intervals[1] == pytest.approx(2.0, rel=0.12)
    bend = np.array([8.0, 2.0]) * (2.0 / intervals) ** 2
    # both parabolas bend the same way: their errors correlate by 5/6
    rms = PARABOLA * np.sqrt(bend @ bend + 2.0 * bend.prod() * 5.0 / 6.0)
    assert grid.errors[0, 0] == pytest.approx(rms, rel=0.1)
    assert grid.errors[0, 1] == 0.0
    assert grid.is_fine
    assert 0.8e-3 < grid.errors.max() <= 1e-3
    assert len(grid.commands) == math.prod(grid.counts)


def test_a_limit_stops_the_refinement_and_says_what_it_costs():
    axes = (GridAxis("a", "m", -1.0, 1.0), GridAxis("b", "m", -1.0, 1.0))
    grid = chosen(axes, parabolas, 1e-3, largest=60)
    assert not grid.is_fine
    assert 50 <= len(grid.commands) <= 60
    assert grid.errors.max() > 1e-3
    assert [axis.fewest for axis in axes] == [2, 2]
    held = (axes[0], GridAxis("b", "m", 0.3, 0.3))
    assert chosen(held, parabolas, 1e-3).counts[1] == 1


def test_interpolation_goes_on_over_the_end_of_a_turn():
    def waves(command: np.ndarray) -> np.ndarray:
        values = np.stack([np.sin(command[:, 0]), np.cos(3.0 * command[:, 0])], axis=1)
        return values[:, None]

    grid = chosen((GridAxis("psi", "rad", 0.3, 0.3 + TURN, turn=True),), waves, 0.01)
    step = TURN / (grid.counts[0] - 1)
    assert grid.errors[0] == pytest.approx(
        PARABOLA * step**2 * np.array([1.0, 9.0]) / math.sqrt(2.0), rel=0.12
    )
    values = waves(grid.commands)[:, 0]
    table = InterpolationTable(("psi",), grid.knots, values, grid.turns)
    rng = np.random.default_rng(2)
    places = rng.uniform(-3.0 * TURN, 3.0 * TURN, (2000, 1))
    error = table.at(places) - waves(places)[:, 0]
    assert np.sqrt(np.mean(error**2, axis=0)) == pytest.approx(grid.errors[0], rel=0.1)


def test_the_box_of_commands_closes_a_turn_that_they_go_round():
    machine = a3_head.machine

    def psi(places: np.ndarray) -> tuple[float, float, bool]:
        command = np.array([(1.1, p, t) for p in places for t in (0.1, 0.4)])
        axis = GridAxis.box_axes(machine, command)[1]
        return axis.lower, axis.upper, axis.turn

    twelve = np.arange(12) * TURN / 12.0
    assert psi(twelve) == pytest.approx((0.0, TURN, True))
    assert psi(twelve - np.pi) == pytest.approx((-np.pi, np.pi, True))
    assert psi(twelve[:7]) == pytest.approx((0.0, np.pi, False))
    assert psi(np.linspace(-TURN, TURN, 5)) == pytest.approx((0.0, TURN, True))
    # turns about fixed axes do not come back to the same controlled quantities
    corners = np.array([c.upper for c in hexapod.machine.command])
    lattice = np.stack([-corners, 0.0 * corners, corners])
    assert not any(axis.turn for axis in GridAxis.box_axes(hexapod.machine, lattice))


def test_a_table_may_reach_further_than_its_errors_count():
    """The far half bends a hundred times as much; nobody asks what is lost there."""

    def bent(command: np.ndarray) -> np.ndarray:
        a = command[:, 0]
        first = 4.0 * a**2 + np.where(a < 0.0, 400.0 * a**2, 0.0)
        return np.stack([first, np.zeros(len(a))], axis=1)[:, None]

    axis = GridAxis("a", "m", 0.0, 1.0)
    whole = GridAxis("a", "m", -1.0, 1.0)
    assert axis.reaching(1.0) == axis.reaching(0.3) == axis
    longer = axis.reaching(-1.0)
    assert (longer.lower, longer.upper, longer.evaluated) == (-1.0, 1.0, (0.0, 1.0))
    counts = [chosen((a,), bent, 1e-3).counts[0] for a in (axis, longer, whole)]
    assert counts[1] - 1 == pytest.approx(2 * (counts[0] - 1), rel=0.1)
    assert counts[2] > 5 * counts[1]
    turn = GridAxis("psi", "rad", 0.0, TURN, turn=True)
    assert turn.reaching(-1.0) == turn
    assert longer.shrunk(0.5).evaluated == (0.25, 0.75)


def test_motion_of_components_agrees_with_moved_joints():
    kinematics = Kinematics(a3_head.machine)
    nominal = a3_head.machine.nominal
    command = np.array([[1.1, 0.7, 0.3], [1.2, -2.0, 0.5]])
    x, q = kinematics.inverse(command)
    motion, step = joint_motion(kinematics, command), 1e-7
    for k in range(3):
        moved = q.copy()
        moved[:, k] += step
        reached = kinematics.forward(moved, nominal, x)
        tilt = np.hypot(reached[:, 3], reached[:, 4])
        psi = np.arctan2(reached[:, 4], reached[:, 3])
        change = np.stack([reached[:, 2], psi, tilt], axis=1) - command
        assert motion[:, :, k] * step == pytest.approx(change, rel=1e-4, abs=1e-12)


KNOTS = (np.array([0.0, 1.0, 4.0]), np.array([-1.0, 2.0]), np.array([7.0]))


def bilinear(places: np.ndarray) -> np.ndarray:
    a, b = places[:, 0], places[:, 1]
    return np.column_stack([2.0 + a - 3.0 * b + a * b, 5.0 * b])


def test_nodes_are_the_product_of_the_knots():
    assert grid_nodes(KNOTS) == pytest.approx(np.array(list(itertools.product(*KNOTS))))


def test_a_bilinear_function_is_reproduced_and_its_border_holds():
    """Along an axis of one knot nothing varies."""
    nodes = grid_nodes(KNOTS)
    table = InterpolationTable(
        ("a", "b", "c"), KNOTS, bilinear(nodes).reshape(3, 2, 1, 2)
    )
    places = np.array([[0.3, 1.1, 7.0], [2.0, -0.5, -9.0], [9.0, 1.0, 7.0]])
    inside = np.clip(places, [0, -1, 7], [4, 2, 7])
    assert table.at(places) == pytest.approx(bilinear(inside))


def test_a_full_turn_goes_on():
    turn = np.linspace(0.0, 2.0 * np.pi, 5)
    table = InterpolationTable(
        ("psi",), (turn,), np.array([1.0, 3.0, 5.0, 2.0, 1.0])[:, None], (True,)
    )
    place = np.array([[0.25 * np.pi]])
    for turns in (-1, 0, 3):
        assert table.at(place + 2.0 * np.pi * turns) == pytest.approx(2.0)


def test_values_of_another_shape_and_descending_knots_are_refused():
    with pytest.raises(ValueError, match="needs values of that shape"):
        InterpolationTable(("a",), (np.arange(3.0),), np.zeros((2, 1)))
    with pytest.raises(ValueError, match="knots of a must ascend"):
        InterpolationTable(("a",), (np.array([1.0, 0.0]),), np.zeros((2, 1)))
