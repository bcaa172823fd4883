"""Readings far off: densities, scores and information by other means; what is left
tells as much as theory allows.
"""

import dataclasses

import numpy as np
import pytest

from kernel.dense_noise import law_covariance
from kernel.gap_lines import EFFECTS, SLIP, planted, readings, white_lines
from kernel.laws import STATED_LAW, noise_law
from oed.gap import procedure as diagnosing
from oed.gap.cause.searches import detect_outliers
from oed.gap.data.problem import GapProblem


def alone(problem: GapProblem) -> GapProblem:
    """The same readings, each independent of the others, with nothing to absorb."""
    free, size = np.zeros((len(problem), 1)), len(problem)
    structure = dataclasses.replace(
        problem.structure,
        unit=np.ones(size),
        decouple=None,
        columns=np.zeros((size, 0)),
        kinds=np.zeros(0, dtype=np.intp),
    )
    return dataclasses.replace(problem, structure=structure, slopes=free)


def test_normal_readings_have_no_strays() -> None:
    """In at most one set of twelve: the likeliest shape must be worth a factor of
    twenty.
    """
    detected = [
        detect_outliers(p, STATED_LAW, p.slopes)
        for p in (white_lines(k, 5, 31) for k in range(12))
    ]
    assert sum(f is not None for f in detected) <= 1


def test_strays_are_told_and_no_others() -> None:
    problem = white_lines(9, runs=10, length=40)
    rng = np.random.default_rng(10)
    far = rng.choice(len(problem), 12, replace=False)
    y = problem.residual.copy()
    y[far] += 12.0 * rng.choice([-1.0, 1.0], 12)
    detected = detect_outliers(problem.with_residual(y), STATED_LAW, problem.slopes)
    ordinary = np.delete(np.arange(len(problem)), far)
    assert np.abs(detected.pseudo_residual - y)[far].min() > 5.0
    assert np.sqrt(np.mean((detected.pseudo_residual - y)[ordinary] ** 2)) < 0.3


@pytest.mark.parametrize(
    ("degrees", "seed"), [(3.0, 1), pytest.param(4.0, 2, marks=pytest.mark.slow)]
)
def test_what_is_left_tells_as_much_as_heavy_tails_allow(
    degrees: float, seed: int
) -> None:
    """The mean of N pseudo-errors scatters by 1 / (N I), as no other estimate can
    better; that of the readings scatters by their variance.
    """
    problem = alone(white_lines(0, runs=6, length=35))
    rng, means, plain_means = np.random.default_rng(seed), [], []
    for _ in range(150):
        y = rng.standard_t(degrees, len(problem))
        detected = detect_outliers(problem.with_residual(y), STATED_LAW, problem.slopes)
        means.append(np.mean(y if detected is None else detected.pseudo_residual))
        plain_means.append(np.mean(y))
    least = (degrees + 3.0) / (degrees + 1.0)
    assert np.var(means) * len(problem) == pytest.approx(least, rel=0.3)
    assert np.var(plain_means) > 1.15 * np.var(means)


def test_strays_are_told_beside_a_model_of_many_columns() -> None:
    """Its columns give way to a stray by two thirds: it is still told by the others."""
    problem = white_lines(13, runs=5, length=31)
    columns, rng = _bumpy(problem, 18), np.random.default_rng(14)
    assert columns.shape[1] == 0.6 * len(problem)
    y = columns @ rng.standard_normal(columns.shape[1]) + rng.standard_normal(
        len(problem)
    )
    wide = np.hstack([problem.slopes, columns])
    assert detect_outliers(problem.with_residual(y), STATED_LAW, wide) is None
    far = rng.choice(len(problem), 9, replace=False)
    y[far] += 15.0 * rng.choice([-1.0, 1.0], len(far))
    detected = detect_outliers(problem.with_residual(y), STATED_LAW, wide)
    moved = np.abs(detected.pseudo_residual - y)
    assert moved[far].min() > 5.0
    assert np.quantile(np.delete(moved, far), 0.95) < 1.0


def test_a_stray_does_not_spoil_its_neighbours() -> None:
    """In an error that is carried along, a reading is predicted from those beside it,
    be they far off.
    """
    problem = readings(3)
    law = noise_law(ar1_sd=2.0, ar1_length=8.0)
    rng = np.random.default_rng(4)
    y = np.zeros(len(problem))
    for k, members in enumerate(problem.members):
        y[members] = np.linalg.cholesky(
            law_covariance(law, problem, problem.members[k])
        ) @ rng.standard_normal(len(members))
    far = np.arange(20, len(problem), 60)
    spoilt = y.copy()
    spoilt[far] += 20.0
    detected = detect_outliers(problem.with_residual(spoilt), law, problem.slopes)
    neighbours = np.concatenate([far - 2, far + 2])  # two channels are read by turns
    assert np.abs(detected.pseudo_residual - y)[neighbours].max() < 1.0
    assert np.abs(detected.pseudo_residual - y)[far].max() < 5.0


@pytest.mark.slow
def test_an_effect_is_found_in_heavy_tails_and_none_without_it() -> None:
    """With 2 % of the readings ten times as far off; the law tells of them."""
    rng = np.random.default_rng(21)
    calm = readings(21)
    wild = np.where(
        rng.random(len(calm)) < 0.02, 10.0 * rng.standard_normal(len(calm)), 0.0
    )
    healthy = calm.with_residual(calm.residual + wild)
    without = diagnosing.diagnose(healthy, EFFECTS, np.random.default_rng(0))
    assert without.verdict == "none"
    assert without.law.outlier_share > 0.0 or np.isfinite(without.law.student_dof)
    assert any("far off" in words for words in without.noise_words)
    assert without.law.level == pytest.approx(1.0, abs=0.2)
    ill = planted(healthy, SLIP, {"leg 1": 1.0})
    with_effect = diagnosing.diagnose(ill, EFFECTS, np.random.default_rng(0))
    assert with_effect.answers[0].effects == ("slip",)
    assert np.allclose(
        with_effect.problem.residual, ill.residual
    )  # shown as they were read


def test_a_law_in_words_tells_how_many_are_far_off() -> None:
    law = STATED_LAW
    assert not any("far off" in words for words in law.describe())
    few = dataclasses.replace(law, outlier_share=0.02).describe()
    assert few[-1] == "about 2 % of the readings are far off"
    assert (
        "Student t with 4 degrees"
        in dataclasses.replace(law, student_dof=4.0).describe()[-1]
    )


def _bumpy(problem: GapProblem, count: int) -> np.ndarray:
    """Columns (N, runs * channels * count), each `count` cosines of falling size in one
    channel of one run.
    """
    bumps = []
    for members in problem.members:
        for group in np.unique(problem.channel):
            mine = members[problem.channel[members] == group]
            at = (np.arange(len(mine)) + 0.5) / len(mine)
            for k in range(count):
                bumps.append(np.zeros(len(problem)))
                bumps[-1][mine] = np.cos(np.pi * k * at) / (1.0 + k / 4.0)
    return np.column_stack(bumps)
