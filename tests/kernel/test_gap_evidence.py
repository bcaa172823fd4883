"""Evidence in closed form against the dense multivariate Student t; the metric against
a dense inverse.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import linalg, stats

from kernel.gap_lines import white_lines
from oed.gap.data import evidence, noise
from oed.gap.data import problem as problems
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.noise import estimate
from oed.noise.law import NoiseLaw


@pytest.fixture(scope="module")
def problem() -> GapProblem:
    return white_lines()


def _law(problem: GapProblem) -> NoiseLaw:
    variance = 1.0 + np.arange(len(problem)) % 3
    ratio = np.where(problem.channel == 0, 1.0, 1.7)
    return NoiseLaw(0.8, 1.5, 4.0, variance, channel_ratio=ratio, run_harmonic_sd=0.7)


def _dense(problem: GapProblem, law: NoiseLaw) -> np.ndarray:
    covariance = problem.slopes @ problem.slopes.T
    for k, members in enumerate(problem.members):
        covariance[np.ix_(members, members)] += law.block(problem, k)
    return covariance


def test_metric_is_the_inverse_covariance(problem: GapProblem) -> None:
    law, rng = _law(problem), np.random.default_rng(1)
    u, v = rng.standard_normal((2, len(problem), 3))
    metric, dense = Metric(problem, law), _dense(problem, law)
    np.testing.assert_allclose(
        metric.gram(u, v), u.T @ np.linalg.solve(dense, v), rtol=1e-8, atol=1e-10
    )
    assert metric.log_det == pytest.approx(np.linalg.slogdet(dense)[1], abs=1e-8)
    fitted = metric.fit(problem.residual)
    noise = dense - problem.slopes @ problem.slopes.T
    inner = np.eye(problem.slopes.shape[1]) + problem.slopes.T @ np.linalg.solve(
        noise, problem.slopes
    )
    wanted = np.linalg.solve(
        inner, problem.slopes.T @ np.linalg.solve(noise, problem.residual)
    )
    np.testing.assert_allclose(fitted, wanted, rtol=1e-7, atol=1e-9)


def test_metric_of_some_readings(problem: GapProblem) -> None:
    law, rows = _law(problem), np.arange(3, len(problem), 2)
    dense = _dense(problem, law)[np.ix_(rows, rows)]
    u = np.random.default_rng(2).standard_normal((len(problem), 2))
    np.testing.assert_allclose(
        Metric(problem, law, rows).gram(u, u),
        u[rows].T @ np.linalg.solve(dense, u[rows]),
        rtol=1e-8,
    )


def test_shared_reference_reading_is_in_the_law(problem: GapProblem) -> None:
    block = NoiseLaw(0.0, 0.0, 1.0, np.ones(len(problem))).block(problem, 0)
    # RM 5 tells each reading against one other: half of its variance is shared by the
    # run, channel by channel
    np.testing.assert_allclose(np.diag(block), 1.0)
    assert block[0, 2] == pytest.approx(0.5)
    assert block[0, 1] == 0.0


def _student(problem: GapProblem, law: NoiseLaw, columns: np.ndarray) -> float:
    shape = _dense(problem, law) + columns @ columns.T
    return float(
        stats.multivariate_t(
            loc=np.zeros(len(problem)),
            shape=shape * evidence.RATE / evidence.SHAPE,
            df=2.0 * evidence.SHAPE,
        ).logpdf(problem.residual)
    )


@pytest.mark.parametrize("size", [0.1, 1.0, 3.0])
def test_evidence_is_the_student_density(problem: GapProblem, size: float) -> None:
    law, columns = (
        _law(problem),
        np.random.default_rng(3).standard_normal((len(problem), 5)),
    )
    assert evidence.log_evidence(
        problem, law, np.hstack([problem.slopes, size * columns])
    ) == pytest.approx(_student(problem, law, size * columns))
    none = np.zeros((len(problem), 0))
    assert evidence.log_evidence(problem, law, problem.slopes) == pytest.approx(
        _student(problem, law, none)
    )


def test_columns_one_after_the_other(problem: GapProblem) -> None:
    """Selecting step by step, and scoring what is left, is the evidence of all of them
    together.
    """
    law, columns = (
        _law(problem),
        np.random.default_rng(4).standard_normal((len(problem), 6)),
    )
    grams = evidence.grams(problem, Metric(problem, law), columns)
    first, second, third = np.array([0, 3]), np.array([1]), np.array([2, 4, 5])
    selected = grams.select(first, 0.3).select(second, 1.0)
    log_evidence = (
        selected.base + selected.log_evidences([third], np.array([3.0]))[0, 0]
    )
    scaled = np.hstack(
        [0.3 * columns[:, first], columns[:, second], 3.0 * columns[:, third]]
    )
    assert log_evidence == pytest.approx(_student(problem, law, scaled))


def test_what_is_taken_out_stays_out(problem: GapProblem) -> None:
    law = _law(problem)
    columns = np.random.default_rng(5).standard_normal((len(problem), 4))
    columns[:, 3] = columns[:, 0] - 2.0 * columns[:, 1]
    projected = evidence.grams(problem, Metric(problem, law), columns).project_out(
        np.array([0, 1])
    )
    assert np.abs(projected.gram[3]).max() < 1e-8
    assert projected.gram[2, 2] > 1.0


def test_residual_does_not_depend_on_where_the_fit_ended(problem: GapProblem) -> None:
    """r - H dtheta / tolerance moves along H only, whose prior variance is in the
    metric: to first order nothing.
    """
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


@pytest.mark.parametrize(
    ("repeat", "wander", "sway"),
    [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, 0.0, 2.0)],
)
def test_noise_law_is_found(repeat: float, wander: float, sway: float) -> None:
    problem = white_lines(7, runs=12, length=40)
    true = NoiseLaw(repeat, wander, 6.0, np.ones(len(problem)), run_harmonic_sd=sway)
    rng = np.random.default_rng(8)
    y = problem.slopes @ rng.standard_normal(problem.slopes.shape[1])
    for k, members in enumerate(problem.members):
        y[members] += linalg.cholesky(
            true.block(problem, k), lower=True
        ) @ rng.standard_normal(len(members))
    fitted, _ = noise.fit_law(problem.with_residual(y), np.zeros((len(problem), 0)))
    # the reference reading of RM 5 is shared already: repeat comes on top
    assert fitted.run_sd == pytest.approx(repeat, abs=0.4 + 0.4 * repeat)
    assert fitted.ar1_sd == pytest.approx(wander, abs=0.4 + 0.2 * wander)
    assert fitted.run_harmonic_sd == pytest.approx(sway, abs=0.35 + 0.3 * sway)
    if wander:
        assert 2.5 < fitted.ar1_length < 15.0


def test_prior_about_a_law_is_its_volume() -> None:
    """Of costs that are normal along two coordinates and flat along two: their standard
    deviations and the widths that there are; a law beside its bound has half.
    """
    spread, wide = np.array([0.12, 0.5]), 4.5 - 0.4

    def cost(v: np.ndarray) -> float:
        return float(0.5 * (((v[:2] - [0.3, -1.0]) / spread) ** 2).sum())

    log_volume = estimate._about(cost, np.array([0.3, -1.0, 2.0, -3.0]), 0.0)
    volume = np.prod(spread * np.sqrt(2.0 * np.pi)) * wide * 13.0
    assert log_volume == pytest.approx(np.log(volume), abs=0.25)
    half = estimate._about(
        lambda v: cost(v) + (1e9 if v[0] < 0.3 else 0.0),
        np.array([0.3, -1.0, 2.0, -3.0]),
        0.0,
    )
    assert half == pytest.approx(log_volume - np.log(2.0), abs=0.1)


@pytest.mark.parametrize("shift", [0.0, 3.0])
def test_a_law_that_has_to_be_tuned_is_less_likely_than_one_that_holds_anyhow(
    shift: float,
) -> None:
    """Runs that differ: how much is told by the readings to within a fraction, and the
    prior there is little. White ones: whatever is small does, and the quiet law has as
    much of the prior as the one that is found.
    """
    problem, rng = white_lines(7, runs=12, length=40), np.random.default_rng(15)
    y = rng.standard_normal(len(problem))
    for members in problem.members:
        y[members] += shift * rng.standard_normal()
    law, prior = noise.fit_law(problem.with_residual(y), np.zeros((len(problem), 0)))
    quiet, most = estimate.without_run_noise(law)
    assert (law.run_sd > 0.5) == bool(shift)
    assert quiet.run_sd < 0.05
    assert most - prior == pytest.approx(2.5 if shift else 0.3, abs=1.0)


def test_a_law_in_words_tells_the_first_harmonic(problem: GapProblem) -> None:
    law = NoiseLaw(0.0, 0.0, 1.0, np.ones(len(problem)), level=2.0, run_harmonic_sd=0.8)
    sentences = estimate.describe(problem, law)
    assert [w for w in sentences if "first harmonic" in w] == [
        "a run's first harmonic repeats to 1.6 times the stated noise"
    ]
    assert len(sentences) == 2
    assert (
        len(estimate.describe(problem, dataclasses.replace(law, run_harmonic_sd=0.1)))
        == 1
    )
