"""Rate, acceleration, sense, and way since a joint turned, for motions in closed form."""

import numpy as np
import pytest

from oed.base import Array
from oed.gap.data.state import Motion, motion

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
