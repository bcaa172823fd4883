"""Posterior of the full nonlinear model, sampled by emcee with all walkers at once.

Two kinds of moves share the work. Independent proposals from the Laplace approximation
with Student tails decide almost every step where the posterior is nearly Gaussian.
Differential evolution (ter Braak 2006) needs no such shape. (emcee's snooker move is
left out: on an 18-dimensional standard normal it returns a standard deviation of 0.91.)
Sampling goes on until every coordinate has the wanted effective sample size, by emcee's
and by ArviZ's estimate, and R-hat is low, or until the steps are used up. Directions
that no reading determines are drawn from their prior.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oed.arrays import Array
from oed.checkpoint import Checkpoint, open_chain
from oed.estimate import Estimate
from oed.log_density import LogDensity
from oed.measurement import Measurement, Series
from oed.whole_file import whole_file

#: steps between checks of convergence
CHECK_STEPS = 250
#: checks before sampling may end
LEAST_CHECKS = 2
#: steps, in autocorrelation times, that must be run, and that are discarded first
LEAST_TIMES, BURN_IN_TIMES = 10, 2
#: effective sample size by emcee's estimate, over the wanted one
SPARE = 1.2
#: R-hat (each walker a chain) below which the walkers count as mixed
MIXED_RHAT = 1.01
#: shares of the two kinds of moves
LAPLACE_SHARE, EVOLUTION_SHARE = 0.6, 0.4


@dataclasses.dataclass(frozen=True)
class Posterior:
    """Draws from the posterior, and their diagnostics.

    names            parameters of theta
    draws            (chains, draws, n) theta, SI; one chain a walker, thinned
    z                (chains, draws, r) identifiable coordinates
    noise_law        (chains, draws, d) coordinates of the noise law, standard normal a
                     priori (`oed.noise.prior`)
    noise_names      of these coordinates
    ess              (n,) bulk effective sample size (ArviZ); NaN for held parameters
    rhat             (n,) split R-hat (ArviZ); NaN for held parameters
    acceptance       mean share of accepted steps
    autocorrelation  longest integrated autocorrelation time, in steps (emcee)
    steps            steps run
    burn_in          steps discarded
    """

    names: tuple[str, ...]
    draws: Array
    z: Array
    noise_law: Array
    noise_names: tuple[str, ...]
    ess: Array
    rhat: Array
    acceptance: float
    autocorrelation: float
    steps: int
    burn_in: int

    @property
    def pooled(self) -> Array:
        """The draws of all chains (chains * draws, n), SI."""
        return self.draws.reshape(-1, self.draws.shape[2])


def import_samplers() -> None:
    """Import emcee and ArviZ now: it takes seconds.

    An interruption during an import would be reported by other people's code.
    """
    import emcee  # noqa: F401

    _arviz()


def sample(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    estimate: Estimate,
    rng: np.random.Generator,
    *,
    walkers: int | None = None,
    ess: float = 1000.0,
    max_steps: int = 20_000,
    max_draws: int = 20_000,
    progress: Callable[[float], None] | None = None,
    checkpoint: Checkpoint | None = None,
    resumed: Callable[[int], None] | None = None,
) -> Posterior:
    """Sample the posterior of readings y (N,), SI, about an estimate.

    walkers     twice the dimensions and more by default
    ess         effective sample size wanted of every parameter
    max_steps   of every walker
    max_draws   returned: the chains are thinned
    progress    called with the share done
    checkpoint  where the unfinished chain is saved, and resumed from
    resumed     called with the steps of a chain that is resumed

    Raises KeyboardInterrupt where Ctrl-C arrives, OSError where the checkpoint cannot
    be written.
    """
    import emcee

    target = LogDensity(measurement, series, y, estimate)
    shape = (walkers or max(2 * (target.dimensions + 2), 32), target.dimensions)
    moves = [
        (emcee.moves.MHMove(target.propose), LAPLACE_SHARE),
        (emcee.moves.DEMove(), EVOLUTION_SHARE),
    ]
    start = target.centre + rng.standard_normal(shape) @ target.root.T
    random: Any = np.random.RandomState(rng.integers(2**31)).get_state()
    determining = (y, target.centre, target.root, start, random[1])
    chain = open_chain(checkpoint, shape, determining)
    sampler = emcee.EnsembleSampler(
        *shape, target, vectorize=True, moves=moves, backend=chain.backend
    )
    state = emcee.State(start, random_state=random)
    if sampler.iteration > 0:
        state = sampler.get_last_sample()
        if resumed is not None:
            resumed(sampler.iteration)
    autocorrelation, burn_in = _run(
        sampler, state, target, ess, max_steps, progress, chain.save
    )
    return _posterior(
        measurement.names, target, sampler, autocorrelation, burn_in, max_draws, rng
    )


def _run(
    sampler: Any,
    state: Any,
    target: LogDensity,
    ess: float,
    max_steps: int,
    progress: Callable[[float], None] | None,
    save: Callable[[int], None],
) -> tuple[float, int]:
    """Run until the chains have converged; autocorrelation time and burn-in, in steps.

    A chain that is resumed is judged before it goes on, as the unbroken one was.
    `save` is called after each block of steps, with its first step.
    """
    while True:
        begin = sampler.iteration
        if begin > 0:
            autocorrelation, burn_in = _autocorrelation_and_burn_in(sampler)
            reached = sampler.nwalkers * (begin - burn_in) / autocorrelation
            if progress is not None:
                progress(min(1.0, reached / (SPARE * ess)))
            enough = (
                reached > SPARE * ess
                and begin >= LEAST_CHECKS * CHECK_STEPS
                and begin > LEAST_TIMES * autocorrelation
            )
            if enough and _has_converged(target, _chain(sampler, burn_in), ess):
                return autocorrelation, burn_in
            if begin >= max_steps:
                return autocorrelation, burn_in
        steps = min(CHECK_STEPS, max_steps - begin)
        for latest in sampler.sample(state, iterations=steps):
            state = latest
            if target.interrupted:
                raise KeyboardInterrupt
        save(begin)


def _autocorrelation_and_burn_in(sampler: Any) -> tuple[float, int]:
    """Autocorrelation time, and the steps to discard."""
    autocorrelation = _autocorrelation(sampler)
    burn_in = min(int(BURN_IN_TIMES * autocorrelation), sampler.iteration // 2)
    return autocorrelation, burn_in


def _chain(sampler: Any, burn_in: int) -> Array:
    """Points (walkers, steps, dimensions) after the burn-in."""
    return np.swapaxes(sampler.get_chain(discard=burn_in), 0, 1)


def _has_converged(target: LogDensity, chain: Array, ess: float) -> bool:
    theta = target.coordinates.to_theta(chain[..., : target.r])
    moving = theta[..., target.moving]
    if np.min(_ess(moving)) <= ess:
        return False
    return bool(np.max(_rhat(moving)) < MIXED_RHAT)


def _ess(chain: Array) -> Array:
    """Bulk effective sample size (n,) of chains (chains, draws, n)."""
    return np.atleast_1d(_arviz().ess(chain, chain_axis=0, draw_axis=1))


def _rhat(chain: Array) -> Array:
    """Rank-normalised split R-hat (n,) of chains (chains, draws, n)."""
    return np.atleast_1d(_arviz().rhat(chain, chain_axis=0, draw_axis=1))


def _arviz() -> Any:
    """ArviZ's functions of arrays; imported late, as it takes seconds."""
    from arviz_stats import base

    return base.array_stats


