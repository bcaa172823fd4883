"""Evidence against the dense multivariate Student t, over noise laws, and its tails."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import special, stats

from kernel.gap_lines import white_lines
from kernel.laws import (
    STATED_LAW,
    draw_noise,
    law_covariance,
    noise_covariance,
    noise_law,
    residual_covariance,
)
from oed.gap.data import evidence
from oed.gap.data import problem as problems
from oed.gap.data.columns import Block
from oed.gap.data.problem import GapProblem, Metric
from oed.gap.forms.waves import log_tail
from oed.noise import NoiseLaw


@pytest.fixture(scope="module")
def problem() -> GapProblem:
    return white_lines()


def _law(problem: GapProblem) -> NoiseLaw:
    return noise_law(0.8, 1.5, 4.0, 2.0, ratios=(1.0, 1.7))


def _grams(problem: GapProblem, law: NoiseLaw, columns: np.ndarray) -> evidence.Grams:
    return evidence.WhitenedColumns(problem, Metric(problem, law), columns).grams()


def test_metric_is_the_inverse_covariance(problem):
    law, rng = _law(problem), np.random.default_rng(1)
    u, v = rng.standard_normal((2, len(problem), 3))
    metric, dense = Metric(problem, law), residual_covariance(problem, law)
    np.testing.assert_allclose(
        metric.gram(u, v), u.T @ np.linalg.solve(dense, v), rtol=1e-7, atol=1e-8
    )
    assert metric.log_det == pytest.approx(np.linalg.slogdet(dense)[1], abs=1e-8)
    fitted = metric.fit(problem.residual)
    noise = noise_covariance(problem, law)
    inner = np.eye(problem.slopes.shape[1]) + problem.slopes.T @ np.linalg.solve(
        noise, problem.slopes
    )
    wanted = np.linalg.solve(
        inner, problem.slopes.T @ np.linalg.solve(noise, problem.residual)
    )
    np.testing.assert_allclose(fitted, wanted, rtol=1e-7, atol=1e-9)


def test_metric_of_some_readings(problem):
    law, rows = _law(problem), np.arange(3, len(problem), 2)
    dense = residual_covariance(problem, law)[np.ix_(rows, rows)]
    u = np.random.default_rng(2).standard_normal((len(problem), 2))
    exact = u[rows].T @ np.linalg.solve(dense, u[rows])
    np.testing.assert_allclose(Metric(problem, law, rows).gram(u, u), exact, rtol=1e-8)


def test_shared_reference_reading_is_in_the_law(problem):
    block = law_covariance(STATED_LAW, problem, problem.members[0])
    # RM 5 tells each reading against one other: half of its variance is shared by the
    # run, channel by channel
    np.testing.assert_allclose(np.diag(block), 1.0)
    assert block[0, 2] == pytest.approx(0.5)
    assert block[0, 1] == 0.0


def _student(problem: GapProblem, law: NoiseLaw, columns: np.ndarray) -> float:
    shape = residual_covariance(problem, law) + columns @ columns.T
    return float(
        stats.multivariate_t(
            loc=np.zeros(len(problem)),
            shape=shape * evidence.LEVEL_RATE / evidence.LEVEL_SHAPE,
            df=2.0 * evidence.LEVEL_SHAPE,
        ).logpdf(problem.residual)
    )


@pytest.mark.parametrize("size", [0.1, 1.0, 3.0])
def test_evidence_is_the_student_density(problem, size):
    law = _law(problem)
    columns = np.random.default_rng(3).standard_normal((len(problem), 5))
    assert evidence.log_evidence(
        problem, law, np.hstack([problem.slopes, size * columns])
    ) == pytest.approx(_student(problem, law, size * columns))
    none = np.zeros((len(problem), 0))
    assert evidence.log_evidence(problem, law, problem.slopes) == pytest.approx(
        _student(problem, law, none)
    )


def test_columns_one_after_the_other(problem):
    """Selecting step by step, and scoring what is left, is the evidence of all of them together."""
    law = _law(problem)
    columns = np.random.default_rng(4).standard_normal((len(problem), 6))
    grams = _grams(problem, law, columns)
    first, second, third = np.array([0, 3]), np.array([1]), np.array([2, 4, 5])
    selected = grams.select(first, 0.3).select(second, 1.0)
    log_evidence = (
        selected.base + selected.log_evidences([third], np.array([3.0]))[0, 0]
    )
    scaled = np.hstack(
        [0.3 * columns[:, first], columns[:, second], 3.0 * columns[:, third]]
    )
    assert log_evidence == pytest.approx(_student(problem, law, scaled))


def test_what_is_taken_out_stays_out(problem):
    law = _law(problem)
    columns = np.random.default_rng(5).standard_normal((len(problem), 4))
    columns[:, 3] = columns[:, 0] - 2.0 * columns[:, 1]
    projected = _grams(problem, law, columns).project_out(np.array([0, 1]))
    assert np.abs(projected.gram[3]).max() < 1e-8
    assert projected.gram[2, 2] > 1.0


def test_residual_does_not_depend_on_where_the_fit_ended(problem):
    """r - H dtheta / tolerance moves along H only, whose prior is in the metric."""
    measurement, series = problem.measurement, problem.series
    rng = np.random.default_rng(6)
    y = measurement.readings(
        series,
        measurement.nominal + 0.2 * measurement.tolerance * rng.standard_normal(8),
    )
    rows = problem.rows.drop_duplicates(["run", "order"]).reset_index(drop=True)
    near, far = (
        problems.assemble(measurement, series, rows, measurement.nominal + shift, y)
        for shift in (0.0, 0.02 * measurement.tolerance)
    )
    scale = np.abs(near.residual).max()
    assert np.abs(near.residual - far.residual).max() < 0.02 * scale


def _readings(problem: GapProblem, law: NoiseLaw, seed: int) -> GapProblem:
    """Readings of a machine without a gap under a law."""
    rng = np.random.default_rng(seed)
    y = problem.slopes @ rng.standard_normal(problem.slopes.shape[1])
    return problem.with_residual(y + draw_noise(problem, law, rng))


def test_evidence_over_laws_is_the_mean_over_the_prior():
    """By many laws drawn from the prior; the mixture serves both models at once."""
    lines = white_lines(3, runs=6, length=12)
    true = noise_law(2.0, 0.0, 1.0)
    problem, rng = _readings(lines, true, 5), np.random.default_rng(6)
    models = [np.zeros((len(problem), 0)), 0.8 * rng.standard_normal((len(problem), 2))]
    posteriors = [
        evidence.posterior(problem, evidence.compress(problem, [Block.of(columns)]))
        for columns in models
    ]
    mixture = evidence.mixture(problem, posteriors)
    drawn = rng.standard_normal((500, posteriors[0].draws.shape[1]))
    every = evidence._laws(problem, drawn)
    for model in posteriors:
        values = evidence.log_evidences(
            evidence.linear_model(problem, model.columns), every
        )
        exact = float(special.logsumexp(values)) - np.log(len(drawn))
        assert model.log_evidence == pytest.approx(exact, abs=0.25)
        terms = [
            evidence.log_evidence(problem, law, model.columns) + weight
            for law, weight in mixture
        ]
        assert special.logsumexp(terms) == pytest.approx(exact, abs=0.5)


@pytest.mark.parametrize(("repeat", "wander"), [(0.0, 0.0), (2.0, 0.0), (0.0, 3.0)])
def test_the_most_probable_law_is_near_the_true_one(repeat, wander):
    problem = white_lines(7, runs=12, length=40)
    true = noise_law(repeat, wander, 6.0)
    readings = _readings(problem, true, 8)
    mode = evidence.posterior(readings, evidence.compress(readings)).mode.law
    assert mode.scale[0, 0] == pytest.approx(1.0, abs=0.1)
    single, wandering = np.sqrt([1.0 - mode.correlated[0], mode.correlated[0]])
    # the reference reading of RM 5 is shared already: repeat comes on top
    assert mode.level[0] / single == pytest.approx(repeat, abs=0.5 + 0.4 * repeat)
    assert wandering / single == pytest.approx(wander, abs=0.5 + 0.3 * wander)
    if wander:
        assert 2.5 < mode.reach[0] < 15.0


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
