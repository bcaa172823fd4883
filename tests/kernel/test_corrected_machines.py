"""Bands and rms of corrected machines of the oracles; `benchmarks/corrected.py` has more."""

import numpy as np
import pytest

from kernel import corrected_cases, corrected_machines


def test_a_planar_machine_is_as_far_off_as_predicted() -> None:
    found = corrected_machines.coverage(corrected_cases.planar_case(), 2, 3)
    assert (np.abs(found.error) < 5.0 * found.sd).all()
    assert (found.ratio < 2.5).all()


@pytest.mark.slow
def test_bands_hold_on_planar_machines() -> None:
    """Shares inside 95 % bands of 40 machines within three standard errors of it."""
    found = corrected_machines.coverage(corrected_cases.planar_case(), 40, 1)
    off = np.abs(found.inside - 0.95)
    assert (off < 0.02 + 3.0 * found.inside_error).all()
    assert (np.abs(found.ratio - 1.0) < 0.07 + 3.0 * found.ratio_error).all()
