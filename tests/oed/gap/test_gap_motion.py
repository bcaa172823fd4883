"""Rate, acceleration, sense and way of motions, on machines of any size."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oed.base import Array
from oed.gap.data.state import Motion, motion, phase_along_runs, tool_places

RADIUS, FEED = 0.1, 0.02
SWING = np.array([0.05, 0.03])
LATE = np.array([0.7, 2.9])  # rad, where the joints are farthest out


def _moved(q: Array, tip: Array, *, feed: float = FEED, still: int = 0) -> Motion:
    n = len(q)
    order, feeds = np.arange(n, dtype=float), np.full(n, feed)
    return motion(q, tip, np.full(n, "a"), order, feeds, np.arange(still))


def _circle(at: Array) -> tuple[Array, Array]:
    tip = np.column_stack([RADIUS * np.cos(at), RADIUS * np.sin(at), np.zeros(len(at))])
    return SWING * np.cos(at[:, None] - LATE), tip


@pytest.mark.parametrize(("count", "begin"), [(24, 0.0), (36, 1.3)])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_closed_circle_is_entered_rolling(count, begin, way):
    """q = a cos(t - t0) on a circle of radius r: q' = -a sin(t - t0) v / r, q'' = -a
    cos(t - t0) (v / r)^2, and a (1 - |cos|-like rest) gone since the last extremum, at
    the first pose as at any.
    """
    at = begin + way * 2.0 * np.pi * np.arange(count) / count
    motion = _moved(*_circle(at))
    angle, turn = at[:, None] - LATE, FEED / RADIUS
    assert motion.rate == pytest.approx(
        -way * SWING * np.sin(angle) * turn, abs=4e-3 * SWING.max() * turn
    )
    assert motion.acceleration == pytest.approx(
        -SWING * np.cos(angle) * turn**2, abs=2e-2 * SWING.max() * turn**2
    )
    assert (motion.sense == -way * np.sign(np.sin(angle))).all()
    since = np.mod(way * angle, np.pi)
    assert motion.reversal == pytest.approx(
        SWING * (1.0 - np.cos(since)), abs=2e-3 * SWING.max()
    )


@pytest.mark.parametrize("late", [-1e-5, 0.0, 1e-5])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_where_a_joint_turns_back_its_sense_is_that_of_arrival(way, late):
    """Up to rounding a joint at its extremum moved outward last, or inward."""
    at = way * 2.0 * np.pi * np.arange(24) / 24
    tip = np.column_stack([RADIUS * np.cos(at), RADIUS * np.sin(at), np.zeros(24)])
    motion = _moved(SWING[:1] * np.cos(at[:, None] - late), tip)
    assert motion.sense[0, 0] == 1.0
    assert motion.sense[12, 0] == -1.0
    assert (motion.sense[1:12, 0] == -1.0).all()
    assert (motion.sense[13:, 0] == 1.0).all()
    gone = motion.reversal[[0, 12], 0]
    assert gone == pytest.approx(np.full(2, 2.0 * SWING[0]), rel=1e-3)


def test_an_open_run_has_no_turn_before_its_first():
    """A line past one extremum: far away before it, from the extremum after it."""
    along = np.linspace(0.0, 1.0, 12)
    tip = np.column_stack([0.3 * along, np.zeros(12), np.zeros(12)])
    q = np.column_stack([-((along - 0.43) ** 2), along])
    motion = _moved(q, tip)
    before = along < 0.43
    assert np.isinf(motion.reversal[before, 0]).all()
    assert motion.reversal[~before, 0] == pytest.approx(
        (along[~before] - 0.43) ** 2, abs=1e-6
    )
    assert np.isinf(motion.reversal[:, 1]).all()
    assert (motion.sense[:, 1] == 1.0).all()
    assert motion.rate[:, 1] == pytest.approx(np.full(12, FEED / 0.3))
    assert motion.acceleration[:, 0] == pytest.approx(
        np.full(12, -2.0 * (FEED / 0.3) ** 2), rel=1e-6
    )


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_far_step_brings_the_machine_to_the_start_of_a_path(way):
    """At the reference the machine moves straight to the line's end, then along it."""
    along = way * np.linspace(-1.0, 1.0, 21)
    y = np.concatenate([[0.05 * way], along])
    tip = np.column_stack([y, np.zeros(22), np.zeros(22)])
    q = np.column_stack([y, 0.5 * y + 0.1 * y**2])
    motion = _moved(q, tip)
    straight = (q[1] - q[0]) / (1.05 / FEED)
    assert motion.rate[0] == pytest.approx(straight)
    assert motion.rate[1:, 0] == pytest.approx(np.full(21, way * FEED))
    assert motion.rate[1:, 1] == pytest.approx(way * FEED * (0.5 + 0.2 * along))
    assert motion.acceleration[1:, 1] == pytest.approx(np.full(21, 0.2 * FEED**2))
    assert (motion.sense[0] == -way).all()
    assert (motion.sense[1:] == way).all()
    assert np.isinf(motion.reversal[1:]).all()


