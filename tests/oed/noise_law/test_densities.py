"""Densities of single errors: scores and information by other means."""

import itertools

import numpy as np
import pytest
from scipy import integrate, stats

from oed.noise_law import outliers


@pytest.mark.parametrize("shape", outliers.CANDIDATE_DENSITIES, ids=str)
def test_a_shape_is_a_density_with_its_score(shape):
    def density(e: float) -> float:
        return float(np.exp(shape.log_density(np.array(e))))

    whole, _ = integrate.quad(density, -np.inf, np.inf, limit=400)
    assert whole == pytest.approx(1.0, abs=1e-6)
    e, step = np.array([-40.0, -7.0, -2.5, -0.3, 0.2, 1.0, 3.0, 4.0, 12.0]), 1e-5
    slope = (shape.log_density(e + step) - shape.log_density(e - step)) / (2.0 * step)
    assert shape.weight(e) * e == pytest.approx(-slope, rel=1e-4, abs=1e-7)


def test_a_student_is_scipy_s_and_its_information_is_known():
    e = np.linspace(-20.0, 20.0, 41)
    for n in outliers.STUDENT_DOF:
        assert outliers.StudentT(n).log_density(e) == pytest.approx(
            stats.t(n).logpdf(e)
        )
        assert outliers.fisher_information(outliers.StudentT(n)) == pytest.approx(
            (n + 1.0) / (n + 3.0), abs=1e-4
        )


def test_few_strays_cost_next_to_no_information():
    """Less than if the noise were as large as its variance says."""
    shares, scales = outliers.OUTLIER_SHARES, outliers.OUTLIER_SCALES
    for share, wild in itertools.product(shares, scales):
        information = outliers.fisher_information(
            outliers.ContaminatedNormal(share, wild)
        )
        assert 1.0 / (1.0 - share + share * wild**2) < information < 1.0
        assert information > 1.0 - 4.0 * share


@pytest.mark.parametrize("shape", [
    outliers.StudentT(3.0), outliers.StudentT(6.0),
    outliers.ContaminatedNormal(0.02, 10.0),
], ids=str)  # fmt: skip
def test_a_pseudo_error_tells_of_a_small_change_what_the_error_does(shape):
    """Log likelihood ratios of a shift by a tenth, one reading in ten thousand."""
    rng = np.random.default_rng(5)
    if isinstance(shape, outliers.StudentT):
        e = rng.standard_t(shape.dof, 10_000)
    else:
        e = rng.standard_normal(10_000) * np.where(
            rng.random(10_000) < shape.outlier_share, shape.outlier_scale, 1.0
        )
    information = outliers.fisher_information(shape)
    normal = shape.weight(e) * e / information
    for shift in (-0.06, 0.03, 0.06):
        exact = (shape.log_density(e - shift) - shape.log_density(e)).sum()
        pseudo = 0.5 * information * (normal**2 - (normal - shift) ** 2).sum()
        assert pseudo == pytest.approx(exact, abs=1.5)
