"""Posterior of the full nonlinear model: independent draws, or emcee where they fail.

Independent draws come from importance sampling about the estimate; the tail of their
weights says whether they may be used (`oed.posterior.importance`). Where not, emcee
samples, started from them (`oed.posterior.chains`). Directions that no reading determines
are drawn from their prior. Draws out of the bounds of parameters are left out: what stays
are draws of the truncated posterior.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from oed.base import Array
from oed.estimation import Estimate
from oed.measurement import Measurement, Series
from oed.posterior import chains, importance
from oed.posterior.chains import MIXED_RHAT
from oed.posterior.checkpoint import Checkpoint
from oed.posterior.draws import Posterior, save, to_arviz
from oed.posterior.ensembles import Ensembles, ensemble_sizes
from oed.posterior.log_density import LogDensity

__all__ = [
    "MIXED_RHAT",
    "Posterior",
    "Sampler",
    "import_samplers",
    "sample",
    "save",
    "to_arviz",
]

#: draws that emcee returns by default, over the wanted effective sample size, which counts
#: up to the largest
DRAWS_OF_ESS, LARGEST_ESS = 4.0, 5000.0

#: "auto": independent draws where their weights allow it, else emcee
Sampler = Literal["auto", "emcee"]


def import_samplers(sampler: Sampler = "auto") -> None:
    """Import ArviZ, and emcee where it is asked for, now: it takes seconds.

    An interruption during an import would be reported by other people's code.
    """
    chains.arviz()
    if sampler == "emcee":
        import emcee  # noqa: F401


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
    proposals, k = importance.Proposals.empty(target.dimensions), math.nan
    if sampler == "auto" and ess <= importance.LARGEST_ESS:
        most = math.inf if max_draws is None else max_draws
        drawn, proposals, k = importance.sample_independent(
            target, rng, ess, most, progress
        )
        if drawn is not None:
            return drawn

    def starts(rng: np.random.Generator, count: int) -> Array:
        if len(proposals.points) < count:
            return target.starts(rng, count)
        return proposals.starts(rng, count)

    sizes = ensemble_sizes(walkers, target.dimensions)
    determining = (y, target.centre, target.root, *_bounds(measurement))
    ensembles = Ensembles(target, sizes, rng, checkpoint, determining, starts)
    if ensembles.saved > 0 and resumed is not None:
        resumed(ensembles.saved)
    autocorrelation, burn_in = chains.run(ensembles, target, ess, max_steps, progress)
    draws = max_draws or int(DRAWS_OF_ESS * min(ess, LARGEST_ESS))
    collected = chains.collect(
        target, ensembles, autocorrelation, burn_in, rng, max_draws=draws, thin=thin
    )
    return dataclasses.replace(collected, pareto_k=k, proposals=proposals.drawn)


def _bounds(measurement: Measurement) -> tuple[Array, ...]:
    """The bounds, where there are any."""
    return (measurement.bounds,) if measurement.bounded.size else ()