def test_a_corner_is_reached_as_the_machine_came(rng):
    """The corner has sense and rate of the way there; distances after it count from it."""
    out = np.linspace(0.0, 1.0, 11)
    x = np.concatenate([out, out[-2::-1], np.zeros(10)])
    y = np.concatenate([np.zeros(21), out[1:]])
    tip = np.column_stack([x, y, np.zeros(31)])
    slant = rng.uniform(0.2, 0.4)
    q = np.column_stack([x + slant * y, y - slant * x])
    motion = _moved(q, tip)
    rates = FEED * np.repeat([[1.0, -slant], [-1.0, slant], [slant, 1.0]], 10, axis=0)
    assert motion.rate[1:] == pytest.approx(rates)
    assert (motion.sense[1:] == np.sign(rates)).all()
    first_turn, second_turn = q[10], q[20]
    assert np.isinf(motion.reversal[:11]).all()
    assert motion.reversal[11:21] == pytest.approx(np.abs(q[11:21] - first_turn))
    assert motion.reversal[21:, 0] == pytest.approx(q[21:, 0] - second_turn[0])
    assert motion.reversal[21:, 1] == pytest.approx(q[21:, 1] - first_turn[1])


def test_points_in_any_order_are_no_path(rng):
    """Between scattered points the way turns sharply: sense and distance are those of the steps."""
    tip = rng.uniform(-0.1, 0.1, (30, 3))
    q = tip[:, :2].copy()
    motion = _moved(q, tip)
    assert (motion.sense[1:] == np.sign(np.diff(q, axis=0))).all()
    for k in range(1, 30):
        step = np.abs(q[k] - q[k - 1])
        same = motion.sense[k] == motion.sense[k - 1]
        assert motion.reversal[k] == pytest.approx(
            np.where(same, motion.reversal[k - 1] + step, step)
        )
    assert np.isinf(motion.reversal[0]).all()


def test_what_stands_still_does_not_move():
    """Poses stood at have no sense and no rate; without a feed rates are not known."""
    q, tip = _circle(2.0 * np.pi * np.arange(24) / 24)
    motion = _moved(q, tip, feed=np.nan, still=3)
    assert not motion.sense[:3].any()
    assert not motion.rate[:3].any()
    assert np.isnan(motion.rate[3:]).all()
    assert np.isnan(motion.acceleration[3:]).all()
    alone = _moved(q[:1], tip[:1])
    assert not alone.rate.any()
    assert not alone.acceleration.any()


NOWHERE = np.empty(0, dtype=np.intp)
ANGLE = 2.0 * np.pi * np.arange(24) / 24
CIRCLE = np.column_stack([np.cos(ANGLE), np.sin(ANGLE), 0.2 * np.cos(2.0 * ANGLE)])
LINE = np.outer(np.linspace(-1.0, 1.0, 24), [0.3, 1.0, 0.1])
SCATTER = np.random.default_rng(5).uniform(-1.0, 1.0, (24, 3))
THERE_AND_BACK = np.vstack([LINE[:12], LINE[12::-1][:12]])


def moved(tip: np.ndarray, size: float) -> Motion:
    """Motion of joints at three feet about a tool on a path of this size, m."""
    feet = np.array([[3.0, 0.0, 2.0], [-2.0, 3.0, 2.0], [-2.0, -3.0, 2.0]])
    q = np.linalg.norm(tip[:, None] - feet, axis=2)
    count = len(tip)
    run, order = np.full(count, "1"), np.arange(count, dtype=float)
    feed = np.full(count, size / 60.0)
    return motion(size * q, size * tip, run, order, feed, NOWHERE)


