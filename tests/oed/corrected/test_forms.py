"""Evidence of effects' forms against determinants of dense covariances."""

from collections.abc import Mapping

import numpy as np
import pytest
from shipped_models import backlash

from kernel import gap_problem
from oed.corrected.forms import choose_forms, form_evidence
from oed.effect_model import EFFECT_SIZES
from oed.gap import GapProblem

PLAY = np.array([3.0, -2.0, 4.0])


def dense_evidence(problem, columns, residual):
    """-1/2 log(|C + U U^T| / |C|) - N/2 log r^T (C + U U^T)^-1 r, C = 1 + H H^T."""
    n = len(problem)
    without = np.eye(n) + problem.slopes @ problem.slopes.T
    total = without + columns @ columns.T
    log_det = np.linalg.slogdet(total)[1] - np.linalg.slogdet(without)[1]
    square = residual @ np.linalg.solve(total, residual)
    return float(-0.5 * log_det - 0.5 * n * np.log(square))


@pytest.fixture(scope="module")
def problem() -> GapProblem:
    """Circles with play of some sizes in the three drives."""
    circles = gap_problem.circles()
    signature = circles.signature(
        backlash.effect, {"distance": backlash.TAKEN_UP[0]}, textbook=True
    )
    change = circles.noise_units(signature.columns @ PLAY)
    noise = np.random.default_rng(1).standard_normal(len(circles))
    return circles.with_residual(change + noise)


def test_evidence_is_that_of_dense_covariances(problem, rng):
    evidence = form_evidence(problem)
    columns = rng.standard_normal((len(problem), 4))
    expected = dense_evidence(problem, columns, problem.residual)
    assert evidence.log_evidence(columns, problem.residual) == pytest.approx(expected)
    fixed, sized = columns[:, :1], columns[:, 1:]
    by_size = [
        dense_evidence(problem, np.hstack([fixed, size * sized]), problem.residual)
        for size in EFFECT_SIZES.values
    ]
    assert evidence.of_sizes(fixed, sized, problem.residual) == pytest.approx(
        np.array(by_size) + EFFECT_SIZES.log_shares, rel=1e-6
    )
    total = np.eye(len(problem)) + problem.slopes @ problem.slopes.T
    total += columns @ columns.T
    square = problem.residual @ np.linalg.solve(total, problem.residual)
    assert evidence.unexplained(columns, problem.residual) == pytest.approx(square)


def test_the_form_of_highest_evidence_is_chosen(problem):
    """Distances at which play is taken up are alike where circles are far between."""
    (form,) = choose_forms(problem, [backlash.effect])

    def values(constants: Mapping[str, float]) -> np.ndarray:
        signature = problem.signature(backlash.effect, constants)
        columns = problem.noise_units(signature.columns)
        by_size = [
            dense_evidence(problem, size * columns, problem.residual)
            for size in EFFECT_SIZES.values
        ]
        return np.array(by_size) + EFFECT_SIZES.log_shares

    tried = np.array([values(c) for c in backlash.effect.constant_grid()])
    chosen = values(form.constants)
    assert chosen.max() == pytest.approx(tried.max(), abs=1e-5)
    assert form.size == EFFECT_SIZES.values[np.argmax(chosen)] == 3.0
