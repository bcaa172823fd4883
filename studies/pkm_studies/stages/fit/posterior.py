"""Reports the sampled posterior: the section `posterior`."""

from __future__ import annotations

import numpy as np

from oed import units
from oed.arrays import Array
from oed.identification import Estimate
from oed.measurement import Measurement
from oed.posterior import Posterior
from oed.result import Marginal, PosteriorSection

#: draws shown in the corner plot
CORNER_DRAWS = 1500
#: parameters that name a direction
NAMED = 3


def posterior_section(
    measurement: Measurement,
    estimate: Estimate,
    posterior: Posterior,
    corner: int,
) -> PosteriorSection:
    """Marginals in display units, and draws along the `corner` widest directions."""
    marginals = {}
    for k, p in enumerate(measurement.parameters):
        if estimate.prior_sd[k] == 0.0:
            continue
        unit = units.display(p.unit)
        values = units.from_si(posterior.pooled[:, k], unit)
        marginals[p.name] = marginal(values, posterior, k, unit)
    directions, table = _widest(measurement, estimate, posterior, corner)
    return PosteriorSection(
        marginals=marginals,
        acceptance=posterior.acceptance,
        draws=len(posterior.pooled),
        walkers=posterior.draws.shape[0],
        autocorrelation=posterior.autocorrelation,
        directions=directions,
        corner=table,
    )


def marginal(values: Array, posterior: Posterior, k: int, unit: str) -> Marginal:
    """Marginal of the k-th coordinate, from its pooled draws (m,) in `unit`."""
    low, high = np.quantile(values, [0.025, 0.975])
    return Marginal(
        mean=float(values.mean()),
        sd=float(values.std(ddof=1)),
        q025=float(low),
        q975=float(high),
        rhat=float(posterior.rhat[k]),
        ess=float(posterior.ess[k]),
        unit=unit,
    )


def _widest(
    measurement: Measurement,
    estimate: Estimate,
    posterior: Posterior,
    count: int,
) -> tuple[list[str], list[list[float]]]:
    """The directions with the widest posterior, and draws along them, thinned.

    Draws are in prior standard deviations; a direction's name has the parameters that
    it moves most.
    """
    z = posterior.z.reshape(-1, posterior.z.shape[2])
    widest = np.argsort(-z.std(axis=0))[:count]
    scale = np.where(estimate.prior_sd > 0, estimate.prior_sd, 1.0)
    names = []
    for k in widest:
        weight = estimate.coordinates.basis[:, k] / scale
        largest = np.argsort(-np.abs(weight))[:NAMED]
        terms = [f"{weight[j]:+.2f} {measurement.names[j]}" for j in largest]
        names.append(" ".join(terms))
    thin = max(1, len(z) // CORNER_DRAWS)
    draws = z[::thin][:CORNER_DRAWS, widest]
    return names, [[float(v) for v in row] for row in draws]