@pytest.mark.parametrize("path", [CIRCLE, LINE, SCATTER, THERE_AND_BACK])
@pytest.mark.parametrize("size", [1e-6, 1e-3, 1e3])
def test_motion_is_that_of_the_same_path_of_another_size(path, size):
    usual, other = moved(path, 1.0), moved(path, size)
    np.testing.assert_array_equal(other.sense, usual.sense)
    for name in ("rate", "acceleration", "reversal"):
        wanted = size * getattr(usual, name)
        scale = np.abs(wanted[np.isfinite(wanted)]).max(initial=0.0)
        made = getattr(other, name)
        np.testing.assert_allclose(made, wanted, rtol=1e-6, atol=1e-9 * scale)


@pytest.mark.parametrize("size", [1e-8, 1e-3, 1e3])
def test_phase_is_that_of_the_same_path_of_another_size(size):
    run = np.full(len(CIRCLE), "1")
    usual = phase_along_runs(CIRCLE, run, NOWHERE)
    made = phase_along_runs(size * CIRCLE, run, NOWHERE)
    np.testing.assert_allclose(made, usual, atol=1e-9)


def test_a_tool_that_only_turns_goes_at_the_feed_at_its_lever():
    """Steps of t about the tool point take 2 L sin(t / 2) / feed; it has no phase."""
    lever, feed, step = 0.25, 0.02, np.deg2rad(4.0)
    tip = np.tile([0.3, -0.2, 1.1], (12, 1))
    angle = step * np.arange(12.0)
    rotation = Rotation.from_rotvec(np.outer(angle, [0.0, 1.0, 0.0])).as_matrix()
    q = np.column_stack([0.5 + 0.3 * angle, np.cos(angle)])
    run, order, speed = np.full(12, "1"), np.arange(12.0), np.full(12, feed)
    place = tool_places(tip, rotation, lever)
    turned = motion(q, place, run, order, speed, NOWHERE)
    seconds = 2.0 * lever * np.sin(step / 2.0) / feed
    np.testing.assert_allclose(turned.rate[:, 0], 0.3 * step / seconds)
    wanted = -np.sin(angle[1:-1]) * np.sin(step) / seconds
    np.testing.assert_allclose(turned.rate[1:-1, 1], wanted, rtol=1e-9)
    assert (turned.sense[:, 0] == 1.0).all()
    assert not phase_along_runs(tip, run, NOWHERE).any()


def test_a_turn_between_long_moves_is_no_jump():
    """0.2 m, a turn of 10 degrees, 0.2 m: rates are those of each step, by its length."""
    lever, feed = 0.4, 0.025
    tip = np.array([[0.0, 0.0, 1.0], [0.2, 0.0, 1.0], [0.2, 0.0, 1.0], [0.2, 0.2, 1.0]])
    turned = np.outer(np.deg2rad([0.0, 0.0, 10.0, 10.0]), [0.0, 0.0, 1.0])
    q = np.array([[0.0], [0.1], [0.2], [0.3]])
    place = tool_places(tip, Rotation.from_rotvec(turned).as_matrix(), lever)
    run, order, speed = np.full(4, "1"), np.arange(4.0), np.full(4, feed)
    moved = motion(q, place, run, order, speed, NOWHERE)
    turn = 2.0 * lever * np.sin(np.deg2rad(5.0))
    slow, fast = 0.1 * feed / 0.2, 0.1 * feed / turn
    # second order at unequal steps: each slope weighs by the length of the other step
    inner = (slow * turn + fast * 0.2) / (turn + 0.2)
    np.testing.assert_allclose(moved.rate[:, 0], [slow, inner, inner, slow])


def test_what_neither_moves_nor_turns_has_no_rate():
    place = tool_places(np.ones((5, 3)), np.tile(np.eye(3), (5, 1, 1)), 0.4)
    run, order, speed = np.full(5, "1"), np.arange(5.0), np.full(5, 0.02)
    still = motion(np.zeros((5, 2)), place, run, order, speed, NOWHERE)
    assert np.isnan(still.rate).all()
