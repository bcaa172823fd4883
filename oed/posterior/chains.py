"""Draws of the posterior by emcee: ensembles run until they agree, or steps are used up.

Two kinds of moves share the work. Independent proposals from the Laplace approximation
with Student tails decide almost every step where the posterior is nearly Gaussian.
Differential evolution (ter Braak 2006) needs no such shape. (emcee's snooker move is
left out: on an 18-dimensional standard normal it returns a standard deviation of 0.91.)
Sampling goes on until every coordinate has the wanted effective sample size, by emcee's
and by ArviZ's estimate, and independent ensembles agree (R-hat), or until the steps are
used up.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from oed.base import Array, Mask
from oed.posterior.draws import Posterior
from oed.posterior.ensembles import Ensembles
from oed.posterior.log_density import LogDensity, OutOfBoundsError

#: steps after which chains are saved, and between checks of convergence at least
CHECK_STEPS = 50
#: steps between checks as a share of those run: a check looks at all of them
CHECK_SHARE = 0.2
#: checks before sampling may end
LEAST_CHECKS = 2
#: steps, in autocorrelation times, that must be run, and that are discarded first
LEAST_TIMES, BURN_IN_TIMES = 10, 2
#: effective sample size by emcee's estimate, over the wanted one
SPARE = 1.2
#: R-hat of independent ensembles below which they agree
MIXED_RHAT = 1.01


def run(
    ensembles: Ensembles,
    target: LogDensity,
    ess: float,
    max_steps: int,
    progress: Callable[[float], None] | None,
) -> tuple[float, int]:
    """Run until the chains have converged; autocorrelation time and burn-in, in steps.

    Chains that are resumed are judged before they go on, as the unbroken ones were.
    """
    checks = _checks(max_steps)
    while True:
        begin = ensembles.iteration
        is_due = begin in checks or begin >= max_steps
        if is_due and begin == ensembles.saved:
            autocorrelation = ensembles.autocorrelation()
            burn_in = min(int(BURN_IN_TIMES * autocorrelation), begin // 2)
            reached = ensembles.walkers * (begin - burn_in) / autocorrelation
            if progress is not None:
                progress(min(1.0, reached / (SPARE * ess)))
            enough = (
                reached > SPARE * ess
                and begin >= LEAST_CHECKS * CHECK_STEPS
                and begin > LEAST_TIMES * autocorrelation
            )
            if enough and _has_converged(target, ensembles, burn_in, ess):
                return autocorrelation, burn_in
            if begin >= max_steps:
                return autocorrelation, burn_in
        block = begin - begin % CHECK_STEPS + CHECK_STEPS
        ensembles.run_to(min(block, max_steps))


def _checks(max_steps: int) -> set[int]:
    """Numbers of steps at which convergence is checked, the last one among them."""
    checks, steps = set(), 0
    while steps < max_steps:
        apart = int(CHECK_SHARE * steps) // CHECK_STEPS * CHECK_STEPS
        steps = min(steps + max(apart, CHECK_STEPS), max_steps)
        checks.add(steps)
    return checks


def _has_converged(
    target: LogDensity, ensembles: Ensembles, burn_in: int, ess: float
) -> bool:
    chain = ensembles.chains(burn_in)
    moving = target.coordinates.to_theta(chain[..., : target.r])[..., target.moving]
    if np.min(_ess(moving)) <= ess:
        return False
    return bool(np.max(_rhat(ensembles.by_ensemble(moving))) < MIXED_RHAT)


def _ess(chain: Array) -> Array:
    """Bulk effective sample size (n,) of chains (chains, draws, n)."""
    return np.atleast_1d(arviz().ess(chain, chain_axis=0, draw_axis=1))


def _rhat(chain: Array) -> Array:
    """Rank-normalised split R-hat (n,) of chains (chains, draws, n)."""
    return np.atleast_1d(arviz().rhat(chain, chain_axis=0, draw_axis=1))


def arviz() -> Any:
    """ArviZ's functions of arrays; imported late, as it takes seconds."""
    from arviz_stats import base

    return base.array_stats


def collect(
    target: LogDensity,
    ensembles: Ensembles,
    autocorrelation: float,
    burn_in: int,
    rng: np.random.Generator,
    *,
    max_draws: int,
    thin: int,
) -> Posterior:
    """Thinned draws, with null directions from their prior, and their diagnostics.

    Diagnostics are those of all steps; of thinned draws they would be rougher.
    """
    coordinates, r = target.coordinates, target.r
    chain = ensembles.chains(burn_in)
    every = max(thin, -(-chain.shape[0] * chain.shape[1] // max_draws))
    thinned = chain[:, ::every]
    null = coordinates.null_basis
    change = rng.standard_normal((*thinned.shape[:2], null.shape[1])) @ null.T
    theta = coordinates.to_theta(thinned[..., :r])
    theta = target.move_along_null(theta, change)
    ess, rhat = _diagnostics(target, ensembles, chain, theta)
    draws, points = ensembles.by_ensemble(theta), ensembles.by_ensemble(thinned)
    inside = target.in_bounds(draws)
    draws, points = _accepted(draws, inside), _accepted(points, inside)
    if not draws.size:
        raise OutOfBoundsError(target.measurement, theta.reshape(-1, theta.shape[2]))
    return Posterior(
        names=target.measurement.names,
        draws=draws,
        z=points[..., :r],
        noise_law=points[..., r:],
        noise_names=target.noise_names,
        ess=ess * inside.mean(),
        rhat=rhat,
        acceptance=ensembles.acceptance,
        autocorrelation=autocorrelation,
        walkers=ensembles.walkers,
        steps=ensembles.iteration,
    )


def _accepted(values: Array, inside: Mask) -> Array:
    """Values (chains, k, m) of those (chains, draws) inside, as many of each chain.

    All in one chain where that would leave out half of them.
    """
    least = int(inside.sum(axis=1).min())
    if least * len(values) < 0.5 * inside.sum():
        return values[inside][None]
    chains = zip(values, inside, strict=True)
    return np.stack([chain[within][:least] for chain, within in chains])


def _diagnostics(
    target: LogDensity, ensembles: Ensembles, chain: Array, theta: Array
) -> tuple[Array, Array]:
    """Effective sample size and R-hat (n,); NaN for parameters that are held.

    Of directions that no reading determines draws are independent: parameters that
    nothing else moves count as the drawn theta.
    """
    n, moving = theta.shape[2], target.moving
    ess, rhat = np.full(n, np.nan), np.full(n, np.nan)
    varying = np.flatnonzero(np.ptp(theta.reshape(-1, n), axis=0) > 0)
    only_null = np.setdiff1d(varying, moving)
    sampled = target.coordinates.to_theta(chain[..., : target.r])
    for members, values in ((moving, sampled), (only_null, theta)):
        if members.size:
            ess[members] = _ess(values[..., members])
            rhat[members] = _rhat(ensembles.by_ensemble(values[..., members]))
    return ess, rhat
