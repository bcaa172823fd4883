"""No length is special: motion and phase of machines of any size."""

import numpy as np
import pytest

from oed.gap.data.motion import Motion, motion
from oed.gap.data.state import phase_along_runs

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
def test_motion_is_that_of_the_same_path_of_another_size(
    path: np.ndarray, size: float
) -> None:
    usual, other = moved(path, 1.0), moved(path, size)
    np.testing.assert_array_equal(other.sense, usual.sense)
    for name in ("rate", "acceleration", "reversal"):
        wanted = size * getattr(usual, name)
        scale = np.abs(wanted[np.isfinite(wanted)]).max(initial=0.0)
        made = getattr(other, name)
        np.testing.assert_allclose(made, wanted, rtol=1e-6, atol=1e-9 * scale)


@pytest.mark.parametrize("size", [1e-8, 1e-3, 1e3])
def test_phase_is_that_of_the_same_path_of_another_size(size: float) -> None:
    run = np.full(len(CIRCLE), "1")
    usual = phase_along_runs(CIRCLE, run, NOWHERE)
    made = phase_along_runs(size * CIRCLE, run, NOWHERE)
    np.testing.assert_allclose(made, usual, atol=1e-9)


def test_a_tool_that_only_turns_has_no_rate_and_no_phase() -> None:
    """A feed of the tool point says nothing of the joints then."""
    tip = np.tile([0.3, -0.2, 1.1], (12, 1))
    q = np.column_stack([0.5 + 0.01 * np.sin(ANGLE[:12]), np.linspace(0.4, 0.5, 12)])
    run, order, feed = np.full(12, "1"), np.arange(12.0), np.full(12, 0.02)
    turned = motion(q, tip, run, order, feed, NOWHERE)
    assert np.isnan(turned.rate).all()
    assert np.isnan(turned.acceleration).all()
    assert (turned.sense[:, 1] == 1.0).all()
    assert not phase_along_runs(tip, run, NOWHERE).any()
