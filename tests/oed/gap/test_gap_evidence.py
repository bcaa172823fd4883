"""Evidence against the dense multivariate Student t; the metric against an inverse."""

import numpy as np
import pytest
from scipy import stats

from kernel.dense_noise import law_covariance, noise_covariance, residual_covariance
from kernel.gap_lines import white_lines
from kernel.laws import STATED_LAW, noise_law
from oed.gap.data import evidence
from oed.gap.data import problem as problems
from oed.gap.data.problem import GapProblem, Metric
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
