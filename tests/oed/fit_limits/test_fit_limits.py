"""Residuals beside the distribution that they have where the stated noise is right."""

import pytest
from scipy import stats

from oed.fit_limits import ALARM_PROBABILITY, chi2_is_large, noise_ratio


def test_chi2_is_large_by_its_law():
    limit = stats.chi2.isf(ALARM_PROBABILITY, 30)
    assert not chi2_is_large(0.999 * limit, 30)
    assert chi2_is_large(1.001 * limit, 30)
    assert not chi2_is_large(1e6, 0.5)
    assert noise_ratio(80.0, 20.0) == pytest.approx(2.0)
    assert noise_ratio(80.0, 0.9) is None
    assert noise_ratio(None, 20.0) is None
