"""No length is special: motion and phase of machines of any size."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oed.gap.data.state import Motion, motion, phase_along_runs, tool_places

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
