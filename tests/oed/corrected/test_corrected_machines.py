"""Bands and rms of corrected machines of the oracles; `benchmarks/corrected.py` has more."""

import numpy as np
import pytest

from kernel import corrected_cases, corrected_machines
from oed.corrected import EffectReadings


def test_a_planar_machine_is_as_far_off_as_predicted():
    found = corrected_machines.coverage(corrected_cases.planar_case(), 2, 3)
    assert (np.abs(found.error) < 5.0 * found.sd).all()
    assert (found.ratio < 2.5).all()


@pytest.mark.parametrize(("name", "most"), [
    ("planar_2dof", 0), ("linear_delta", 0), ("a3_head", 0), ("a3_turning", 12),
])  # fmt: skip
def test_joints_arrive_in_the_sense_of_the_path(name, most):
    """As the oracle's path says, but where a leg stands almost still at its turn."""
    case = corrected_cases.CASES[name]()
    session, m = corrected_machines.planned(case), case.measurement
    y = m.readings([session.series], m.nominal)
    readings = EffectReadings(m, (session.series,), y, session.rows)
    (state,) = readings.problem(m.nominal).states
    read = session.series.index[:, 0]
    assert np.sum(state.motion_sign[read] != session.sense) <= most
