"""Noise laws that all hypotheses share, weighted so that sums over them integrate.

The noise law is not known before the gap is, and the evidence of a hypothesis is an
integral over laws u with the prior p(u) of `oed.noise_law`:

    p(r | h) = integral p(r | h, u) p(u) du.

Laws are drawn from the posteriors p(u | r, a) of a few models a: no gap, any gap, the
gaps that look best. With Z_a = p(r | a), draws u_l, l = 1 ... L, as many of each model,
give (Veach and Guibas 1995, balance heuristic)

    p(r | h) = sum_l W_l p(r | h, u_l),    1 / W_l = (L / A) sum_a p(r | a, u_l) / Z_a.

It is exact for h = a alone, and the same laws serve every hypothesis. A common factor
on the noise is integrated over in closed form (`evidence`); the laws hold the rest.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.base import Array
from oed.gap.data import evidence
from oed.gap.data.problem import GapProblem
from oed.noise import Laws, NoiseLaw
from oed.noise_law import NoisePrior, ResidualModel, draw_laws

#: points of a model's posterior, by which its evidence is computed
POINTS = 48
#: coordinates beyond which a law is not looked at, in prior sd: what a run shares is
#: below some hundred times the noise, and single readings keep some of it
FARTHEST = 4.5
#: laws that are drawn of each model
EACH = 4

#: a noise law, and the log of its weight
WeighedLaw = tuple[NoiseLaw, float]


@dataclasses.dataclass(frozen=True, eq=False)
class LawPosterior:
    """Posterior of the noise law with some columns in the model.

    columns       (N, k') compressed, the parameters' slopes among them
    mode          the most probable law
    draws         (EACH, d) coordinates of laws drawn from it
    log_evidence  of the readings, over all laws
    """

    columns: Array
    mode: NoiseLaw
    draws: Array
    log_evidence: float


def posterior(problem: GapProblem, columns: Array) -> LawPosterior:
    """The law's posterior with columns (N, k) of prior N(0, 1) in the model."""
    compressed = evidence.compress(problem, columns)
    prior, model = _prior(problem), linear_model(problem, compressed)

    def cost(u: Array) -> Array:
        values = log_evidences(model, _laws(problem, u))
        log_prior = -0.5 * (u**2).sum(axis=1) - 0.5 * u.shape[1] * np.log(2.0 * np.pi)
        return np.asarray(-values - log_prior)

    starts = prior.starts()[:, 1:]
    drawn = draw_laws(cost, starts, FARTHEST, points=POINTS, draws=EACH)
    law = NoiseLaw(_laws(problem, drawn.mode[None]))
    return LawPosterior(compressed, law, drawn.draws, drawn.log_integral)


def mixture(
    problem: GapProblem, posteriors: Sequence[LawPosterior]
) -> list[WeighedLaw]:
    """Laws drawn from several posteriors, with the logs of their weights W."""
    laws = _laws(problem, np.vstack([p.draws for p in posteriors]))
    table = np.column_stack(
        [
            log_evidences(linear_model(problem, p.columns), laws) - p.log_evidence
            for p in posteriors
        ]
    )
    each = len(laws) / len(posteriors)
    log_weights = -special.logsumexp(table, axis=1) - np.log(each)
    drawn = [NoiseLaw(laws.take([k])) for k in range(len(laws))]
    return list(zip(drawn, map(float, log_weights), strict=True))


def _prior(problem: GapProblem) -> NoisePrior:
    """The prior of the laws; its first scale, the common factor, is kept at 1."""
    return NoisePrior.of(problem.structure).sparse()


def _laws(problem: GapProblem, u: Array) -> Laws:
    """Laws at coordinates (L, d), all but the first scale's."""
    return _prior(problem).laws(np.column_stack([np.zeros(len(u)), u]))


def linear_model(problem: GapProblem, columns: Array) -> ResidualModel:
    """The residual as a linear model of columns (N, k), parameters' slopes among them."""
    structure = problem.structure
    residual, slopes = (structure.standardise(v) for v in (problem.residual, columns))
    return ResidualModel(structure, residual, slopes, np.zeros(columns.shape[1]))


def log_evidences(model: ResidualModel, laws: Laws) -> Array:
    """Log evidences (L,) of a problem's model under each law, the level integrated out."""
    solved, structure = model.solve(laws), model.structure
    log_det = solved.log_size + 2.0 * structure.log_unit
    return evidence.log_student(log_det, solved.energy, len(structure))
