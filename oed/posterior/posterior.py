"""Posterior of the full nonlinear model: independent draws, or emcee where they fail.

Draws out of the bounds of parameters are left out: the others are of the truncated one.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np

from oed.base import Array
from oed.estimation import Estimate
from oed.measurement import Measurement, Series, reading_structure
from oed.noise import Laws, ReadingStructure
from oed.posterior import chains, importance
from oed.posterior.chains import Checkpoint, Ensembles, ensemble_sizes
from oed.posterior.draws import Posterior
from oed.posterior.log_density import LogDensity
from oed.result import PredictiveCheckRecord

# Posterior predictive checks: do readings look like those that the posterior predicts?
#
# For a draw of parameters and noise law, a discrepancy D of the residuals r = y - f(theta) is
# compared with that of a draw of the noise. The share of draws in which the noise has the
# larger one is near 0 or 1 where readings contradict the posterior (Gelman, Meng and Stern
# 1996, Statistica Sinica 6, 733-807, realised discrepancies).

#: draws that a predictive check compares: a probability is known to 0.025
CHECKED_DRAWS = 400


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
    chosen = rng.choice(len(theta), min(CHECKED_DRAWS, len(theta)), replace=False)
    predicted = measurement.try_readings(series, theta[chosen])
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
    "rms": lambda _, errors: np.sqrt(np.mean(errors**2, axis=1)),
    "largest": lambda _, errors: np.abs(errors).max(axis=1),
    "neighbours": _neighbours,
    "run_means": _run_means,
}


#: draws that emcee returns by default, over the wanted effective sample size
DRAWS_PER_ESS = 4.0
#: effective sample size up to which that counts: more draws fill the result's file
MAX_ESS_OF_DRAWS = 5000.0

#: "auto": independent draws where their weights allow it, else emcee
Sampler = Literal["auto", "emcee"]


def sample(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    estimate: Estimate,
    rng: np.random.Generator,
    *,
    sampler: Sampler = "auto",
    walkers: int | None = None,
    ess: float = 1000.0,
    max_steps: int = 20_000,
    max_draws: int | None = None,
    thin: int = 1,
    progress: Callable[[float], None] | None = None,
    checkpoint: Checkpoint | None = None,
    resumed: Callable[[int], None] | None = None,
) -> Posterior:
    """Sample the posterior of readings y (N,), SI, about an estimate.

    sampler     "auto": independent draws where their weights allow it, else emcee
    ess         effective sample size wanted of every parameter
    max_draws   returned at most; of emcee four times `ess` by default
    progress    called with the share done

    Of emcee alone:

    walkers     of all ensembles; as many as are needed by default
    max_steps   of every walker
    thin        each so many-th step is returned, or fewer
    checkpoint  where the unfinished chain is saved, and resumed from
    resumed     called with the steps of a chain that is resumed

    Raises KeyboardInterrupt where Ctrl-C arrives, OSError where the checkpoint cannot
    be written, OutOfBoundsError where readings and bounds contradict each other.

    >>> import numpy as np
    >>> from oed import Measurement, mount
    >>> from oed.estimation import identify
    >>> from oed.measurement import draw_parameters, draw_readings
    >>> from oed.posterior import sample
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> y, z = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    >>> series = measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    >>> rng = np.random.default_rng(1)
    >>> truth = draw_parameters(measurement, rng)
    >>> y = draw_readings(measurement, [series], truth, rng)
    >>> estimate = identify(measurement, [series], y)
    >>> posterior = sample(measurement, [series], y, estimate, rng, ess=400)
    >>> bool(np.nanmin(posterior.ess) > 400)
    True
    >>> shift = np.abs(posterior.theta - estimate.theta)
    >>> bool(np.all(shift < estimate.sd))
    True
    """
    target = LogDensity(measurement, series, y, estimate)
    proposals = importance.Proposals.empty(target)
    k = math.nan
    if sampler == "auto" and ess <= importance.MAX_ESS:
        limit = math.inf if max_draws is None else max_draws
        drawn, proposals, k = importance.sample_independent(
            target, rng, ess, limit, progress
        )
        if drawn is not None:
            return drawn

    def starts(rng: np.random.Generator, count: int) -> Array:
        if len(proposals.points) < count:
            return target.starts(rng, count)
        return proposals.starts(rng, count)

    sizes = ensemble_sizes(walkers, target.dimensions)
    ensembles = Ensembles(target, sizes, rng, starts, checkpoint)
    if ensembles.resumed and resumed is not None:
        resumed(ensembles.resumed)
    autocorrelation, burn_in = chains.run(ensembles, target, ess, max_steps, progress)
    draws = max_draws or int(DRAWS_PER_ESS * min(ess, MAX_ESS_OF_DRAWS))
    collected = chains.collect(
        target, ensembles, autocorrelation, burn_in, rng, max_draws=draws, thin=thin
    )
    return dataclasses.replace(collected, pareto_k=k, proposals=proposals.drawn)
