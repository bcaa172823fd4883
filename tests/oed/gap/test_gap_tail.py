"""Tail probabilities of the chi-square distribution against their recurrence."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import special, stats

from oed.gap.forms.waves import log_tail


@pytest.mark.parametrize("rank", [1.0, 2.0, 5.0, 14.0])
def test_far_tails_do_not_underflow(rank):
    near = np.array([0.0, 1.0, 30.0, 500.0])
    assert_allclose(
        log_tail(near, rank), stats.chi2.logsf(near, rank), rtol=1e-9, atol=1e-12
    )
    # beyond, the tail's recurrence Q(a + 1, x) = Q(a, x) + x^a e^-x / Gamma(a + 1),
    # whose second term dominates
    x = 2000.0
    a, b = log_tail(np.array(2 * x), rank), log_tail(np.array(2 * x), rank + 2.0)
    added = rank / 2.0 * np.log(x) - x - float(special.gammaln(rank / 2.0 + 1.0))
    assert_allclose(b, np.logaddexp(a, added), rtol=1e-8)
    assert log_tail(np.array(3.0), 0.0) == 0.0
