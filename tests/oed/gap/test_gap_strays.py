"""Readings far off: which are named, and beside what."""

import numpy as np

from kernel.dense_noise import draw_noise
from kernel.gap_lines import readings, white_lines
from kernel.laws import STATED_LAW, noise_law
from oed.gap.cause.searches import detect_outliers
from oed.gap.data.problem import GapProblem


def test_normal_readings_have_no_strays():
    """In at most one set of twelve: the likeliest shape must be worth a factor of twenty."""
    detected = [
        detect_outliers(p, STATED_LAW, p.slopes)
        for p in (white_lines(k, 5, 31) for k in range(12))
    ]
    assert sum(f is not None for f in detected) <= 1


def test_strays_are_told_beside_a_model_of_many_columns():
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


def test_a_stray_does_not_spoil_its_neighbours():
    """In an error that is carried along a reading is predicted from its neighbours."""
    problem = readings(3)
    law = noise_law(ar1_sd=2.0, ar1_length=8.0)
    y = draw_noise(problem, law, np.random.default_rng(4))
    far = np.arange(20, len(problem), 60)
    spoilt = y.copy()
    spoilt[far] += 20.0
    detected = detect_outliers(problem.with_residual(spoilt), law, problem.slopes)
    neighbours = np.concatenate([far - 2, far + 2])  # two channels are read by turns
    assert np.abs(detected.pseudo_residual - y)[neighbours].max() < 1.0
    assert np.abs(detected.pseudo_residual - y)[far].max() < 5.0


def _bumpy(problem: GapProblem, count: int) -> np.ndarray:
    """Columns (N, k) of `count` cosines of falling size in each channel of each run."""
    bumps = []
    for members in problem.members:
        for group in np.unique(problem.channel):
            mine = members[problem.channel[members] == group]
            at = (np.arange(len(mine)) + 0.5) / len(mine)
            for k in range(count):
                bumps.append(np.zeros(len(problem)))
                bumps[-1][mine] = np.cos(np.pi * k * at) / (1.0 + k / 4.0)
    return np.column_stack(bumps)
