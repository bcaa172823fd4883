"""Reports the sampled posterior: the section `posterior`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from oed import units
from oed.base import Array
from oed.estimation import Estimate
from oed.linear_algebra import by_size
from oed.measurement import Measurement
from oed.posterior import MIXED_RHAT, Posterior
from oed.result import Marginal, PosteriorSection, PredictiveCheckRecord, finite_or_none
from pkm_studies.tables import PosteriorTable

#: draws shown in the corner plot
CORNER_DRAWS = 1500
#: parameters that name a direction
NAMED = 3


def sampler_options(table: PosteriorTable) -> dict[str, Any]:
    """Options of the sampler, as [posterior] states them."""
    return {
        "sampler": table.sampler,
        "walkers": table.walkers,
        "ess": float(table.ess),
        "max_steps": table.steps,
        "max_draws": table.draws,
        "thin": table.thin,
    }


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
        sampler=posterior.sampler,
        pareto_k=finite_or_none(posterior.pareto_k),
        proposals=posterior.proposals,
        acceptance=finite_or_none(posterior.acceptance),
        draws=len(posterior.pooled),
        walkers=posterior.walkers,
        autocorrelation=finite_or_none(posterior.autocorrelation),
        directions=directions,
        corner=table,
    )


#: what a predictive check compares
COMPARED = {
    "rms": "the rms residual",
    "largest": "the largest residual",
    "neighbours": "the correlation of neighbours along a run",
    "run_means": "the rms of the runs' mean residuals",
}


def add_checks(
    section: PosteriorSection, checks: Mapping[str, PredictiveCheckRecord]
) -> PosteriorSection:
    """The section with its posterior predictive checks."""
    return msgspec.structs.replace(section, checks=dict(checks))


def contradictions(checks: Mapping[str, PredictiveCheckRecord]) -> list[str]:
    """Checks that the readings fail, as sentences."""
    return [
        f"the readings contradict the posterior: {COMPARED[name]} is"
        f" {check.observed:.2g}, predicted are {check.low:.2g} to {check.high:.2g} (in"
        " units of the stated noise)"
        for name, check in checks.items()
        if check.alarming
    ]


def sampling_warnings(posterior: Posterior, ess: int) -> list[str]:
    """What a user must know of how the posterior was sampled."""
    sentences = []
    finite = posterior.ess[np.isfinite(posterior.ess)]
    least = float(finite.min(initial=np.inf))
    if not finite.size:
        sentences.append(
            "the posterior has too few steps to tell its effective sample size; raise"
            " [posterior] steps"
        )
    if least < ess:
        key = "draws" if posterior.sampler == PosteriorSection.IMPORTANCE else "steps"
        sentences.append(
            f"the posterior has an effective sample size of {least:.0f}, short of"
            f" {ess}; raise [posterior] {key}"
        )
    unmixed = np.flatnonzero(np.nan_to_num(posterior.rhat) > MIXED_RHAT)
    if unmixed.size:
        worst = int(np.nanargmax(posterior.rhat))
        also = f", {len(unmixed)} parameters in all" if len(unmixed) > 1 else ""
        sentences.append(
            f"independent ensembles disagree: R-hat is {posterior.rhat[worst]:.3f} for"
            f" {posterior.names[worst]}{also}, wanted is {MIXED_RHAT} at most; raise"
            " [posterior] steps"
        )
    return sentences


def marginal(values: Array, posterior: Posterior, k: int, unit: str) -> Marginal:
    """Marginal of the k-th coordinate, from its pooled draws (m,) in `unit`."""
    low, high = np.quantile(values, [0.025, 0.975])
    return Marginal(
        mean=float(values.mean()),
        sd=float(values.std(ddof=1)),
        q025=float(low),
        q975=float(high),
        rhat=finite_or_none(posterior.rhat[k]),
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
        largest = by_size(weight)[:NAMED]
        terms = [f"{weight[j]:+.2f} {measurement.names[j]}" for j in largest]
        names.append(" ".join(terms))
    thin = max(1, len(z) // CORNER_DRAWS)
    draws = z[::thin][:CORNER_DRAWS, widest]
    return names, [[float(v) for v in row] for row in draws]
