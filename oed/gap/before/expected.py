"""Expected probability of the right answer after planned readings, by simulation.

AnswerForm k of the readings has the columns G_k, coefficients beta ~ N(0, 1), and the
probability p_k after the readings r taken. With the parameters' slopes H and readings
whitened by the noise, its coefficients (theta, beta) given r are normal, and so are the
readings to come,

    A_k = 1 + X_k^T X_k,    m_k = A_k^-1 X_k^T r,    X_k = [H, G_k],
    r' | k, r ~ N(X'_k m_k, 1 + X'_k A_k^-1 X'_k^T),

X'_k of the readings to come. Draws of r' under each explanation by its probability are
answered as a diagnosis would: the answer with the most posterior probability is right
with that probability. Its mean over the draws is the expected probability of the right
answer (the preposterior analysis of Raiffa and Schlaifer 1961, chapter 4).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import linalg, special

from oed.base import Array, Index

#: draws of the readings to come
DRAWS = 600


@dataclasses.dataclass(frozen=True, eq=False)
class AnswerForm:
    """An answer of a diagnosis in one of its forms.

    effects      names of what acts; none: nothing
    probability  after the readings taken
    columns      (N, k) of all readings, taken and to come, per standard deviation of
                 each coefficient, in units of the stated noise
    share_right  probability that the answer is right where this explanation is best: less
                 than 1 for nothing at all, beside which what is too small to be seen acts
    """

    effects: tuple[str, ...]
    probability: float
    columns: Array
    share_right: float = 1.0


def coefficients(white: Array, residual: Array) -> tuple[Array, Array]:
    """Mean (m,) of coefficients of prior N(0, 1), and the Cholesky factor of their precision.

    white, residual  (N, m), (N,) columns and readings, whitened
    """
    precision = np.eye(white.shape[1]) + white.T @ white
    factor = linalg.cholesky(precision, lower=True, check_finite=False)
    mean = linalg.cho_solve((factor, True), white.T @ residual, check_finite=False)
    return np.asarray(mean), np.asarray(factor)


def probability_now(explanations: Sequence[AnswerForm]) -> float:
    """Probability of the likeliest answer."""
    probability = np.array([e.probability for e in explanations])
    log_density = np.zeros((len(explanations), 1))
    return float(_right(explanations, probability, log_density)[0])


def expected_probability(
    explanations: Sequence[AnswerForm],
    taken: Sequence[Array],
    residual: Array,
    to_come: Sequence[Array],
    rng: np.random.Generator,
) -> float:
    """Expected probability that the likeliest answer is right after the readings to come.

    taken, to_come  for each explanation [H, G_k] (N, m) and (n, m), whitened
    residual        (N,) readings taken, whitened
    """
    probability = np.array([e.probability for e in explanations])
    from scipy import stats  # takes half a second to import

    predictions = []
    for x, y in zip(taken, to_come, strict=True):
        mean, factor = coefficients(x, residual)
        spread = linalg.solve_triangular(factor, y.T, lower=True, check_finite=False)
        covariance = np.eye(len(y)) + spread.T @ spread
        predictions.append(stats.multivariate_normal(y @ mean, covariance))
    truth = rng.choice(len(predictions), DRAWS, p=probability / probability.sum())
    draws = np.empty((DRAWS, len(to_come[0])))
    for k, prediction in enumerate(predictions):
        of_k = truth == k
        drawn = prediction.rvs(DRAWS, random_state=rng).reshape(draws.shape)
        draws[of_k] = drawn[of_k]
    log_density = np.array([prediction.logpdf(draws) for prediction in predictions])
    return float(_right(explanations, probability, log_density).mean())


def _right(
    explanations: Sequence[AnswerForm], probability: Array, log_density: Array
) -> Array:
    """Probability (d,) of the likeliest answer for each draw; answers alike join.

    What no explanation holds of the probability stays wrong.
    """
    shares = special.softmax(np.log(probability)[:, None] + log_density, axis=0)
    answers: dict[tuple[str, ...], Index] = {}
    for k, explanation in enumerate(explanations):
        known = answers.get(explanation.effects, np.empty(0, dtype=np.intp))
        answers[explanation.effects] = np.append(known, k)
    right = np.array([e.share_right for e in explanations])[:, None] * shares
    joined = np.array([right[numbers].sum(axis=0) for numbers in answers.values()])
    return np.asarray(probability.sum() * joined.max(axis=0))
