"""Evidence in closed form against the dense multivariate Student t; the metric against a dense inverse."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy import linalg, stats

from oed.gap import evidence, scatter
from oed.gap import problem as problems
from oed.gap.law import Law, Metric
from oed.gap.problem import Problem
from oed.instrument import mount
from oed.measurement import Measurement
from pkm_models.instruments import relative
from pkm_models.machines import planar_2dof


def _problem(seed: int = 0, runs: int = 4, length: int = 15) -> Problem:
    """A planar machine read along lines by RM 5: two channels, whose reference reading is shared."""
    measurement = Measurement(planar_2dof.machine, [mount(relative.rm5, "lines")])
    y = np.linspace(-1.4, 1.4, length)
    command = np.vstack(
        [np.column_stack([y if k % 2 == 0 else y[::-1], np.full(length, 0.4 * k)]) for k in range(runs)]
    )
    labels = [f"line {k}" for k in range(runs) for _ in range(length)]
    series = measurement.series("lines", command, labels)
    covariates = pd.DataFrame(
        {
            "setup": "lines",
            "run": series.run,
            "order": np.tile(np.arange(2, length + 1), runs),
            "time": 40.0 * np.arange(len(series)),
        }
    )
    made = problems.planned(measurement, (series,), covariates)
    return made.with_residual(np.random.default_rng(seed).standard_normal(len(made)))


@pytest.fixture(scope="module")
def problem() -> Problem:
    return _problem()


def _law(problem: Problem) -> Law:
    variance = 1.0 + np.arange(len(problem)) % 3
    ratio = np.where(problem.group == 0, 1.0, 1.7)
    return Law(0.8, 1.5, 4.0, variance, ratio=ratio, sway=0.7)


def _dense(problem: Problem, law: Law) -> np.ndarray:
    covariance = problem.slopes @ problem.slopes.T
    for k, members in enumerate(problem.blocks):
        covariance[np.ix_(members, members)] += law.block(problem, k)
    return covariance


def test_metric_is_the_inverse_covariance(problem: Problem) -> None:
    law, rng = _law(problem), np.random.default_rng(1)
    u, v = rng.standard_normal((2, len(problem), 3))
    metric, dense = Metric(problem, law), _dense(problem, law)
    np.testing.assert_allclose(metric.gram(u, v), u.T @ np.linalg.solve(dense, v), rtol=1e-8, atol=1e-10)
    assert metric.log_det == pytest.approx(np.linalg.slogdet(dense)[1], abs=1e-8)
    fitted = metric.fitted(problem.residual)
    noise = dense - problem.slopes @ problem.slopes.T
    inner = np.eye(problem.slopes.shape[1]) + problem.slopes.T @ np.linalg.solve(noise, problem.slopes)
    wanted = np.linalg.solve(inner, problem.slopes.T @ np.linalg.solve(noise, problem.residual))
    np.testing.assert_allclose(fitted, wanted, rtol=1e-7, atol=1e-9)


def test_metric_of_some_readings(problem: Problem) -> None:
    law, rows = _law(problem), np.arange(3, len(problem), 2)
    dense = _dense(problem, law)[np.ix_(rows, rows)]
    u = np.random.default_rng(2).standard_normal((len(problem), 2))
    np.testing.assert_allclose(
        Metric(problem, law, rows).gram(u, u), u[rows].T @ np.linalg.solve(dense, u[rows]), rtol=1e-8
    )


def test_shared_reference_reading_is_in_the_law(problem: Problem) -> None:
    block = Law(0.0, 0.0, 1.0, np.ones(len(problem))).block(problem, 0)
    # RM 5 tells each reading against one other: half of its variance is shared by the run, channel by channel
    np.testing.assert_allclose(np.diag(block), 1.0)
    assert block[0, 2] == pytest.approx(0.5)
    assert block[0, 1] == 0.0


def _student(problem: Problem, law: Law, columns: np.ndarray) -> float:
    shape = _dense(problem, law) + columns @ columns.T
    return float(
        stats.multivariate_t(
            loc=np.zeros(len(problem)), shape=shape * evidence.RATE / evidence.SHAPE, df=2.0 * evidence.SHAPE
        ).logpdf(problem.residual)
    )


@pytest.mark.parametrize("size", [0.1, 1.0, 3.0])
def test_evidence_is_the_student_density(problem: Problem, size: float) -> None:
    law, columns = _law(problem), np.random.default_rng(3).standard_normal((len(problem), 5))
    assert evidence.log_evidence(problem, law, np.hstack([problem.slopes, size * columns])) == pytest.approx(
        _student(problem, law, size * columns)
    )
    none = np.zeros((len(problem), 0))
    assert evidence.log_evidence(problem, law, problem.slopes) == pytest.approx(_student(problem, law, none))


def test_columns_one_after_the_other(problem: Problem) -> None:
    """Selecting step by step, and scoring what is left, is the evidence of all of them together."""
    law, columns = _law(problem), np.random.default_rng(4).standard_normal((len(problem), 6))
    found = evidence.grams(problem, Metric(problem, law), columns)
    first, second, third = np.array([0, 3]), np.array([1]), np.array([2, 4, 5])
    left = found.given(first, 0.3).given(second, 1.0)
    told = left.base + left.log_evidences([third], np.array([3.0]))[0, 0]
    scaled = np.hstack([0.3 * columns[:, first], columns[:, second], 3.0 * columns[:, third]])
    assert told == pytest.approx(_student(problem, law, scaled))


def test_what_is_taken_out_stays_out(problem: Problem) -> None:
    law = _law(problem)
    columns = np.random.default_rng(5).standard_normal((len(problem), 4))
    columns[:, 3] = columns[:, 0] - 2.0 * columns[:, 1]
    left = evidence.grams(problem, Metric(problem, law), columns).without(np.array([0, 1]))
    assert np.abs(left.gram[3]).max() < 1e-8
    assert left.gram[2, 2] > 1.0


def test_residual_does_not_depend_on_where_the_fit_ended(problem: Problem) -> None:
    """r - H dtheta / tolerance moves along H only, whose prior variance is in the metric: to first order nothing."""
    measurement, series = problem.measurement, problem.series
    rng = np.random.default_rng(6)
    y = measurement.readings(series, measurement.nominal + 0.2 * measurement.tolerance * rng.standard_normal(8))
    rows = problem.rows.drop_duplicates(["run", "order"]).reset_index(drop=True)
    near, far = (
        problems.planned(measurement, series, rows, measurement.nominal + shift, y)
        for shift in (0.0, 0.02 * measurement.tolerance)
    )
    scale = np.abs(near.residual).max()
    assert np.abs(near.residual - far.residual).max() < 0.02 * scale


@pytest.mark.parametrize(
    ("repeat", "wander", "sway"), [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, 0.0, 2.0)]
)
def test_noise_law_is_found(repeat: float, wander: float, sway: float) -> None:
    problem = _problem(7, runs=12, length=40)
    true = Law(repeat, wander, 6.0, np.ones(len(problem)), sway=sway)
    rng = np.random.default_rng(8)
    y = problem.slopes @ rng.standard_normal(problem.slopes.shape[1])
    for k, members in enumerate(problem.blocks):
        y[members] += linalg.cholesky(true.block(problem, k), lower=True) @ rng.standard_normal(len(members))
    found, _ = scatter.fit(problem.with_residual(y), np.zeros((len(problem), 0)))
    # the reference reading of RM 5 is shared already: repeat comes on top
    assert found.repeat == pytest.approx(repeat, abs=0.4 + 0.4 * repeat)
    assert found.wander == pytest.approx(wander, abs=0.4 + 0.2 * wander)
    assert found.sway == pytest.approx(sway, abs=0.35 + 0.3 * sway)
    if wander:
        assert 2.5 < found.reach < 15.0


def test_prior_about_a_law_is_its_volume() -> None:
    """Of costs that are normal along two coordinates and flat along two: their standard deviations and the widths that
    there are; a law beside its bound has half."""
    spread, wide = np.array([0.12, 0.5]), 4.5 - 0.4

    def cost(v: np.ndarray) -> float:
        return float(0.5 * (((v[:2] - [0.3, -1.0]) / spread) ** 2).sum())

    told = scatter._about(cost, np.array([0.3, -1.0, 2.0, -3.0]), 0.0)
    volume = np.prod(spread * np.sqrt(2.0 * np.pi)) * wide * 13.0
    assert told == pytest.approx(np.log(volume), abs=0.25)
    half = scatter._about(lambda v: cost(v) + (1e9 if v[0] < 0.3 else 0.0), np.array([0.3, -1.0, 2.0, -3.0]), 0.0)
    assert half == pytest.approx(told - np.log(2.0), abs=0.1)


@pytest.mark.parametrize("shift", [0.0, 3.0])
def test_a_law_that_has_to_be_tuned_is_less_likely_than_one_that_holds_anyhow(shift: float) -> None:
    """Runs that differ: how much is told by the readings to within a fraction, and the prior there is little. White
    ones: whatever is small does, and the quiet law has as much of the prior as the one that is found."""
    problem, rng = _problem(7, runs=12, length=40), np.random.default_rng(15)
    y = rng.standard_normal(len(problem))
    for members in problem.blocks:
        y[members] += shift * rng.standard_normal()
    law, prior = scatter.fit(problem.with_residual(y), np.zeros((len(problem), 0)))
    quiet, most = scatter.quiet(law)
    assert (law.repeat > 0.5) == bool(shift)
    assert quiet.repeat < 0.05
    assert most - prior == pytest.approx(2.5 if shift else 0.3, abs=1.0)


def test_outliers_are_found_and_no_others() -> None:
    problem = _problem(9, runs=10, length=40)
    rng = np.random.default_rng(10)
    y = rng.standard_normal(len(problem))
    none = np.zeros((len(problem), 0))
    assert np.all(scatter.robust(problem.with_residual(y), none)[0].variance == 1.0)
    far = rng.choice(len(problem), 12, replace=False)
    y[far] += 12.0 * rng.choice([-1.0, 1.0], 12)
    law, _ = scatter.robust(problem.with_residual(y), none)
    assert np.isfinite(law.tails)
    assert np.median(law.variance[far]) > 8.0 * np.median(np.delete(law.variance, far))
    clean = dataclasses.replace(law, variance=np.ones(len(problem)), tails=np.inf)
    told = [evidence.log_evidence(problem.with_residual(y), v, problem.slopes) for v in (law, clean)]
    assert told[0] > told[1]


@pytest.mark.parametrize("degrees", [3.0, 6.0])
def test_variances_of_outliers_have_the_prior_that_makes_a_student_t(problem: Problem, degrees: float) -> None:
    """Variances at their likeliest under errors e make the normal density, with their prior, a t's: but for a constant
    for each reading that is far off, against one just not so, and the choice among the numbers of degrees."""
    errors = np.array([1.2, 2.0, 5.0, 9.0, 30.0])
    variance = np.ones(len(problem))
    variance[: len(errors)] = (degrees + errors**2) / (degrees + 1.0)
    law = Law(0.0, 0.0, 1.0, variance, tails=degrees)
    normal = stats.norm.logpdf(errors, scale=np.sqrt(variance[: len(errors)])).sum()
    student = stats.t(degrees)
    just = len(errors) * (student.logpdf(1.0) - stats.norm.logpdf(1.0))
    wanted = student.logpdf(errors).sum() - normal - just - np.log(4.0)
    assert scatter.outliers(law) == pytest.approx(wanted)
    assert scatter.outliers(dataclasses.replace(law, tails=np.inf)) == 0.0


def test_a_law_in_words_tells_the_first_harmonic(problem: Problem) -> None:
    law = Law(0.0, 0.0, 1.0, np.ones(len(problem)), level=2.0, sway=0.8)
    told = scatter.words(problem, law)
    assert [w for w in told if "first harmonic" in w] == [
        "a run's first harmonic repeats to 1.6 times the stated noise"
    ]
    assert len(told) == 2
    assert len(scatter.words(problem, dataclasses.replace(law, sway=0.1))) == 1


def _bumpy(problem: Problem, count: int) -> np.ndarray:
    """Columns (N, runs * channels * count), each `count` cosines of falling size in one channel of one run."""
    made = []
    for members in problem.blocks:
        for group in np.unique(problem.group):
            mine = members[problem.group[members] == group]
            at = (np.arange(len(mine)) + 0.5) / len(mine)
            for k in range(count):
                made.append(np.zeros(len(problem)))
                made[-1][mine] = np.cos(np.pi * k * at) / (1.0 + k / 4.0)
    return np.column_stack(made)


def test_outliers_are_found_beside_a_model_of_many_columns() -> None:
    """Its columns give way to an outlier by two thirds: readings far off are still told by the others."""
    problem = _problem(13, runs=5, length=31)
    columns, rng = _bumpy(problem, 18), np.random.default_rng(14)
    assert columns.shape[1] == 0.6 * len(problem)
    gap = columns @ rng.standard_normal(columns.shape[1])
    y = gap + rng.standard_normal(len(problem))
    clean = scatter.robust(problem.with_residual(y), columns)[0]
    assert not np.isfinite(clean.tails)
    assert np.all(clean.variance == 1.0)
    far = rng.choice(len(problem), 9, replace=False)
    y[far] += 15.0 * rng.choice([-1.0, 1.0], len(far))
    law, _ = scatter.robust(problem.with_residual(y), columns)
    assert np.isfinite(law.tails)
    assert law.variance[far].min() > 15.0
    assert np.quantile(np.delete(law.variance, far), 0.95) < 5.0
