"""Parameters and effects together, on sessions with a ruler that may be bent."""

import dataclasses

import numpy as np
import pytest
from shipped_models import backlash, encoder_scale

from kernel.planar_session import ruler_session
from oed.effects import ExpectedColumns
from oed.estimation import Discrepancy, Estimate, identify
from oed.estimation.discrepancy import SampledEffects

EFFECTS = [backlash.effect, encoder_scale.effect]
SAG = 60e-6  # m: some twenty times the noise


@dataclasses.dataclass(frozen=True)
class Fit:
    """Fits with effects and without, and the true parameters."""

    with_effects: Estimate
    without: Estimate
    truth: np.ndarray

    def nees(self, estimate: Estimate) -> float:
        """Normalised squared error of the identifiable coordinates, per coordinate."""
        dual = estimate.coordinates.dual
        error = dual @ (self.truth - estimate.theta)
        covariance = dual @ estimate.covariance @ dual.T
        return float(error @ np.linalg.solve(covariance, error)) / len(error)

    @property
    def effects(self) -> SampledEffects:
        effects = self.with_effects.effects
        assert effects is not None
        return effects


def fitted(sag: float, seed: int, sizes: np.ndarray) -> Fit:
    problem = ruler_session(("rm2", "rm5"), sag, seed, interleaved=False)
    measurement, series, y = problem.measurement, problem.series, problem.y
    columns = ExpectedColumns.of(problem, EFFECTS)
    # the session draws its machine first
    root = measurement.prior_root()
    drawn = np.random.default_rng(seed).standard_normal(len(root))
    rng = np.random.default_rng(seed)
    discrepancy = columns.of_sizes(sizes).discrepancy
    both = identify(measurement, series, y, discrepancy=discrepancy, rng=rng)
    plain = identify(measurement, series, y, estimate_noise=True)
    return Fit(both, plain, measurement.nominal + root @ drawn)


@pytest.fixture(scope="module")
def straight() -> Fit:
    return fitted(0.0, 1, Discrepancy.SMALL)


@pytest.fixture(scope="module")
def bent() -> Fit:
    return fitted(SAG, 1, Discrepancy.LARGE)


def test_a_rigid_machine_is_hardly_less_certain(straight):
    free = straight.without.prior_sd > 0.0
    ratio = straight.with_effects.sd[free] / straight.without.sd[free]
    assert 0.9 < np.median(ratio) < 1.5
    assert straight.nees(straight.with_effects) < 3.0
    assert straight.effects.log_evidence < 1.0


def test_an_effect_of_no_known_form_is_allowed_for(bent):
    assert bent.effects.log_evidence > 3.0
    assert bent.nees(bent.with_effects) < 3.0


def test_changes_of_the_readings_are_those_of_the_sag(bent):
    """What the effects explain, but for what the geometry can do, is the sag."""
    explained = bent.effects.changes
    left = bent.with_effects.residuals - explained
    sigma = bent.with_effects.noise.sigma
    before = np.sqrt(np.mean(bent.with_effects.residuals**2))
    assert np.sqrt(np.mean(left**2)) < 0.5 * before
    assert np.abs(explained).max() > 0.2 * SAG
    assert np.all(sigma > 0.0)


def test_draws_belong_to_the_estimate(bent):
    estimate, effects = bent.with_effects, bent.effects
    sd = np.sqrt(np.diag(estimate.covariance))
    seen = estimate.shrinkage < 0.3
    seen &= estimate.prior_sd > 0.0
    error = (effects.theta.mean(axis=0) - estimate.theta)[seen] / sd[seen]
    assert np.abs(error).max() < 5.0 / np.sqrt(len(effects.theta))
    ratio = effects.theta.std(axis=0)[seen] / sd[seen]
    assert ratio == pytest.approx(np.ones_like(ratio), abs=0.25)
