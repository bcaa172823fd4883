"""What hypotheses of mistakes must not explain."""

import dataclasses

import blunder_machines as machines
import numpy as np
import pytest

from oed.checks.explain import _log_of_poses_read
from oed.checks.mistakes.noise import _trend_p_value

HALF, OTHER = np.arange(20), np.arange(20, 30)  #: readings of two parts of a set-up


def test_residuals_that_follow_the_pose_are_no_noise(rng):
    """By second-order polynomials; the level of the test is kept by noise alone."""
    commands = rng.uniform(-1.0, 1.0, (60, 3))
    bent = commands[:, 0] * commands[:, 1]
    assert _trend_p_value(commands, bent + 0.1 * rng.standard_normal(60)) < 1e-9
    levels = [_trend_p_value(commands, rng.standard_normal(60)) for _ in range(400)]
    assert 0.02 < np.mean(np.array(levels) < 0.05) < 0.09
    assert _trend_p_value(commands[:12], bent[:12]) == 1.0


def test_poses_in_a_smaller_unit_are_as_much_denser_where_they_were_read():
    """A printer reads the same everywhere, and its noise is in z."""
    rows = machines.readings("delta", 0)
    session = machines.session("delta", rows)
    assert _log_of_poses_read(session, [session]) == 0.0
    same = session.with_y(np.zeros(len(session)))
    moved = tuple(
        dataclasses.replace(s, command=s.command * [1.0, 1.0, 1e-3])
        for s in same.series
    )
    squeezed = dataclasses.replace(same, series=moved)
    varied = sum(len(s) for s in same.series if np.ptp(s.command[:, 2]) > 0.0)
    assert varied > 20
    expected = varied * np.log(1e-3)
    assert _log_of_poses_read(same, [squeezed]) == pytest.approx(expected)
    # of one set-up among others, its own readings alone
    first, *rest = same.series
    two = dataclasses.replace(same, series=(first.take(HALF), first.take(OTHER), *rest))
    part = dataclasses.replace(two, series=(moved[0].take(HALF), *two.series[1:]))
    expected = len(HALF) * np.log(1e-3)
    assert _log_of_poses_read(two, [part]) == pytest.approx(expected)
