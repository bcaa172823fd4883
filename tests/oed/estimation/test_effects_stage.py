"""Parameters and effects together, and correlated tolerances, against exact mixtures."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy import special
from shipped_models import backlash, encoder_scale

from kernel import a3_plans
from kernel.planar_session import ruler_session
from oed import checks, identifiability
from oed.accuracy import BudgetModel
from oed.checks import fit as check_fit
from oed.effects import ExpectedColumns
from oed.estimation import (
    Discrepancy,
    Estimate,
    discrepancy,
    identification,
    identify,
    predict_runs,
)
from oed.estimation.discrepancy import SampledEffects
from oed.gap import assemble
from oed.measurement import Measurement, Series, draw_parameters, draw_readings
from oed.model import CommonTolerance
from oed.posterior import sample

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


@pytest.fixture(scope="module")
def correlated() -> Measurement:
    """The A3 head with legs of one batch, and joints of one jig; errors a tenth."""
    machine = a3_plans.machine
    small = [
        dataclasses.replace(p, tolerance=0.1 * p.tolerance) for p in machine.parameters
    ]
    free = [p.name for p in small if p.name not in machine.frame]
    groups = (
        CommonTolerance(tuple(n for n in free if n.startswith("dq")), 0.9),
        CommonTolerance(tuple(n for n in free if n.startswith("da1")), -0.3),
    )
    machine = machine.with_parameters(small)
    return a3_plans.measurement(of=dataclasses.replace(machine, correlated=groups))


@pytest.fixture(scope="module")
def series(correlated: Measurement) -> Series:
    plan = a3_plans.circles(correlated, 12).reading_commands()
    return correlated.series("cup", plan, ["low"] * 12 + ["high"] * 12)


def prior(m: Measurement) -> np.ndarray:
    """Prior covariance, entry by entry from the groups."""
    covariance = np.diag(m.tolerance**2)
    for group in m.machine.correlated:
        for a in group.names:
            for b in group.names:
                i, j = m.names.index(a), m.names.index(b)
                if i != j:
                    product = m.tolerance[i] * m.tolerance[j]
                    covariance[i, j] = group.correlation * product
    return covariance


def conjugate(m, series, y, at):
    """Mean and covariance of the linear Gaussian model at theta `at`."""
    h = m.jacobian([series], at)
    marginal = h @ prior(m) @ h.T + np.diag(m.sigma([series]) ** 2)
    gain = np.linalg.solve(marginal, h @ prior(m)).T
    change = y - m.readings([series], at) + h @ (at - m.nominal)
    return m.nominal + gain @ change, prior(m) - gain @ h @ prior(m)


@pytest.fixture(scope="module")
def y(correlated: Measurement, series: Series) -> np.ndarray:
    rng = np.random.default_rng(2)
    truth = draw_parameters(correlated, rng)
    return draw_readings(correlated, [series], truth, rng)


def test_the_fit_is_that_of_the_closed_form(correlated, series, y):
    m = correlated
    estimate = identify(m, [series], y)
    mean, covariance = conjugate(m, series, y, estimate.theta)
    free = m.free
    sd = np.sqrt(np.diag(covariance)[free])
    assert estimate.sd[free] == pytest.approx(sd, rel=1e-5)
    off = (estimate.covariance - covariance)[np.ix_(free, free)]
    assert np.abs(off / np.outer(sd, sd)).max() < 1e-5
    # lost directions stay at nominal by construction, as they are a priori
    assert np.abs((estimate.theta - mean)[free] / sd).max() < 2e-3
    independent = identify(_independent(m), [series], y)
    assert np.abs(independent.sd[free] / sd - 1.0).max() > 0.2
    batch = identification.fit_machines(m, [series], y[None])
    assert np.abs((batch[0] - estimate.theta)[free] / sd).max() < 1e-3


def _independent(m: Measurement) -> Measurement:
    return a3_plans.measurement(of=dataclasses.replace(m.machine, correlated=()))


def test_machines_are_drawn_with_the_correlation(correlated):
    m = correlated
    drawn = draw_parameters(m, np.random.default_rng(3), 20_000)
    free, scale = m.free, m.tolerance[m.free]
    standard = (drawn - m.nominal)[:, free] / scale
    expected = prior(m)[np.ix_(free, free)] / np.outer(scale, scale)
    assert np.abs(np.cov(standard.T) - expected).max() < 0.05


def test_designs_and_budgets_add_the_prior_precision(correlated, series):
    m = correlated
    _, covariance = conjugate(m, series, m.readings([series], m.nominal), m.nominal)
    sd = np.sqrt(np.diag(covariance))

    def off(found: np.ndarray) -> float:
        """Largest difference of the machine's free parameters, in their sd."""
        free = np.flatnonzero(m.free[: len(found)])
        difference = (found - covariance[: len(found), : len(found)])[
            np.ix_(free, free)
        ]
        return float(np.abs(difference / np.outer(sd[free], sd[free])).max())

    assert off(identifiability.parameter_covariance(m, [series], m.nominal)) < 1e-4
    rows = identifiability.scaled(m, [series], m.nominal, "tolerance")[:, m.free]
    total = identifiability.prior_information(m) + rows.T @ rows
    design = np.zeros_like(covariance)
    scale = m.tolerance[m.free]
    design[np.ix_(m.free, m.free)] = np.linalg.inv(total) * np.outer(scale, scale)
    assert off(design) < 1e-4
    budget = BudgetModel.of(m, [series], m.nominal)
    assert off(budget.covariance()) < 1e-4
    assert off(np.sum([part.covariance for part in budget.parts()], axis=0)) < 1e-4


