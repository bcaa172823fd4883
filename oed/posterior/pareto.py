"""Importance weights whose tail is smoothed by a generalised Pareto distribution (PSIS).

Vehtari, Simpson, Gelman, Yao and Gabry 2024, Journal of Machine Learning Research 25(72).
The distribution is fitted as by Zhang and Stephens 2009, Technometrics 51(3), 316-325.
ArviZ has both, but takes as long to import as a whole posterior takes to sample.
"""

import math

import numpy as np

from oed.base import Array

MIN_TAIL = 5  #: fewest weights of a tail that has a shape
#: weights up to which the tail is a fifth of them; of more it is 3 sqrt(m)
FEW_WEIGHTS = 225
#: prior of the shape (Vehtari et al.): its mean, and the excesses that it is worth
PRIOR_SHAPE = 0.5
PRIOR_WORTH = 10.0
#: points of the quadrature at least, and their spread over the lower quartile (Zhang and
#: Stephens)
MIN_POINTS = 30
POINT_SPREAD = 3.0


def smoothed_weights(log_weights: Array) -> tuple[Array, float]:
    """Weights (m,) of sum 1, k of their tail; too few stay, of k inf; equal have 0."""
    count = len(log_weights)
    tail = count // 5 if count <= FEW_WEIGHTS else math.floor(3.0 * math.sqrt(count))
    weights = np.exp(log_weights - log_weights.max())
    if tail < MIN_TAIL:
        return weights / weights.sum(), math.inf
    order = np.argsort(log_weights)
    largest, cutoff = order[-tail:], weights[order[-tail - 1]]
    if weights[largest[0]] == weights[largest[-1]]:
        return weights / weights.sum(), 0.0
    shape, scale = fit_pareto(weights[largest] - cutoff)
    levels = np.arange(0.5, tail) / tail
    quantiles = cutoff + scale * np.expm1(-shape * np.log1p(-levels)) / shape
    weights[largest] = np.minimum(quantiles, 1.0)
    return weights / weights.sum(), shape


def fit_pareto(excess: Array) -> tuple[float, float]:
    """Shape, scale of a generalised Pareto of sorted (n,), by mean -shape / scale."""
    count = len(excess)
    points = MIN_POINTS + math.isqrt(count)
    quartile = excess[int(count / 4 + 0.5) - 1]
    spread = 1.0 - np.sqrt(points / (np.arange(points) + 0.5))
    theta = spread / (POINT_SPREAD * quartile) + 1.0 / excess[-1]
    shapes = np.log1p(-theta[:, None] * excess).mean(axis=1)
    log_likelihood = count * (np.log(-theta / shapes) - shapes - 1.0)
    share = np.exp(log_likelihood - log_likelihood.max())
    mean = float(share @ theta / share.sum())
    shape = float(np.log1p(-mean * excess).mean())
    worth = count + PRIOR_WORTH
    return (count * shape + PRIOR_WORTH * PRIOR_SHAPE) / worth, -shape / mean
