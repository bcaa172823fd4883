"""Posterior predictive checks: do readings look like those that the posterior predicts?

For a draw of parameters and noise law, a discrepancy D of the residuals r = y - f(theta) is
compared with that of a draw of the noise. The share of draws in which the noise has the
larger one is near 0 or 1 where readings contradict the posterior (Gelman, Meng and Stern
1996, Statistica Sinica 6, 733-807, realised discrepancies).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from oed.base import Array
from oed.estimation import Estimate
from oed.measurement import Measurement, Series, reading_structure
from oed.noise import Laws, ReadingStructure
from oed.posterior.posterior import Posterior
from oed.result import PredictiveCheckRecord

#: draws that are compared
DRAWS = 400


def predictive_checks(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    estimate: Estimate,
    posterior: Posterior,
    rng: np.random.Generator,
) -> dict[str, PredictiveCheckRecord]:
    """Checks of readings y (N,), SI, by the names of `DISCREPANCIES`."""
    structure = reading_structure(measurement, series, estimate.theta)
    theta = posterior.pooled
    chosen = rng.choice(len(theta), min(DRAWS, len(theta)), replace=False)
    predicted = measurement.readings_near(series, estimate.theta)(theta[chosen])
    residuals = structure.standardise((y - predicted).T).T
    laws = Laws.stated(structure, len(chosen), estimate.scatter)
    estimated = estimate.noise_posterior is not None
    if estimate.noise_posterior is not None:
        flat = posterior.noise_law.reshape(-1, posterior.noise_law.shape[2])
        laws = estimate.noise_posterior.prior.laws(flat[chosen])
    noise = laws.whitening(structure).draw(
        rng, structure.statement, estimated=estimated
    )
    checks = {}
    for name, discrepancy in DISCREPANCIES.items():
        observed, drawn = (discrepancy(structure, e) for e in (residuals, noise))
        if np.isfinite(observed).all():
            checks[name] = PredictiveCheckRecord(
                observed=float(observed.mean()),
                low=float(np.quantile(drawn, 0.025)),
                high=float(np.quantile(drawn, 0.975)),
                p_high=float(np.mean(drawn >= observed)),
            )
    return checks


def _rms(structure: ReadingStructure, errors: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(errors**2, axis=1)))


def _largest(structure: ReadingStructure, errors: Array) -> Array:
    return np.asarray(np.abs(errors).max(axis=1))


def _neighbours(structure: ReadingStructure, errors: Array) -> Array:
    """Mean product of neighbours in a chain over the mean square (draws,)."""
    order = np.lexsort((structure.position, structure.chain))
    same = np.diff(structure.chain[order]) == 0
    if not same.any():
        return np.full(len(errors), np.nan)
    along = errors[:, order]
    products = (along[:, 1:] * along[:, :-1])[:, same]
    return np.asarray(products.mean(axis=1) / np.mean(errors**2, axis=1))


def _run_means(structure: ReadingStructure, errors: Array) -> Array:
    """Root mean square of the chains' means (draws,); NaN for a single chain."""
    counts = np.bincount(structure.chain)
    if len(counts) < 2:
        return np.full(len(errors), np.nan)
    member = structure.chain == np.arange(len(counts))[:, None]
    means = errors @ (member / counts[:, None]).T
    return np.asarray(np.sqrt(np.mean(means**2, axis=1)))


Discrepancy = Callable[[ReadingStructure, Array], Array]
#: root mean square, largest residual, correlation of neighbours, means of runs
DISCREPANCIES: Mapping[str, Discrepancy] = {
    "rms": _rms,
    "largest": _largest,
    "neighbours": _neighbours,
    "run_means": _run_means,
}
