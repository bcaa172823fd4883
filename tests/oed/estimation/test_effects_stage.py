"""Parameters and effects together, on sessions with a ruler that may be bent."""

import dataclasses

import numpy as np
import pytest
from scipy import special
from shipped_models import backlash, encoder_scale

from kernel.planar_session import ruler_session
from oed.effects import ExpectedColumns
from oed.estimation import Discrepancy, Estimate, discrepancy, identify
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


COUNT = 4000  #: draws; the standard error of a mean is 1.6 % of the standard deviation
INFORMATION = np.array([[4.0, 1.5], [1.5, 2.0]])


def exact_mixture(information, score, sizes):
    """Log evidence over no effects, mean and variance of the coefficients."""
    weights, means, squares = [], [], []
    for size in sizes:
        precision = information + np.eye(len(score)) / size**2
        covariance = np.linalg.inv(precision)
        mean = covariance @ score
        log_det = np.linalg.slogdet(precision * size**2)[1]
        weights.append(0.5 * score @ mean - 0.5 * log_det)
        means.append(mean)
        squares.append(np.diag(covariance) + mean**2)
    share = special.softmax(weights)
    mean = share @ np.array(means)
    variance = share @ np.array(squares) - mean**2
    evidence = float(special.logsumexp(weights)) - np.log(len(sizes))
    return evidence, mean, variance


@pytest.mark.parametrize(
    "sizes", [Discrepancy.SMALL, Discrepancy.LARGE], ids=["small", "large"]
)
@pytest.mark.parametrize("score", [(0.0, 0.0), (3.0, -1.0), (40.0, 10.0)])
def test_draws_are_those_of_the_mixture(score, sizes):
    evidence, mean, variance = exact_mixture(INFORMATION, np.array(score), sizes)
    rng = np.random.default_rng(1)
    drawn = discrepancy.sample_effects(INFORMATION, np.array(score), sizes, rng, COUNT)
    error = np.sqrt(variance / COUNT)
    assert np.abs((drawn.coefficients.mean(axis=0) - mean) / error).max() < 5.0
    # fourth moments of tails are large: the variance is known to some 10 %
    assert drawn.coefficients.var(axis=0) == pytest.approx(variance, rel=0.35)
    assert drawn.log_evidence == pytest.approx(evidence, abs=1e-9)


def test_effects_without_readings_keep_their_prior():
    rng = np.random.default_rng(2)
    drawn = discrepancy.sample_effects(
        np.zeros((1, 1)), np.zeros(1), Discrepancy.SMALL, rng, COUNT
    )
    shares = (drawn.size[:, None] == Discrepancy.SMALL).mean(axis=0)
    assert np.abs(shares - 1.0 / len(Discrepancy.SMALL)).max() < 5.0 * np.sqrt(
        0.25 / COUNT
    )
    assert drawn.log_evidence == pytest.approx(0.0, abs=1e-9)


def test_the_same_draws_whatever_the_rounding_of_the_readings():
    """Of 12 coefficients 5 readings show 5 directions; no draw may depend on rounding."""
    rng, size = np.random.default_rng(2), np.array([0.7])
    columns = rng.standard_normal((5, 12))
    information, score = columns.T @ columns, columns.T @ np.ones(5)
    rounding = rng.standard_normal((12, 12)) * 1e-14
    drawn = [
        discrepancy.sample_effects(
            each, score, size, np.random.default_rng(3), COUNT
        ).coefficients
        for each in (information, information + rounding + rounding.T)
    ]
    assert np.abs(drawn[0] - drawn[1]).max() < 1e-9
    covariance = np.linalg.inv(information + np.eye(12) / size**2)
    error = np.cov(drawn[0], rowvar=False) - covariance
    assert np.abs(error).max() < 6.0 * covariance.max() / np.sqrt(COUNT)
