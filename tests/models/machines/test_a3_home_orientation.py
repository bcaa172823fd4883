"""Approach 1 of the A3 head's paper: ball bar, home point and home orientation.

Rows, readings and virtual machines are the oracle's.
"""

import numpy as np
import pytest
from oracles import a3_geometry as a3

from kernel import a3_plans
from oed.estimation import identify
from oed.measurement import Series

TILT = "rotation of the platform joints about the TCP, {} axis"


def test_approach_1_has_the_rows_of_the_oracle():
    """H of Eq. (14), 36 x 27, from code that shares none: angles in rad here."""
    m = a3_plans.approach_1()
    point, orientation = a3_plans.home_series(m)
    series = [point, orientation, a3_plans.circles(m, 15)]
    h = a3_plans.rows(m, series)
    h[3:6] /= m.machine.lever
    assert np.abs(h - a3.approach_1([0.08, 0.2], 15)).max() < 1e-11
    assert np.linalg.cond(h) == pytest.approx(17259, abs=1)


def test_approach_1_sees_27_of_27():
    m = a3_plans.approach_1()
    point, orientation = a3_plans.home_series(m)
    bar = a3_plans.circles(m, 15)
    spins = [TILT.format(axis) for axis in "xyz"]
    for series, rank, lost in (
        ([bar], 21, 6),
        ([bar, point], 24, 3),
        ([bar, orientation], 24, 3),
        ([bar, point, orientation], 27, 0),
    ):
        analysis, motions, _ = a3_plans.analyse(m, series)
        assert (analysis.rank, len(analysis.names)) == (rank, 27)
        assert len(motions) == lost
        assert (motions[:3] == spins) == (orientation not in series)


def test_home_orientation_of_a_wrong_machine_is_that_of_the_oracle():
    m = a3_plans.approach_1()
    theta = a3_plans.table_3(m)
    _, series = a3_plans.home_series(m)
    q = a3.inverse_nominal(a3_plans.HOME_Z, 0.0, 0.0)
    expected = a3.level_and_edge(theta[:24], q)
    assert np.abs(expected).max() > 1e-3
    assert m.readings([series], theta) == pytest.approx(expected, abs=1e-12)


def test_the_home_orientation_brings_back_the_lost_rotations():
    """A virtual machine of Table 3, turned: where its spindle points over the workspace
    comes back from exact readings with the level, and not without it.
    """
    m = a3_plans.approach_1()
    truth = a3_plans.table_3(m)
    turn = [2e-3, -1e-3, 3e-3]
    for k in range(3):
        columns = [m.names.index(f"da{k + 1}{axis}") for axis in "xyz"]
        truth[columns] += np.cross(turn, a3.A0_NOM[k])
    point, orientation = a3_plans.home_series(m)
    bar = a3_plans.circles(m, 15)
    commands = a3_plans.workspace()
    q = a3.inverse_nominal(*commands.T)

    def off(*series: Series) -> float:
        """Largest angle between identified and true spindle axis, rad."""
        fit = identify(m, series, m.readings(series, truth))
        real, found = (a3.forward(t[:24], q).R[..., 2] for t in (truth, fit.theta))
        return float(np.linalg.norm(np.cross(real, found), axis=1).max())

    assert off(bar, point) > 2e-3
    assert off(bar, point, orientation) < 1e-4
