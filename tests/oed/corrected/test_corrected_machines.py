"""Bands and rms of corrected machines of the oracles; `benchmarks/corrected.py` has more."""

import numpy as np
import pytest

from kernel import corrected_cases, corrected_machines
from oed.corrected import EffectReadings


def test_a_planar_machine_is_as_far_off_as_predicted() -> None:
    found = corrected_machines.coverage(corrected_cases.planar_case(), 2, 3)
    assert (np.abs(found.error) < 5.0 * found.sd).all()
    assert (found.ratio < 2.5).all()


@pytest.mark.parametrize(
    ("name", "most"),
    [("planar_2dof", 0), ("linear_delta", 0), ("a3_head", 0), ("a3_turning", 12)],
)
def test_joints_arrive_in_the_sense_of_the_path(name: str, most: int) -> None:
    """As the oracle's path says, between readings and where joints turn back at them.

    On the outer circle of `a3_turning` legs stand almost still for a third of a step
    around their turn: readings that far apart do not show on which side of it they are.
    """
    case = corrected_cases.CASES[name]()
    session, m = corrected_machines.planned(case), case.measurement
    y = m.readings([session.series], m.nominal)
    readings = EffectReadings(m, (session.series,), y, session.rows)
    (state,) = readings.problem(m.nominal).states
    read = session.series.index[:, 0]
    assert np.sum(state.motion_sign[read] != session.sense) <= most


@pytest.mark.slow
@pytest.mark.parametrize("name", ["planar_2dof", "a3_head"])
def test_bands_hold_on_many_machines(name: str) -> None:
    """Shares inside 95 % bands of 40 machines within three standard errors of it."""
    found = corrected_machines.coverage(corrected_cases.CASES[name](), 40, 1)
    off = np.abs(found.inside - 0.95)
    assert (off < 0.02 + 3.0 * found.inside_error).all()
    assert (np.abs(found.ratio - 1.0) < 0.07 + 3.0 * found.ratio_error).all()