def test_checks_take_the_correlation(correlated, series, y):
    """Penalised sum of squares, and each run as the others predict it."""
    m = correlated
    solution = check_fit.fit(checks.session_readings(m, [series], y))
    h = m.jacobian([series], solution.theta)
    sigma = m.sigma([series])
    marginal = np.diag(sigma**2) + h @ prior(m) @ h.T
    change = y - m.readings([series], solution.theta) + h @ (solution.theta - m.nominal)
    penalised = change @ np.linalg.solve(marginal, change)
    assert solution.penalised == pytest.approx(penalised, rel=1e-3)
    estimate = identify(m, [series], y)
    runs = predict_runs(m, [series], estimate)
    first, second = np.arange(12), np.arange(12, 24)
    gain = marginal[np.ix_(first, second)] @ np.linalg.inv(
        marginal[np.ix_(second, second)]
    )
    rest = marginal[np.ix_(first, first)] - gain @ marginal[np.ix_(second, first)]
    error = change[first] - gain @ change[second]
    assert runs.runs[0].chi2 == pytest.approx(
        error @ np.linalg.solve(rest, error), rel=0.02
    )


def test_the_sampler_has_the_correlation(correlated, series, y):
    m = correlated
    estimate = identify(m, [series], y)
    drawn = sample(
        m, [series], y, estimate, np.random.default_rng(4), ess=1500.0
    ).pooled
    spread = np.cov(drawn.T)
    sd = np.sqrt(np.diag(estimate.covariance))
    assert np.sqrt(np.diag(spread)) == pytest.approx(sd, rel=0.12)
    legs = [m.names.index(f"dq{k}") for k in (1, 2, 3)]
    total = estimate.covariance[np.ix_(legs, legs)].sum()
    assert spread[np.ix_(legs, legs)].sum() == pytest.approx(total, rel=0.2)


def test_the_diagnosis_lets_correlated_parameters_absorb(correlated, series):
    m = correlated
    rows = {"setup": "cup", "run": series.run, "order": np.tile(np.arange(12), 2)}
    problem = assemble(m, [series], pd.DataFrame(rows))
    h = m.jacobian([series], m.nominal)
    absorbed = (
        problem.slopes @ problem.slopes.T * np.outer(problem.sigma, problem.sigma)
    )
    exact = h @ prior(m) @ h.T
    assert np.abs(absorbed - exact).max() < 1e-9 * np.abs(exact).max()