def _autocorrelation(sampler: Any) -> float:
    """Longest integrated autocorrelation time, in steps."""
    with warnings.catch_warnings():
        # Chains that are too short go on; they need no warning.
        warnings.simplefilter("ignore")
        times = sampler.get_autocorr_time(tol=0)
    finite = np.where(np.isfinite(times), times, sampler.iteration)
    return float(np.nanmax(finite))


def _posterior(
    names: tuple[str, ...],
    target: LogDensity,
    sampler: Any,
    autocorrelation: float,
    burn_in: int,
    max_draws: int,
    rng: np.random.Generator,
) -> Posterior:
    """Thinned draws, with null directions from their prior, and their diagnostics."""
    coordinates, r = target.coordinates, target.r
    chain = _chain(sampler, burn_in)
    every = max(1, -(-chain.shape[0] * chain.shape[1] // max_draws))
    null = coordinates.null_basis
    change = rng.standard_normal((*chain.shape[:2], null.shape[1])) @ null.T
    thinned = chain[:, ::every]
    theta = coordinates.to_theta(thinned[..., :r])
    theta = target.move_along_null(theta, change[:, ::every])
    n = theta.shape[2]
    varying = np.flatnonzero(np.ptp(theta.reshape(-1, n), axis=0) > 0)
    ess, rhat = np.full(n, np.nan), np.full(n, np.nan)
    ess[varying] = _ess(theta[..., varying])
    rhat[varying] = _rhat(theta[..., varying])
    return Posterior(
        names=names,
        draws=theta,
        z=thinned[..., :r],
        noise_law=thinned[..., r:],
        noise_names=target.noise_names,
        ess=ess,
        rhat=rhat,
        acceptance=float(np.mean(sampler.acceptance_fraction)),
        autocorrelation=autocorrelation,
        steps=int(sampler.iteration),
        burn_in=burn_in,
    )


def save(posterior: Posterior, path: Path, attributes: dict[str, str]) -> None:
    """Write the draws, SI, as NetCDF for xarray and ArviZ, whole or not at all."""
    import arviz_base

    groups = {
        "posterior": {"theta": posterior.draws, "noise_law": posterior.noise_law},
        "sample_stats": {
            "ess": posterior.ess[None, None],
            "rhat": posterior.rhat[None, None],
        },
    }
    tree = arviz_base.from_dict(
        groups,
        coords={
            "parameter": list(posterior.names),
            "noise_coordinate": list(posterior.noise_names),
        },
        dims={
            "theta": ["parameter"],
            "noise_law": ["noise_coordinate"],
            "ess": ["parameter"],
            "rhat": ["parameter"],
        },
    )
    tree.attrs.update(attributes)
    with whole_file(path) as part:
        tree.to_netcdf(part, engine="h5netcdf")
