"""Points about which effects act, and what they explain, against dense matrices."""

import functools

import numpy as np
import pytest

from kernel.dense_noise import noise_covariance, residual_covariance
from kernel.gap_lines import BOW, EFFECTS, planted, search_of, white_lines
from kernel.laws import STATED_LAW
from oed.gap.cause.compare import compare, compare_expanded
from oed.gap.cause.search import Search
from oed.gap.data.linearisation import ActingEffectForm, settle
from oed.gap.data.problem import GapProblem
from oed.gap.procedure import explain

FORM = ActingEffectForm(BOW, {"turns": 3.0}, ("leg 1", "leg 2"), 3.0)


@functools.cache
def bowed() -> GapProblem:
    """Lines of a machine whose first leg is bowed by four expected sizes."""
    return planted(white_lines(), BOW, {"leg 1": 4.0}, turns=3.0)


def test_small_effects_settle_at_the_linear_estimate():
    """In expected sizes: the mean of coefficients of prior N(0, 1) times the form's."""
    problem = bowed()
    law, none = STATED_LAW, np.zeros(len(problem))
    settled = settle(problem, [FORM], law, none)
    signature = problem.signature(BOW, FORM.constants)
    rows = [signature.names.index(name) for name in FORM.names]
    columns = FORM.size * problem.noise_units(signature.columns[:, rows])
    weighed = np.linalg.solve(residual_covariance(problem, STATED_LAW), columns)
    precision = columns.T @ weighed + np.eye(2)
    exact = FORM.size * np.linalg.solve(precision, weighed.T @ problem.residual)
    assert settled.coefficients == pytest.approx(exact, abs=0.02)
    assert settled.coefficients[0] == pytest.approx(4.0, abs=0.5)
    assert settled.departure < 0.3
    assert settled.problem.residual == pytest.approx(problem.residual, abs=0.3)


@functools.cache
def searched() -> Search:
    return search_of(bowed())


def test_small_effects_ask_for_no_other_point():
    comparison = compare_expanded(bowed(), EFFECTS, lambda p: [search_of(p)])
    assert len(comparison.searches) == 1
    plain = compare([searched()])
    assert [h.key for h in comparison.hypotheses] == [h.key for h in plain]
    assert comparison.hypotheses[0].effects == ("bow",)


def test_parts_of_the_residual_are_the_dense_estimates():
    problem, search = bowed(), searched()
    best = next(h for h in compare([search]) if h.key == (frozenset({"bow"}), False))
    parts, sigma = explain(problem, search, best, {"bow"}), problem.sigma
    columns = search.library.scaled_columns(best.atoms[0], best.sizes[0])
    weighed = np.linalg.solve(residual_covariance(problem, STATED_LAW), columns)
    precision = columns.T @ weighed + np.eye(columns.shape[1])
    mean = np.linalg.solve(precision, weighed.T @ problem.residual)
    explained = parts.explained / sigma
    assert explained == pytest.approx(columns @ mean, abs=1e-6)
    assert parts.unexplained == pytest.approx(0.0, abs=1e-9)
    noise = noise_covariance(problem, STATED_LAW)
    # what parameters leave of r is R (R + H H^T)^-1 r
    left = noise @ np.linalg.inv(residual_covariance(problem, STATED_LAW))
    assert parts.before / sigma == pytest.approx(left @ problem.residual, abs=1e-6)
    corrected = problem.residual - columns @ mean
    assert parts.after / sigma == pytest.approx(left @ corrected, abs=1e-6)
    (size,) = parts.sizes
    energy = explained @ np.linalg.solve(
        residual_covariance(problem, STATED_LAW), explained
    )
    level = search.noise_level(best)
    assert size.detectability == pytest.approx(np.sqrt(energy) / level)
    channel = problem.rows["channel"].to_numpy()
    for name, rms in size.rms.items():
        values = parts.explained[channel == name]
        assert rms == pytest.approx(np.sqrt(np.mean(values**2)))


def test_effects_that_are_not_named_count_as_unknown():
    problem, search = bowed(), searched()
    best = next(h for h in compare([search]) if h.key == (frozenset({"bow"}), False))
    named, unnamed = (explain(problem, search, best, n) for n in ({"bow"}, set()))
    assert unnamed.coefficients == ()
    assert unnamed.explained == pytest.approx(0.0)
    assert unnamed.unexplained == pytest.approx(named.explained)
