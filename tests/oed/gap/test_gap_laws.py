"""Laws that stand for all: evidence against the mean over laws drawn from the prior."""

import numpy as np
import pytest
from scipy import special

from kernel.dense_noise import draw_noise
from kernel.gap_lines import white_lines
from kernel.laws import noise_law
from oed.gap.data import evidence
from oed.gap.data.columns import Block
from oed.gap.data.problem import GapProblem
from oed.noise import NoiseLaw


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
